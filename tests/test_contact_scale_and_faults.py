"""One model in other units gives the same contacts; bad input gives an error bit and a safe force, never a surprise."""

from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

HIP_NOT_FINITE, PERIOD, HIP_JUMP, START_INSIDE = 1 << 0, 1 << 1, 1 << 2, 1 << 9
MESHES = {"plane": shapes.plane(cells=16), "globe": shapes.sphere(10.0, 4)}


def pressing(radius_mm: float, ticks: int = 1500) -> np.ndarray:
    """(ticks, 3) path into and out of the globe's top."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(40, 3)) * 0.3 + [0.0, 0.0, 1.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    anchors = direction * (10.0 + radius_mm + rng.uniform(-1.5, 0.3, 40))[:, None]
    anchors[0] = direction[0] * (11.0 + radius_mm)
    return shapes.wander(anchors, 200.0, ticks)


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_metres_and_micrometres_give_the_same_contacts(scale: float, radius_mm: float) -> None:
    vertices, faces = MESHES["globe"]
    extent_mm = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    hip = pressing(radius_mm)
    here = Core([(vertices, faces)], point_or_ball(radius_mm)).replay(hip)
    scaled = (vertices.astype(np.float64) * scale).astype(np.float32)
    there = Core([(scaled, faces)], point_or_ball(radius_mm * scale), 1.0 * scale).replay(hip * scale)
    assert here["contact"].mean() > 0.3
    # On the last fraction of the skin a rounding decides whether a tick still touches.
    clear = np.abs(np.linalg.norm(here["scp_mm"] - hip, axis=1)) > 1e-5 * extent_mm
    assert (here["contact"] == there["contact"])[clear].all()
    assert np.abs(here["scp_mm"] - there["scp_mm"] / scale).max() < 1e-5 * extent_mm


def touching(**fields: Any) -> tuple[Core, np.void]:
    """A point 0.5 mm deep in a plane after three ticks."""
    core = Core([MESHES["plane"]], point_or_ball(0.0), **fields)
    core.tick(0.0, np.array([0.1, 0.2, 0.3]))
    core.tick(0.001, np.array([0.1, 0.2, 0.1]))
    return core, core.tick(0.002, np.array([0.1, 0.2, -0.5]))


BAD_PLACES = [[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, -np.inf], [1e300, 0.0, 0.0]]
BAD_TURNS = [[np.nan, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [np.inf, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize("place", BAD_PLACES)
def test_a_place_that_is_none_holds_the_last_pose(place: list[float]) -> None:
    core, before = touching()
    row = core.tick(0.003, np.array(place))
    assert row["errors"] & HIP_NOT_FINITE
    assert row["force_n"] == pytest.approx(before["force_n"], abs=1e-9)
    assert row["hip_mm"] == pytest.approx([0.1, 0.2, -0.5])
    after = core.tick(0.004, np.array([0.1, 0.2, -0.6]))
    assert after["errors"] == 0
    assert after["force_n"][2] == pytest.approx(0.6, abs=1e-4)


@pytest.mark.parametrize("turn", BAD_TURNS)
def test_a_turn_that_is_none_holds_the_last_pose(turn: list[float]) -> None:
    core, before = touching()
    row = core.tick(0.003, np.array([0.1, 0.2, -0.5]), np.array(turn))
    assert row["errors"] & HIP_NOT_FINITE
    assert row["force_n"] == pytest.approx(before["force_n"], abs=1e-9)
    assert core.tick(0.004, np.array([0.1, 0.2, -0.5]), np.array([1.0, 0.0, 0.0, 0.0]))["errors"] == 0


def test_a_bad_first_tick_gives_no_force() -> None:
    core = Core([MESHES["plane"]], point_or_ball(0.0))
    row = core.tick(0.0, np.array([np.nan, 0.0, 0.0]))
    assert row["errors"] & HIP_NOT_FINITE
    assert not row["force_n"].any()
    assert core.tick(0.001, np.array([0.1, 0.2, 0.3]))["errors"] == 0
    assert core.tick(0.002, np.array([0.1, 0.2, -0.5]))["contact"] == 1


@pytest.mark.parametrize("time_s", [0.002, 0.001, -5.0, np.nan, np.inf])
def test_a_clock_that_stands_or_runs_back(time_s: float) -> None:
    core, _ = touching(damping_n_s_mm=1e-3)
    row = core.tick(time_s, np.array([0.1, 0.2, -0.6]))
    assert row["errors"] & PERIOD
    # The nominal period: 0.1 mm in 1 ms.
    assert row["speed_mm_s"] == pytest.approx(100.0, rel=1e-3)
    assert row["force_n"][2] == pytest.approx(0.6 + 0.1, abs=1e-3)


def test_a_huge_jump_begins_anew() -> None:
    core, _ = touching()
    row = core.tick(0.003, np.array([0.0, 0.0, -1e6]))
    assert row["errors"] & HIP_JUMP
    assert row["contact"] == 0
    assert not row["force_n"].any()
    back = core.tick(0.004, np.array([0.1, 0.2, 0.3]))
    assert back["errors"] & HIP_JUMP
    assert core.tick(0.005, np.array([0.1, 0.2, -0.4]))["force_n"][2] == pytest.approx(0.4, abs=1e-4)


@pytest.mark.parametrize("radius_mm", [50.0, 1e4])
def test_a_ball_larger_than_the_model(radius_mm: float) -> None:
    core = Core([MESHES["globe"]], point_or_ball(radius_mm))
    depth = np.concatenate([np.linspace(-1.0, 1.0, 60), np.full(20, 1.0)])
    hip = np.column_stack([np.zeros(80), np.zeros(80), 10.0 + radius_mm - depth])
    rows = core.replay(hip)
    assert np.isfinite(rows["force_n"]).all()
    assert rows["contact"][depth > 0.1].all()
    assert not rows["contact"][depth < -0.1].any()
    # An icosphere has its 12 corners exactly on the sphere and the middles of its faces within 40 um.
    assert rows["force_n"][-1, 2] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("height_mm", [9.9, 9.0, 5.0, 0.5])
@pytest.mark.parametrize("radius_mm", [0.0, 1.0])
def test_started_inside(radius_mm: float, height_mm: float) -> None:
    """Contact in the first tick at the nearest place outside; the force grows from nothing over engage_s."""
    core = Core([MESHES["globe"]], point_or_ball(radius_mm), engage_s=0.1)
    hip = np.tile(np.array([0.03, 0.05, 1.0]) * height_mm, (160, 1))
    rows = core.replay(hip)
    assert rows["errors"][0] & START_INSIDE
    assert rows["contact"].all()
    out = np.linalg.norm(rows["scp_mm"], axis=1) - radius_mm
    assert out.min() > 9.9
    assert out.max() < 10.01
    size = np.linalg.norm(rows["force_n"], axis=1)
    depth = 10.0 + radius_mm - np.linalg.norm(hip[0])
    assert size[0] < 1e-9
    assert np.diff(size).max() < 0.02 * depth + 0.01
    assert size[-1] == pytest.approx(depth, abs=0.1)


def test_nothing_near_on_the_next_level() -> None:
    """A switch to a level whose surface is elsewhere: contact lost, said, no force, found again on the way back."""
    vertices, faces = MESHES["plane"]
    elsewhere = (vertices * np.float32(0.1) + np.array([5.0, 5.0, 0.0], dtype=np.float32), faces)
    speeds = np.full(8, 1e9)
    speeds[0] = 100.0
    core = Core([(vertices, faces), elsewhere], point_or_ball(0.0), speeds_mm_s=speeds)
    core.tick(0.0, np.array([0.0, 0.0, 0.05]))
    assert core.tick(0.001, np.array([0.0, 0.0, -0.04]))["contact"] == 1
    row = core.tick(0.002, np.array([0.5, 0.0, -0.04]))
    assert (row["level"], row["contact"]) == (1, 0)
    assert row["errors"] & (1 << 5)
    assert not row["force_n"].any()


@pytest.mark.parametrize(
    "fields",
    [
        {"stiffness_n_mm": np.nan},
        {"damping_n_s_mm": -1.0},
        {"loop_hz": 0.0},
        {"hysteresis": 1.5},
        {"blend_s": np.inf},
        {"level_count": 9},
        {"mapping": 7},
    ],
)
def test_a_configuration_that_is_none_is_refused(fields: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(fields))):
        Core([MESHES["plane"]], point_or_ball(0.0), **fields)


@pytest.mark.parametrize("ball", [[0.0, 0.0, 0.0, -1.0], [np.nan, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, np.inf]])
def test_a_ball_that_is_none_is_refused(ball: list[float]) -> None:
    with pytest.raises(ValueError, match="ball"):
        Core([MESHES["plane"]], np.array([ball]))
