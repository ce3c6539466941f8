"""What a level switch costs a long tool, and whether a tool that hangs over an open border stays where it lies."""

import contact_shapes as shapes
import numpy as np
from contact_core import Core

from hapticlod.layout import MAPPED_HIT


def shaft(direction: np.ndarray, balls: int, radius_mm: float = 0.4) -> np.ndarray:
    """(balls, 4) overlapping balls from the reference point on."""
    along = np.arange(balls)[:, None] * 0.5 * radius_mm * direction / np.linalg.norm(direction)
    return np.column_stack([along, np.full(balls, radius_mm)])


def lowered(mesh: shapes.Mesh, by_mm: float) -> shapes.Mesh:
    return (mesh[0] - np.array([0.0, 0.0, by_mm])).astype(np.float32), mesh[1]


def to_and_fro(core: Core, hip_mm: np.ndarray, ticks: int) -> np.ndarray:
    """Records of a tool that is held here while the level changes every ten ticks."""
    rows = []
    for tick in range(ticks):
        core.renderer.set_coarsest_floor(tick // 10 % 2)
        rows.append(core.tick(1e-3 * tick, hip_mm))
    return np.array(rows)


def test_a_switch_looks_at_what_is_near() -> None:
    """A shaft of 60 balls leans on a fine plane: only its tip is near, however long the mapping's L.

    Looking along the whole line and for every ball's nearest point took 19 000 tests here.
    """
    fine = shapes.plane(half_mm=10.0, cells=100)
    core = Core(
        [fine, lowered(fine, 0.05)], shaft(np.array([0.6, 0.0, 0.8]), 60), l_in_mm=3.0, l_out_mm=3.0,
        closest_bound_mm=3.0,
    )  # fmt: skip
    for tick in range(20):
        core.tick(1e-3 * (tick - 20), np.array([0.1, 0.2, 0.5 - 0.03 * tick]))
    rows = to_and_fro(core, np.array([0.1, 0.2, 0.0]), 200)
    changed = np.diff(rows["level"].astype(int), prepend=0) != 0
    assert changed.sum() == 19
    assert (rows["mapping"][changed] == MAPPED_HIT).all()
    np.testing.assert_allclose(rows["scp_mm"][changed, 2], np.where(rows["level"][changed] == 1, 0.35, 0.4), atol=1e-3)
    assert rows["tests"][changed].max() < 1500


def test_what_hangs_over_a_border_is_not_behind_the_surface() -> None:
    """An arm over the edge of an open plane, its end lower than the plane: no surface is between the two."""
    sheet = shapes.plane(half_mm=10.0, cells=40)
    arm = shaft(np.array([1.0, 0.0, -0.15]), 30)
    hip = np.array([9.0, 0.3, 0.2])
    core = Core([sheet, lowered(sheet, 0.02)], arm, l_in_mm=1.0, l_out_mm=1.0, closest_bound_mm=1.0)
    for tick in range(40):
        core.tick(1e-3 * (tick - 40), np.array([9.0, 0.3, 1.0 - 0.02 * tick]))
    rows = to_and_fro(core, hip, 100)
    changed = np.diff(rows["level"].astype(int), prepend=0) != 0
    assert changed.sum() == 9
    assert rows["contact"].all()
    assert (arm[:, 2] + rows["scp_mm"][-1, 2]).min() < -0.1  # the end does hang below
    # From level to level it moves as far as the plane does, and no further.
    assert np.abs(np.diff(rows["scp_mm"], axis=0)).max() < 0.025
