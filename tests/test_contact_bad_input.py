"""Input that no hand or file should give: a defined result, an error bit that says so, and the next good tick is good.

test_contact_scale_and_faults.py has single faults under a point on a plane. Here they come in contact, with a shaped
tool, friction, blend and level switches, or many at once.
"""

from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

HIP_NOT_FINITE, PERIOD, HIP_JUMP, CONTACT_LOST, FORCE_CLAMPED, SLEW_LIMITED = 1, 2, 4, 1 << 5, 1 << 6, 1 << 7
MAX_FORCE_N, MAX_SLEW_N_S = 4.0, 1000.0
JACK = np.array([[0.0, 0.0, 0.0, 0.4], [0.8, 0.0, 0.1, 0.2], [-0.5, 0.6, 0.2, 0.0]])
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


def everything(levels: list | None = None, tool: np.ndarray = JACK, **fields: Any) -> Core:
    """Friction, damping, shading, blend, limits and two levels at once."""
    speeds = np.full(8, 1e9)
    speeds[0] = 60.0
    plane = shapes.plane(10.0, 20)
    settings: dict[str, Any] = {
        "friction_static": 0.4, "friction_dynamic": 0.3, "damping_n_s_mm": 1e-3, "blend_s": 0.02, "filter_hz": 50.0,
        "speeds_mm_s": speeds, "max_force_n": MAX_FORCE_N, "max_slew_n_s": MAX_SLEW_N_S, "engage_s": 0.05,
    }  # fmt: skip
    return Core(levels or [plane, plane], tool, **(settings | fields))


def pressed(core: Core, ticks: int = 60) -> np.void:
    """The last row of an approach to 0.5 mm under the plane; time goes on from ticks / 1000."""
    row = None
    for k in range(ticks):
        row = core.tick(k * 1e-3, np.array([0.1, 0.2, max(0.6 - 0.03 * k, -0.1)]), UNTURNED)
    assert row is not None
    assert row["contact"] == 1
    return row


def finite(row: np.void | np.ndarray) -> bool:
    return all(np.isfinite(row[name]).all() for name in ("hip_mm", "scp_mm", "force_n", "torque_n_mm", "speed_mm_s"))


WRONG = [np.nan, np.inf, -np.inf, 1e300, -1e300]


@pytest.mark.parametrize("value", WRONG)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_place_in_contact_with_all_options(axis: int, value: float) -> None:
    core = everything()
    before = pressed(core)
    place = np.array([0.1, 0.2, -0.1])
    place[axis] = value
    for k in range(20):
        row = core.tick(0.06 + k * 1e-3, place, UNTURNED)
        assert row["errors"] & HIP_NOT_FINITE
        assert finite(row)
        assert row["scp_mm"] == pytest.approx(before["scp_mm"], abs=1e-6)
    after = core.tick(0.08, np.array([0.1, 0.2, -0.11]), UNTURNED)
    assert after["errors"] in (0, SLEW_LIMITED)
    assert np.linalg.norm(after["force_n"] - row["force_n"]) < 0.1


@pytest.mark.parametrize("turn", [[np.nan] * 4, [np.inf, 0, 0, 0], [0.0] * 4, [1e300, 0, 0, 0], [1.0, 1.0, 0, 0]])
def test_an_orientation_in_contact_with_all_options(turn: list[float]) -> None:
    core = everything()
    before = pressed(core)
    for k in range(20):
        row = core.tick(0.06 + k * 1e-3, np.array([0.1, 0.2, -0.1]), np.array(turn))
        assert row["errors"] & HIP_NOT_FINITE
        assert finite(row)
    assert row["force_n"] == pytest.approx(before["force_n"], abs=1e-2)


@pytest.mark.parametrize("period_s", [0.0, -1e-3, -1e9, np.nan, np.inf, 5e-324, 1e-300, 1e300])
def test_a_period_that_is_none(period_s: float) -> None:
    """Not forward: the nominal period. Forward by almost nothing, or by years: finite all the same, within limits."""
    core = everything()
    before = pressed(core)
    row = core.tick(0.059 + period_s, np.array([0.1, 0.2, -0.12]), UNTURNED)
    assert bool(row["errors"] & PERIOD) == (not 0.059 < 0.059 + period_s < np.inf)
    assert finite(row)
    assert np.linalg.norm(row["force_n"]) <= MAX_FORCE_N * (1.0 + 1e-9)
    if row["errors"] & PERIOD:
        assert np.linalg.norm(row["force_n"] - before["force_n"]) <= MAX_SLEW_N_S * 1e-3 * (1.0 + 1e-9)


@pytest.mark.parametrize("glitch_s", [0.0, -100.0])
def test_one_wrong_time_stamp_does_not_lift_the_slew_limit(glitch_s: float) -> None:
    """A clock that runs back for one tick, 20 s into a session: the tick after it lasted 1 ms, not 20 s."""
    core = everything(max_slew_n_s=100.0, max_force_n=50.0)
    for k in range(60):
        core.tick(20.0 + k * 1e-3, np.array([0.1, 0.2, max(0.6 - 0.03 * k, 0.35)]), UNTURNED)
    before = core.tick(glitch_s, np.array([0.1, 0.2, 0.3]), UNTURNED)
    assert before["errors"] & PERIOD
    after = core.tick(20.061, np.array([0.1, 0.2, -2.0]), UNTURNED)
    step = np.linalg.norm(after["force_n"] - before["force_n"])
    assert step <= 100.0 * 2.1e-3, f"{step:.2f} N in a tick"


@pytest.mark.parametrize("far", [1e2, 1e5, 1e8])
def test_a_huge_jump_with_all_options(far: float) -> None:
    core = everything()
    pressed(core)
    for k, place in enumerate([[far, 0.0, 0.0], [0.1, 0.2, -far], [0.1, 0.2, 2.0], [0.1, 0.2, 0.3]]):
        row = core.tick(0.06 + k * 1e-3, np.array(place), UNTURNED)
        assert bool(row["errors"] & HIP_JUMP) == (k < 3)
        assert finite(row)
    assert row["contact"] == 1
    assert row["force_n"][2] > 0.0


@pytest.mark.parametrize("scale", [10.0, 1e3, 1e6])
def test_a_tool_much_larger_than_the_model(scale: float) -> None:
    """Its balls reach far beyond a 20 mm plate; pressed from above, it is pushed up."""
    tool = JACK * scale
    top = (tool[:, 3] - tool[:, 2]).max()
    core = everything([shapes.plate(0.3, 10.0, 8)] * 2, tool, friction_static=0.0, blend_s=0.0)
    rows = [core.tick(k * 1e-3, np.array([0.0, 0.0, top + 1.0 - 0.02 * k]), UNTURNED) for k in range(80)]
    assert all(finite(row) for row in rows)
    assert rows[-1]["contact"] == 1
    assert rows[-1]["force_n"][2] > 0.0
    assert not rows[5]["contact"]


@pytest.mark.parametrize("stiffness_n_mm", [100.0, 1e6])
def test_a_stiffness_beyond_all_stability(stiffness_n_mm: float) -> None:
    """The core renders what it is told, within force and slew limits, and says so in every tick that they cut.

    What a device can hold stable is known where the device is: the station bounds stiffness (station/stability.hpp).
    """
    core = everything(stiffness_n_mm=stiffness_n_mm)
    rows = np.array(
        [pressed(core)] + [core.tick(0.06 + k * 1e-3, np.array([0.1, 0.2, -0.1]), UNTURNED) for k in range(50)]
    )
    assert finite(rows)
    assert np.linalg.norm(rows["force_n"], axis=1).max() <= MAX_FORCE_N * (1.0 + 1e-9)
    assert (rows["errors"] & FORCE_CLAMPED).all()
    assert np.linalg.norm(np.diff(rows["force_n"], axis=0), axis=1).max() <= MAX_SLEW_N_S * 1e-3 * (1.0 + 1e-9)


@pytest.mark.parametrize("blend_s", [0.0, 0.02])
def test_a_level_with_no_triangles_near(blend_s: float) -> None:
    """A switch in contact to a level that lies elsewhere: said, no force after the gate, and found again on return."""
    vertices, faces = shapes.plane(10.0, 20)
    elsewhere = (vertices + np.array([300.0, 0.0, 0.0], dtype=np.float32), faces)
    core = everything([(vertices, faces), elsewhere], blend_s=blend_s)
    pressed(core)
    rows = [core.tick(0.06 + k * 1e-3, np.array([0.1 + 0.2 * k, 0.2, -0.1]), UNTURNED) for k in range(30)]
    switched = next(k for k, row in enumerate(rows) if row["level"] == 1)
    assert rows[switched]["errors"] & CONTACT_LOST
    assert all(finite(row) for row in rows)
    assert not rows[-1]["contact"]
    assert not rows[-1]["force_n"].any()
    at = rows[-1]["hip_mm"].copy()
    calm = [core.tick(0.09 + k * 1e-3, at + [0.0, 0.0, 0.02 * k], UNTURNED) for k in range(200)]
    assert calm[-1]["level"] == 0
    assert all(finite(row) for row in calm)
    down = [core.tick(0.29 + k * 1e-3, at + [0.0, 0.0, 4.0 - 0.02 * k], UNTURNED) for k in range(200)]
    assert down[-1]["contact"] == 1


@pytest.mark.parametrize("seed", range(4))
def test_a_storm_of_faults(seed: int) -> None:
    """Every third tick wrong in one way or another for 3000 ticks: finite, limited, said; then all is well at once."""
    rng = np.random.default_rng(seed)
    core = everything([shapes.sphere(10.0, 3), shapes.sphere(9.95, 2)])
    hip = shapes.wander(rng.normal(size=(50, 3)) * 7.0, 150.0, 3000)
    last = np.zeros(3)
    for k, place in enumerate(hip):
        time_s, turn = k * 1e-3, UNTURNED.copy()
        fault = rng.integers(0, 9)
        if fault == 0:
            place = place.copy()
            place[rng.integers(3)] = WRONG[rng.integers(len(WRONG))]
        elif fault == 1:
            turn[rng.integers(4)] = WRONG[rng.integers(len(WRONG))]
        elif fault == 2:
            time_s = float(rng.choice([np.nan, np.inf, -np.inf, time_s - 1e-3]))
        row = core.tick(time_s, place, turn)
        assert finite(row)
        if fault in (0, 1):
            assert row["errors"] & HIP_NOT_FINITE
        if fault == 2 and k > 0 and not np.isfinite(time_s):
            assert row["errors"] & PERIOD
        assert np.linalg.norm(row["force_n"]) <= MAX_FORCE_N * (1.0 + 1e-9)
        assert np.linalg.norm(row["force_n"] - last) <= MAX_SLEW_N_S * 3.1e-3
        last = row["force_n"]
    out = [core.tick(3.0 + k * 1e-3, np.array([0.0, 0.0, 12.0 + 0.01 * k]), UNTURNED) for k in range(2)]
    assert out[-1]["errors"] & (HIP_NOT_FINITE | PERIOD) == 0
    assert out[-1]["contact"] == 0


def test_shapes_and_types_are_refused_by_name() -> None:
    """What the bindings are given is checked before anything is touched."""
    core = Core([shapes.plane(10.0, 4)], point_or_ball(0.0))
    time_s = np.arange(3) / 1000.0
    with pytest.raises(ValueError, match="length"):
        core.renderer.replay(time_s, np.zeros((2, 3)), None, 1)
    with pytest.raises(ValueError, match="repeats"):
        core.renderer.replay(time_s, np.zeros((3, 3)), None, 0)
    with pytest.raises(TypeError):
        core.renderer.replay(time_s, np.zeros((3, 2)), None, 1)
