"""Binary records shared with the C++ core, as numpy dtypes. Equal, byte for byte, to runtime/core/layout.hpp."""

from typing import Final

import numpy as np

MAX_LEVELS: Final = 8
MAX_BALLS: Final = 4096
CONFIG_VERSION: Final = 1
NO_NEIGHBOUR: Final = 0xFFFFFFFF

MAPPING_PAPER: Final = 0
MAPPING_TWO_SIDED: Final = 1
POLICY_VELOCITY: Final = 0
POLICY_DISTANCE: Final = 1

MAPPED_NONE: Final = 0
MAPPED_HIT: Final = 1
MAPPED_CLOSEST: Final = 2
MAPPED_MISS: Final = 3

TICK_ERRORS: Final = (
    "hip_not_finite",
    "period",
    "hip_jump",
    "not_converged",
    "candidates",
    "contact_lost",
    "force_clamped",
    "slew_limited",
    "force_not_finite",
    "start_inside",
    "turn_held",
)
"""Names of the bits of a record's ``errors``, lowest first."""

CONFIG_DTYPE: Final = np.dtype(
    [
        ("version", "<u4"),
        ("level_count", "<u4"),
        ("mapping", "<u4"),
        ("policy", "<u4"),
        ("shading", "<u4"),
        ("flags", "<u4"),
        ("origin_mm", "<f8", 3),
        ("loop_hz", "<f8"),
        ("budget_us", "<f8"),
        ("stiffness_n_mm", "<f8"),
        ("damping_n_s_mm", "<f8"),
        ("friction_static", "<f8"),
        ("friction_dynamic", "<f8"),
        ("filter_hz", "<f8"),
        ("hysteresis", "<f8"),
        ("dwell_s", "<f8"),
        ("l_in_mm", "<f8"),
        ("l_out_mm", "<f8"),
        ("closest_bound_mm", "<f8"),
        ("blend_s", "<f8"),
        ("max_force_n", "<f8"),
        ("max_slew_n_s", "<f8"),
        ("engage_s", "<f8"),
        ("crack_mm", "<f8"),
        ("work_limit", "<f8"),
        ("reserved", "<f8", 7),
        ("speeds_mm_s", "<f8", MAX_LEVELS),
        ("cell_mm", "<f8", MAX_LEVELS),
        ("triangles", "<u4", MAX_LEVELS),
        ("balls", "<u4", MAX_LEVELS),
    ]
)

BALL_DTYPE: Final = np.dtype([("centre_mm", "<f8", 3), ("radius_mm", "<f8")])

RECORD_DTYPE: Final = np.dtype(
    [
        ("time_s", "<f8"),
        ("hip_mm", "<f8", 3),
        ("scp_mm", "<f8", 3),
        ("force_n", "<f8", 3),
        ("torque_n_mm", "<f8", 3),
        ("speed_mm_s", "<f4"),
        ("cost_ns", "<f4"),
        ("level", "u1"),
        ("contact", "u1"),
        ("mapping", "u1"),
        ("constraints", "u1"),
        ("errors", "<u4"),
        ("cells", "<u4"),
        ("triangles", "<u4"),
        ("tests", "<u4"),
        ("iterations", "<u4"),
        ("balls", "<u4"),
        ("mapping_cells", "<u4"),
    ]
)

HASH_DTYPE: Final = np.dtype(
    [
        ("cell_mm", "<f8"),
        ("table_size", "<u4"),
        ("brick_count", "<u4"),
        ("cell_count", "<u4"),
        ("block_count", "<u4"),
        ("brick_min", "<i4", 3),
        ("brick_max", "<i4", 3),
        ("bbox_min", "<f4", 3),
        ("bbox_max", "<f4", 3),
        ("max_edge_mm", "<f4"),
        ("mean_edge_mm", "<f4"),
        ("loose_mm", "<f4"),
        ("reserved", "<u4", 5),
    ]
)

BRICK_DTYPE: Final = np.dtype([("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("first_cell", "<u4"), ("mask", "<u8")])

MATERIAL_DTYPE: Final = np.dtype([(name, "<f4") for name in ("stiffness_n_mm", "friction_static", "friction_dynamic")])

BLOCK_DTYPE: Final = np.dtype([("v", "<f4", (9, 8)), ("id", "<u4", 8)])

BOUND_DTYPE: Final = np.dtype([(name, "<f4") for name in ("x", "y", "z", "radius", "nx", "ny", "nz", "half")])
