"""A tool's other balls: what is done for the ball that touches must leave none of them behind the surface."""

from itertools import pairwise
from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core

from hapticlod.layout import MAPPED_HIT

NOT_CONVERGED, START_INSIDE, TURN_HELD = 1 << 3, 1 << 9, 1 << 10
# A ball that touches and a point 2 mm beside it, its lowest place 20 um higher.
BALL_AND_POINT = np.array([[0.0, 0.0, 0.0, 1.0], [2.0, 0.0, -0.98, 0.0]])


def switching(levels: list, tool: np.ndarray, **fields: Any) -> Core:
    """Level 1 above 50 mm/s."""
    speeds = np.full(8, 1e9)
    speeds[0] = 50.0
    return Core(levels, tool, speeds_mm_s=speeds, **fields)


def pressed_then_fast(ticks: int = 40) -> np.ndarray:
    """(T, 3) ball pressed 0.3 mm into z = 0, from tick 20 on along y at 80 mm/s."""
    hip = np.tile([0.0, 0.0, 0.7], (ticks, 1))
    hip[0, 2] = 1.02
    hip[1:8, 2] = np.linspace(1.0, 0.7, 7)
    hip[20:, 1] = 0.08 * np.arange(1, ticks - 19)
    return hip


def test_a_switch_leaves_no_ball_behind_the_new_level() -> None:
    """Level 1 rises by 5 % along x: the ball is lifted by 1 um, the point would be 80 um behind."""
    low = shapes.plane(10.0, 20)
    high = shapes.height_field(lambda x, y: 0.05 * np.maximum(x - 0.0, 0.0), 10.0, 20)
    rows = switching([low, high], BALL_AND_POINT).replay(pressed_then_fast())
    first = int(np.argmax(rows["level"] == 1))
    assert rows["mapping"][first] == MAPPED_HIT
    point = rows["scp_mm"] + BALL_AND_POINT[1, :3]
    height = (point[:, 2] - 0.05 * np.maximum(point[:, 0], 0.0))[first:]
    assert height.min() > -1e-3, f"{-1e3 * height.min():.0f} um behind"


def test_a_level_with_more_balls_frees_those_that_come_back() -> None:
    """One ball on level 0 sinks the tool's second, 0.5 mm below it, into the plane; level 1 uses both."""
    tool = np.array([[0.0, 0.0, 0.0, 1.0], [2.0, 0.0, -1.5, 0.1]])
    plane = shapes.plane(10.0, 20)
    use = np.full(8, 1, dtype=np.uint32)
    use[1] = 2
    rows = switching([plane, plane], tool, balls=use).replay(pressed_then_fast())
    first = int(np.argmax(rows["level"] == 1))
    lowest = rows["scp_mm"][first:, 2] - 1.5
    assert rows["contact"][first:].all()
    assert lowest.min() > 0.1 - 1e-3, f"second ball's middle at {lowest.min():.3f} mm"


def test_a_start_inside_frees_every_ball() -> None:
    """Begun inside a sphere with a ball 0.6 mm and a small one 1.6 mm deep, 3 mm apart: both must get out."""
    mesh = shapes.sphere(10.0, 4)
    balls = np.array([[-1.5, 0.0, 0.0, 0.5], [1.5, 0.0, -1.0, 0.1]])
    rows = Core([mesh], balls, engage_s=0.05).replay(np.tile([0.0, 0.0, 9.3], (60, 1)))
    assert rows["errors"][0] & START_INSIDE
    for place, radius in zip(balls[:, :3], balls[:, 3], strict=True):
        out = np.linalg.norm(rows["scp_mm"] + place, axis=1) - radius
        assert out.min() > 9.98, f"a ball is {10.0 - out.min():.3f} mm inside"


def test_a_start_across_a_thin_plate_gets_out() -> None:
    """Two balls, one at either side of a 0.3 mm plate. Wherever it gets out, the hand's leaving must free it."""
    balls = np.array([[0.0, 0.0, 0.2, 0.15], [0.8, 0.0, -0.25, 0.15]])
    hip = np.zeros((300, 3))
    hip[:, :2] = 0.31, 0.07
    hip[:, 2] = np.concatenate([np.full(100, -0.15), np.linspace(-0.15, 6.0, 200)])
    rows = Core([shapes.plate(0.3)], balls, engage_s=0.02).replay(hip)
    assert (rows["errors"][50:] & NOT_CONVERGED).sum() == 0
    assert not rows["contact"][-20:].any(), f"still held with {np.linalg.norm(rows['force_n'][-1]):.2f} N"


def turned_about_y(angle_rad: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(0.5 * angle_rad), 0.0 * angle_rad, np.sin(0.5 * angle_rad), 0.0 * angle_rad])


def test_a_turn_that_was_held_is_taken_up_when_there_is_room() -> None:
    """A bar in a slot cannot turn; out of the slot it must take the orientation that the hand kept all the while."""
    below_v, faces = shapes.plane(10.0, 20)
    above_v = below_v + np.array([0.0, 0.0, 1.0], dtype=np.float32)
    slot = (np.concatenate([below_v, above_v]), np.concatenate([faces, faces + len(below_v)]))
    bar = np.column_stack([np.linspace(-3.0, 3.0, 7), np.zeros(7), np.zeros(7), np.full(7, 0.4)])
    places = np.array([[-16, 0, 0.5], [0, 0, 0.5], [0, 0, 0.5], [-16, 0, 0.5], [-16, 0, 7], [0, 0, 7], [0, 0, 2]])
    hip = np.concatenate([np.linspace(a, b, 100) for a, b in pairwise(places)])
    angle = np.clip((np.arange(len(hip)) - 110) / 50.0, 0.0, 1.0) * 0.8
    rows = Core([slot], bar).replay(hip, turned_about_y(angle))
    held = (rows["errors"] & TURN_HELD) != 0
    assert held[150]
    # Lowered over the slot: level, the bar would touch at z = 1.4; turned by 0.8 rad, its end does 2.15 mm sooner.
    touched = hip[500 + int(np.argmax(rows["contact"][500:])), 2]
    assert rows["contact"][-1]
    assert touched == pytest.approx(1.4 + 3.0 * np.sin(0.8), abs=0.06)
