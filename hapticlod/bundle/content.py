"""Content of a bundle: numbers finite, indices in range, hash consistent. The checks of runtime/core/level_check.cpp,
runtime/core/config_check.cpp and runtime/io/bundle.cpp in numpy. Each function returns the first fault, or ''.
"""

from typing import Any, Final

import numpy as np

from hapticlod.layout import (
    BOUND_DTYPE,
    CONFIG_VERSION,
    MAPPED_MISS,
    MAPPING_TWO_SIDED,
    MATERIAL_DTYPE,
    MAX_BALLS,
    MAX_LEVELS,
    NO_NEIGHBOUR,
    POLICY_DISTANCE,
)
from hapticlod.material import AS_STATION, MOST_FRICTION, STIFFEST_N_MM

# Least and most of each field; runtime/core/config_check.cpp has the same table.
_RANGES: Final = {
    "origin_mm": (-1e9, 1e9),
    "loop_hz": (1.0, 1e5),
    "budget_us": (0.0, 1e9),
    "stiffness_n_mm": (0.0, 1e6),
    "damping_n_s_mm": (0.0, 1e3),
    "friction_static": (0.0, 10.0),
    "friction_dynamic": (0.0, 10.0),
    "filter_hz": (0.0, 1e5),
    "hysteresis": (0.0, 0.99),
    "dwell_s": (0.0, 1e3),
    "l_in_mm": (0.0, 1e6),
    "l_out_mm": (0.0, 1e6),
    "closest_bound_mm": (0.0, 1e6),
    "blend_s": (0.0, 10.0),
    "max_force_n": (0.0, 1e6),
    "max_slew_n_s": (0.0, 1e9),
    "engage_s": (0.0, 60.0),
    "crack_mm": (0.0, 1e3),
    "work_limit": (0.0, 1e12),
}
_MOST_COORDINATE_MM: Final = np.float32(1e9)
_MOST_ELEMENTS: Final = 1 << 30
_BLOCKS_AT_ONCE: Final = 1 << 16  # bounds the memory that comparing blocks with the mesh takes


def config_fault(config: Any) -> str:
    """`config` is a numpy scalar of CONFIG_DTYPE."""
    if config["version"] != CONFIG_VERSION:
        return f"config version {config['version']} is not known"
    count = int(config["level_count"])
    if not 1 <= count <= MAX_LEVELS:
        return f"level_count = {count} is outside [1, {MAX_LEVELS}]"
    for field, most in (("mapping", MAPPING_TWO_SIDED), ("policy", POLICY_DISTANCE), ("shading", 1)):
        if config[field] > most:
            return f"{field} = {config[field]} is not known"
    if config["flags"] != 0 or (config["reserved"] != 0).any():
        return "flags or reserved fields are not 0"
    speeds = config["speeds_mm_s"][: count - 1]
    for field, values in [*((name, np.asarray(config[name])) for name in _RANGES), ("speeds_mm_s", speeds)]:
        if _subnormal(values):
            return f"{field} is so small that it counts as 0: say 0"
    for field, (least, most) in _RANGES.items():
        value = np.asarray(config[field])
        if not ((value >= least) & (value <= most)).all():
            return f"{field} = {value.tolist()} is outside [{least:g}, {most:g}]"
    if not config["max_force_n"] > 0:
        return "max_force_n = 0 would be no limit: a bundle must have one"
    if not ((speeds >= 0) & (speeds <= 1e9)).all() or (np.diff(speeds) < 0).any():
        return f"speeds_mm_s = {speeds.tolist()} must be in [0, 1e9] and not decrease"
    balls = config["balls"][:count]
    if not ((balls >= 1) & (balls <= MAX_BALLS)).all():
        return f"balls = {balls.tolist()} is outside [1, {MAX_BALLS}]"
    return ""


def _subnormal(values: np.ndarray) -> bool:
    """The tick takes such numbers for 0, and a limit of 0 is none."""
    return bool(((values != 0) & (np.abs(values) < np.finfo(np.float64).tiny)).any())


def tool_fault(balls: np.ndarray) -> str:
    """`balls` (P,) of BALL_DTYPE."""
    if not 1 <= len(balls) <= MAX_BALLS:
        return f"{len(balls)} balls, expected 1 to {MAX_BALLS}"
    good = np.isfinite(balls["centre_mm"]).all(axis=1) & np.isfinite(balls["radius_mm"]) & (balls["radius_mm"] >= 0)
    if not good.all():
        return f"ball {int(np.argmin(good))} is not finite or has a negative radius"
    reach = np.hypot(np.hypot(balls["centre_mm"][:, 0], balls["centre_mm"][:, 1]), balls["centre_mm"][:, 2])
    near = (reach <= _MOST_COORDINATE_MM) & (balls["radius_mm"] <= _MOST_COORDINATE_MM)
    return "" if near.all() else f"ball {int(np.argmin(near))} reaches beyond 10^9 mm"


def motion_fault(rows: np.ndarray) -> str:
    """`rows` (T,) of MOTION_DTYPE."""
    if len(rows) < 2:
        return f"has {len(rows)} rows, a motion needs at least 2"
    finite = np.isfinite(rows["time_s"]) & np.isfinite(rows["position_mm"]).all(axis=1)
    length = np.linalg.norm(rows["orientation"], axis=1)
    for good, what in (
        (finite & np.isfinite(length), "holds a number that is not finite"),
        (np.abs(length - 1.0) <= 1e-3, "has an orientation that is not a unit quaternion"),
        (np.diff(rows["time_s"], prepend=-np.inf) > 0, "does not come after the row before"),
    ):
        if not good.all():
            return f"row {int(np.argmin(good)) + 1} {what}"
    return ""


def record_fault(rows: np.ndarray, level_count: int) -> str:
    """`rows` (T,) of RECORD_DTYPE."""
    good = (rows["level"] < level_count) & (rows["mapping"] <= MAPPED_MISS)
    for field in ("time_s", "hip_mm", "scp_mm", "force_n", "torque_n_mm", "speed_mm_s", "cost_ns"):
        good &= np.isfinite(rows[field].reshape(len(rows), -1)).all(axis=1)
    return "" if good.all() else f"row {int(np.argmin(good)) + 1} is damaged"


def mesh_fault(vertices: np.ndarray, faces: np.ndarray) -> str:
    """`vertices` (n, 3), `faces` (m, 3)."""
    if not len(vertices) or not len(faces):
        return "has no vertices or no faces"
    if max(len(vertices), len(faces)) >= _MOST_ELEMENTS:
        return "has more than 2^30 faces or vertices"
    if not (np.abs(vertices) <= _MOST_COORDINATE_MM).all():
        return "a vertex is not finite or beyond 10^9 mm"
    return "a face index is out of range" if (faces >= len(vertices)).any() else ""


def materials_fault(materials: np.ndarray, vertices: int) -> str:
    """`materials` (n,) of MATERIAL_DTYPE."""
    if len(materials) != vertices:
        return "materials and vertices differ in number"
    stiffness, static, dynamic = (materials[name] for name in MATERIAL_DTYPE.names or ())
    free = (static == AS_STATION) & (dynamic == AS_STATION)
    for good, what in (
        ((stiffness == AS_STATION) | ((stiffness > 0) & (stiffness <= STIFFEST_N_MM)), "stiffness is out of range"),
        (free | ((static >= 0) & (static <= MOST_FRICTION)), "static friction is out of range"),
        (free | ((dynamic >= 0) & (dynamic <= static)), "dynamic friction is negative or exceeds its static friction"),
    ):
        if not good.all():
            return f"a material's {what}"
    return ""


def level_fault(arrays: dict[str, np.ndarray]) -> str:
    """All arrays of a level, by section name; the mesh has passed `mesh_fault`."""
    vertices, faces, header = arrays["vertices"], arrays["faces"], arrays["hash"]
    if len(header) != 1:
        return f"has {len(header)} hash headers, expected 1"
    head = header[0]
    for fault, what in (
        (arrays["adjacency"].shape != faces.shape, "adjacency and faces differ in size"),
        (arrays["normals"].shape != vertices.shape, "normals and vertices differ in size"),
        (not (head["cell_mm"] > 0 and np.isfinite(head["cell_mm"])), "cell_mm is not positive and finite"),
        (len(arrays["table"]) != head["table_size"] or not len(arrays["table"]), "the hash table's size is wrong"),
        (len(arrays["table"]) & (len(arrays["table"]) - 1), "the hash table's size is no power of two"),
        (len(arrays["bricks"]) != head["brick_count"] or not len(arrays["bricks"]), "the brick count is wrong"),
        (head["table_size"] <= head["brick_count"], "the hash table has no free slot"),
        (len(arrays["cells"]) != int(head["cell_count"]) + 1, "the cell count is wrong"),
        (len(arrays["blocks"]) != head["block_count"] or not len(arrays["blocks"]), "the block count is wrong"),
    ):
        if fault:
            return what
    adjacency = arrays["adjacency"]
    if not (np.abs(arrays["normals"]) <= 1.01).all():
        return "a normal is not a unit vector"
    if ((adjacency >= len(faces)) & (adjacency != NO_NEIGHBOUR)).any():
        return "a neighbour index is out of range"
    return (
        _header_fault(head)
        or _bricks_fault(head, arrays["bricks"], arrays["cells"])
        or _table_fault(arrays["table"], arrays["bricks"])
        or _blocks_fault(arrays["blocks"], vertices, faces)
    )


def _header_fault(head: Any) -> str:
    if head["reserved"].any():
        return "a reserved field of its hash is not 0"
    low, high = head["bbox_min"], head["bbox_max"]
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
        return "the bounding box is not valid"
    bricks = (head["brick_min"] <= head["brick_max"]) & (head["brick_min"] >= -(1 << 20))
    if not (bricks & (head["brick_max"] < 1 << 20)).all():
        return "the brick bounds are not valid"
    edges = np.array([head["mean_edge_mm"], head["max_edge_mm"]])
    if not (np.isfinite(edges) & (edges >= 0)).all():
        return "an edge length is not valid"
    return "" if 0 <= float(head["loose_mm"]) <= head["cell_mm"] else "the cells' overhang is not valid"


def _bricks_fault(head: Any, bricks: np.ndarray, cells: np.ndarray) -> str:
    at = np.stack([bricks["x"], bricks["y"], bricks["z"]], axis=1)
    if ((at < head["brick_min"]) | (at > head["brick_max"])).any():
        return "a brick lies outside the stated bounds"
    owned = np.unpackbits(np.ascontiguousarray(bricks["mask"]).view(np.uint8).reshape(-1, 8), axis=1).sum(axis=1)
    first = np.concatenate([[0], np.cumsum(owned)])
    if (owned == 0).any() or (bricks["first_cell"] != first[:-1]).any():
        return "a brick's cells are out of order"
    if first[-1] != head["cell_count"]:
        return "the bricks do not own all cells"
    if cells[0] != 0 or cells[-1] != head["block_count"]:
        return "the cells do not own all blocks"
    return "a cell's blocks are out of order" if (cells[1:] <= cells[:-1]).any() else ""


def bounds_fault(bounds: np.ndarray, blocks: np.ndarray) -> str:
    """`bounds` (n,) of BOUND_DTYPE, `blocks` (n,) of BLOCK_DTYPE: every block within its disc."""
    for start in range(0, len(blocks), _BLOCKS_AT_ONCE):
        part = bounds[start : start + _BLOCKS_AT_ONCE]
        x, y, z, radius, nx, ny, nz, half = (
            part[name].astype(np.float64)[:, None, None] for name in BOUND_DTYPE.names or ()
        )
        with np.errstate(over="ignore", invalid="ignore"):
            disc = (np.abs(nx * nx + ny * ny + nz * nz - 1.0) <= 1e-5) & (radius >= 0)
            if not (disc & np.isfinite(radius) & np.isfinite(half)).all():
                return "a block's bound is no disc"
            corners = blocks["v"][start : start + _BLOCKS_AT_ONCE].astype(np.float64).reshape(-1, 3, 3, 8)
            x, y, z = corners[:, :, 0] - x, corners[:, :, 1] - y, corners[:, :, 2] - z
            inside = (x * x + y * y + z * z <= radius * radius) & (np.abs(nx * x + ny * y + nz * z) <= half)
        if not inside.all():
            return "a block reaches beyond its bound"
    return ""


def brick_hash(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(n,) uint32: where a brick's search in the table starts, before masking. Equal to runtime/core/morton.hpp."""
    x, y, z = (np.asarray(axis).astype(np.int64).astype(np.uint32) for axis in (x, y, z))
    mixed = x * np.uint32(0x9E3779B1) ^ y * np.uint32(0x85EBCA77) ^ z * np.uint32(0xC2B2AE3D)
    mixed ^= mixed >> np.uint32(15)
    mixed *= np.uint32(0x2C1B3C6D)
    return mixed ^ (mixed >> np.uint32(13))


def _table_fault(table: np.ndarray, bricks: np.ndarray) -> str:
    if (table > len(bricks)).any():
        return "a hash slot is out of range"
    if np.count_nonzero(table) != len(bricks):
        return "the hash table does not hold every brick once"
    mask = np.uint32(len(table) - 1)
    searched = np.arange(1, len(bricks) + 1, dtype=np.uint32)
    slot = brick_hash(bricks["x"], bricks["y"], bricks["z"]) & mask
    while len(searched):  # ends: there is a free slot
        held = table[slot]
        if (held == 0).any():
            return "a brick cannot be found through the hash table"
        going = held != searched
        searched, slot = searched[going], (slot[going] + np.uint32(1)) & mask
    return ""


def _blocks_fault(blocks: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> str:
    for start in range(0, len(blocks), _BLOCKS_AT_ONCE):
        part = blocks[start : start + _BLOCKS_AT_ONCE]
        ids = part["id"]
        if (ids[:, 0] >= len(faces)).any():
            return "a block's first triangle is out of range"
        if ((ids >= len(faces)) & (ids != NO_NEIGHBOUR)).any():
            return "a block's triangle is out of range"
        shown = np.where(ids == NO_NEIGHBOUR, ids[:, :1], ids)  # unused lanes repeat lane 0
        corners = vertices[faces[shown]].reshape(len(part), 8, 9).transpose(0, 2, 1)
        if (part["v"] != corners).any():
            return "a block's corners differ from the mesh"
    return ""
