"""Friction, damping and force shading against closed forms: cone, trail, stick-slip, and no steps where none belong."""

from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball
from test_contact_motion import around_sphere, face_heights, inner_radius

DEPTH_MM = 0.5


def incline(angle_rad: float, radius_mm: float, **fields: Any) -> tuple[Core, np.ndarray, np.ndarray]:
    """A plane that rises with x at this angle, its unit normal, and the unit direction uphill."""
    slope = np.tan(angle_rad)
    core = Core([shapes.height_field(lambda x, y: slope * x, 20.0, 20)], point_or_ball(radius_mm), **fields)
    return (
        core,
        np.array([-np.sin(angle_rad), 0.0, np.cos(angle_rad)]),
        np.array([np.cos(angle_rad), 0.0, np.sin(angle_rad)]),
    )


def lowered(place: np.ndarray, normal: np.ndarray, depth_mm: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(T, 3) HIP that comes from 1 mm above the place and then is depth_mm along a direction from it."""
    hip = place + depth_mm[:, None] * direction
    return np.concatenate([place - direction * np.linspace(1.0, 0.01, 20)[:, None], hip])


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
@pytest.mark.parametrize("mu_s", [0.2, 0.7])
def test_weight_on_an_incline_holds_below_the_static_angle(mu_s: float, radius_mm: float) -> None:
    """Pressed straight down for 10 s with a tremor of 10 Hz: at 95 % of the cone's angle nothing creeps."""
    angle = 0.95 * np.arctan(mu_s)
    core, normal, _ = incline(angle, radius_mm, friction_static=mu_s, friction_dynamic=0.8 * mu_s)
    down = np.array([0.0, 0.0, -1.0])
    press = DEPTH_MM * (1.0 + 0.3 * np.sin(2.0 * np.pi * 10.0 * np.arange(10_000) / 1000.0))
    press[:100] *= np.linspace(0.002, 1.0, 100)  # the first touch is met without friction: a light one
    hip = lowered(normal * radius_mm + [0.3, 0.2, 0.3 * np.tan(angle)], normal, press, down)
    rows = core.replay(hip)[20:]
    assert rows["contact"].all()
    drift = np.linalg.norm(rows["scp_mm"] - rows["scp_mm"][100], axis=1)
    assert drift.max() < 1e-6, f"crept {drift.max() * 1e6:.3f} nm"
    assert np.abs(rows["force_n"][:, 2] - press)[100:].max() < 2e-3
    assert np.abs(rows["force_n"][:, :2]).max() < 2e-3


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
@pytest.mark.parametrize(("mu_s", "mu_d"), [(0.3, 0.3), (0.3, 0.1), (0.6, 0.4)])
def test_weight_slides_above_the_static_angle(mu_s: float, mu_d: float, radius_mm: float) -> None:
    """While the hand sinks straight down, every slipping tick's force leans from the normal by atan(mu_d)."""
    angle = np.arctan(mu_s) + 0.15
    core, normal, uphill = incline(angle, radius_mm, friction_static=mu_s, friction_dynamic=mu_d)
    press = np.linspace(0.05, 1.5, 600)
    hip = lowered(normal * radius_mm, normal, press, np.array([0.0, 0.0, -1.0]))
    rows = core.replay(hip)[20:]
    force = rows["force_n"]
    along, across = force @ normal, force @ uphill
    assert np.abs(along - press * np.cos(angle)).max() < 2e-3
    moved = np.linalg.norm(np.diff(rows["scp_mm"], axis=0, prepend=rows["scp_mm"][:1]), axis=1) > 1e-6
    assert moved[10:].sum() >= 4
    moved[:10] = False
    lean = np.degrees(np.arctan2(across, along))[moved]
    assert np.abs(lean - np.degrees(np.arctan(mu_d))).max() < 0.2
    # Stuck or slipping, never beyond the static cone, never pushed downhill.
    assert (across <= mu_s * along + 2e-3).all()
    assert (across >= -2e-3).all()


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_stick_slip_has_its_period(radius_mm: float, way: float) -> None:
    """Dragged at 10 mm/s: held to mu_s N, let go to mu_d N, once every (mu_s - mu_d) depth of travel."""
    mu_s, mu_d, speed = 0.6, 0.2, 10.0
    core = Core([shapes.plane(20.0, 20)], point_or_ball(radius_mm), friction_static=mu_s, friction_dynamic=mu_d)
    ticks = 1200
    hip = np.zeros((ticks, 3))
    hip[:, 0] = way * np.clip(np.arange(ticks) - 50, 0, None) * speed / 1000.0
    hip[:, 1] = 0.07
    hip[:, 2] = radius_mm - DEPTH_MM
    hip[0, 2] = radius_mm + 0.2
    pull = -way * core.replay(hip)["force_n"][100:, 0]
    assert pull.max() == pytest.approx(mu_s * DEPTH_MM, abs=1.1e-2)  # k v T = 0.01 N
    assert pull.min() == pytest.approx(mu_d * DEPTH_MM, abs=1e-3)
    slips = np.flatnonzero(np.diff(pull) < -0.5 * (mu_s - mu_d) * DEPTH_MM)
    period = (mu_s - mu_d) * DEPTH_MM / speed * 1000.0
    assert len(slips) > 40
    assert np.abs(np.diff(slips) - period).max() <= 1.0 + 1e-9


def test_equal_coefficients_slide_without_a_step() -> None:
    """mu_s = mu_d: no slip to see, the force is steady once it slides."""
    mu = 0.4
    core = Core([shapes.plane(20.0, 20)], point_or_ball(0.0), friction_static=mu, friction_dynamic=mu)
    ticks = 800
    hip = np.tile([0.0, 0.07, -DEPTH_MM], (ticks, 1))
    hip[:, 0] = np.clip(np.arange(ticks) - 50, 0, None) * 0.01
    hip[0, 2] = 0.2
    force = core.replay(hip)["force_n"][200:]
    assert np.abs(force - [-mu * DEPTH_MM, 0.0, DEPTH_MM]).max() < 1e-3


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_friction_takes_work_round_a_loop(radius_mm: float) -> None:
    """A closed square of 4 x 2 mm dragged twice: the hand's work is mu_d N per length, within the slips."""
    mu = 0.3
    core = Core([shapes.plane(20.0, 20)], point_or_ball(radius_mm), friction_static=mu, friction_dynamic=mu)
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    flat = np.concatenate([np.linspace(corners[i % 4], corners[(i + 1) % 4], 200, endpoint=False) for i in range(9)])
    hip = np.column_stack([flat, np.full(len(flat), radius_mm - DEPTH_MM)])
    hip = np.concatenate([[[0.0, 0.0, radius_mm + 0.2]], hip])
    rows = core.replay(hip)
    step = np.diff(hip, axis=0)[200:]  # from the second side on: it slides
    work = -np.einsum("ij,ij->i", 0.5 * (rows["force_n"][1:] + rows["force_n"][:-1])[200:], step).sum()
    length = np.linalg.norm(step, axis=1).sum()
    # At each corner the trail swings round: there the pull is not along the way.
    assert 0.85 * mu * DEPTH_MM * length < work < mu * DEPTH_MM * length * 1.001


@pytest.mark.parametrize("filter_hz", [0.0, 30.0])
def test_damping_resists_the_slide(filter_hz: float) -> None:
    """F = k d - b v: sliding at v, the tangential force is b v; it builds up with the filter's time constant."""
    damping, speed = 2e-3, 60.0
    core = Core([shapes.plane(20.0, 20)], point_or_ball(0.0), damping_n_s_mm=damping, filter_hz=filter_hz)
    ticks = 300
    hip = np.tile([0.0, 0.07, -DEPTH_MM], (ticks, 1))
    hip[:, 0] = np.clip(np.arange(ticks) - 100, 0, None) * speed / 1000.0
    hip[0, 2] = -DEPTH_MM + 0.51
    force = core.replay(hip)["force_n"]
    since = np.clip(np.arange(ticks) - 100, 0, None)
    built = 1.0 - np.exp(-2.0 * np.pi * filter_hz * since / 1000.0) if filter_hz else (since > 0).astype(float)
    assert np.abs(force[90:, 0] + damping * speed * built[90:]).max() < 1e-4
    assert np.abs(force[90:, 2] - DEPTH_MM).max() < 1e-3


def turns_deg(force: np.ndarray) -> np.ndarray:
    """(T - 1,) angle between successive forces."""
    unit = force / np.linalg.norm(force, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", unit[1:], unit[:-1]), -1.0, 1.0)))


def round_the_sphere(radius_mm: float) -> np.ndarray:
    """(2000, 3) HIP 0.5 mm deep in a sphere of 10 mm, at 100 mm/s."""
    angle = np.arange(2000) * 0.1 / 10.0
    way = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(0.3), np.sin(angle) * np.sin(0.3)])
    hip = way * (10.0 + radius_mm - DEPTH_MM)
    hip[0] = way[0] * (10.3 + radius_mm)
    return hip


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_shading_is_continuous_across_edges(radius_mm: float) -> None:
    """On 1280 faces a point's force turns by up to a dihedral angle per tick; shaded, by little more than the way."""
    mesh, hip = shapes.sphere(10.0, 3), round_the_sphere(radius_mm)
    plain = Core([mesh], point_or_ball(radius_mm)).replay(hip)["force_n"][5:]
    shaded = Core([mesh], point_or_ball(radius_mm), shading=1).replay(hip)["force_n"][5:]
    radial = hip[5:] / np.linalg.norm(hip[5:], axis=1, keepdims=True)
    lean = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", radial, shaded) / np.linalg.norm(shaded, axis=1), -1, 1)))
    assert turns_deg(plain).max() > 8.0
    assert turns_deg(shaded).max() < 0.4 * turns_deg(plain).max()
    # Vertex normals of an icosphere are all but radial.
    assert lean.max() < 3.0
    # Shading turns the force, it does not make it.
    assert np.abs(np.linalg.norm(shaded, axis=1) - np.linalg.norm(plain, axis=1)).max() < 1e-9


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_a_shaded_force_belongs_to_its_place(radius_mm: float) -> None:
    """Moved 0.1 mm, then at rest: SCP and HIP are the same in both ticks, so must be force and torque."""
    mesh, hip = shapes.sphere(10.0, 3), np.repeat(round_the_sphere(radius_mm)[:400], 2, axis=0)
    rows = Core([mesh], point_or_ball(radius_mm), shading=1).replay(hip)[20:]
    same = np.linalg.norm(rows["scp_mm"][1::2] - rows["scp_mm"][::2], axis=1) < 1e-6
    assert same.mean() > 0.8
    assert np.abs(rows["force_n"][1::2] - rows["force_n"][::2])[same].max() < 1e-4
    assert np.abs(rows["torque_n_mm"][1::2] - rows["torque_n_mm"][::2])[same].max() < 1e-4


def test_shading_is_continuous_through_a_groove() -> None:
    """Across the bottom of a groove of 90 degrees, where two walls hold the point."""
    hip = np.zeros((801, 3))
    hip[:, 0] = np.linspace(-2.0, 2.0, 801)
    hip[:, 1] = 0.07
    hip[:, 2] = np.abs(hip[:, 0]) - DEPTH_MM
    hip[0, 2] += 1.0
    force = Core([shapes.groove(10.0, 40)], point_or_ball(0.0), shading=1).replay(hip)["force_n"][2:]
    steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
    # 5 um per tick; the normal turns by 45 degrees over an edge length of 0.5 mm.
    assert steps.max() < 0.02, f"step of {steps.max():.4f} N"


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_shading_leaves_friction(radius_mm: float) -> None:
    """On a plane every interpolated normal is the plane's: shading changes nothing, friction included."""
    hip = np.tile([0.0, 0.07, radius_mm - DEPTH_MM], (400, 1))
    hip[:, 0] = np.arange(400) * 0.01
    hip[0, 2] = radius_mm + 0.2
    forces = [
        Core(
            [shapes.plane(20.0, 20)],
            point_or_ball(radius_mm),
            shading=shading,
            friction_static=0.4,
            friction_dynamic=0.3,
        ).replay(hip)["force_n"]
        for shading in (0, 1)
    ]
    assert np.abs(forces[0] - forces[1]).max() < 1e-6


def switching_core(levels: list, radius_mm: float, **fields: Any) -> Core:
    """Level 1 above 50 mm/s, blend over 30 ms."""
    speeds = np.full(8, 1e9)
    speeds[0] = 50.0
    return Core(levels, point_or_ball(radius_mm), blend_s=0.03, speeds_mm_s=speeds, **fields)


def fast_and_slow(radius_mm: float, ticks: int = 900) -> np.ndarray:
    """(T, 3) pressed 0.5 mm into z = 0, 150 ms at 10 mm/s and at 80 mm/s in turns."""
    fast = (np.arange(ticks) // 150) % 2
    hip = np.tile([0.0, 0.07, radius_mm - DEPTH_MM], (ticks, 1))
    hip[:, 0] = np.cumsum(np.where(fast, 0.08, 0.01)) - 20.0
    hip[0, 2] = hip[1, 2] + DEPTH_MM + 0.02
    return hip


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
@pytest.mark.parametrize(("friction", "shading"), [(0.0, 0), (0.4, 0), (0.4, 1), (0.0, 1)])
def test_friction_and_shading_across_level_switches(friction: float, shading: int, radius_mm: float) -> None:
    """Two levels 0.1 mm apart and tilted by 3 degrees: with the blend no tick's force steps by more than its share."""
    tilt = np.tan(np.radians(3.0))
    low = shapes.plane(30.0, 20)
    high = shapes.height_field(lambda x, y: 0.1 + tilt * y, 30.0, 20)
    core = switching_core([low, high], radius_mm, shading=shading, friction_static=friction, friction_dynamic=friction)
    hip = fast_and_slow(radius_mm)
    rows = core.replay(hip)
    switches = np.flatnonzero(np.diff(rows["level"].astype(int))[10:]) + 11
    assert len(switches) >= 4
    assert rows["contact"][5:].all()
    steps = np.linalg.norm(np.diff(rows["force_n"], axis=0), axis=1)[10:]
    # Over tau: the levels' offset and, with friction, the trail that starts anew. And the motion: k v T while it
    # sticks, the lean's share of it otherwise.
    trail = friction * (DEPTH_MM + 0.2)
    motion = 0.08 if friction else 0.01
    share = 1.2 * (0.1 + trail) / 30.0 + motion
    assert steps.max() < share, f"largest step {steps.max():.4f} N, share {share:.4f} N"


@pytest.mark.parametrize(("radius_mm", "seed"), [(0.0, 1), (0.0, 5), (0.5, 0), (0.5, 1)])
def test_friction_never_lets_through(radius_mm: float, seed: int) -> None:
    """200 mm/s into a sphere of 1280 faces: without friction nothing passes, nor must it with."""
    mesh = shapes.sphere(10.0, 3)
    hip = shapes.wander(around_sphere(np.random.default_rng(seed), 5.0, 12.0), 200.0, 4000)
    for fields in ({}, {"friction_static": 0.5, "friction_dynamic": 0.3}):
        rows = Core([mesh], point_or_ball(radius_mm), **fields).replay(hip)
        low = face_heights(mesh, rows["scp_mm"]) if radius_mm == 0.0 else np.linalg.norm(rows["scp_mm"], axis=1)
        least = 0.0 if radius_mm == 0.0 else inner_radius(mesh) + radius_mm
        assert rows["contact"].mean() > 0.15
        assert low.min() > least - 1e-3, f"tick {np.argmax(low < least - 1e-3)}: {least - low.min():.3f} mm too deep"


def test_a_held_tool_turns_out_of_the_surface() -> None:
    """A ball on the plane and a point beside it: the point is turned down 0.2 mm, the tool must rise by as much."""
    balls = np.array([[0.0, 0.0, 0.0, 0.5], [2.0, 0.0, -0.5, 0.0]])
    core = Core([shapes.plane(20.0, 20)], balls, friction_static=0.8, friction_dynamic=0.6)
    angle = np.concatenate([np.zeros(50), np.linspace(0.0, 0.1, 100)])
    turn = np.column_stack([np.cos(0.5 * angle), 0.0 * angle, np.sin(0.5 * angle), 0.0 * angle])
    hip = np.tile([0.0, 0.07, 0.0], (150, 1))
    hip[0, 2] = 0.7
    rows = core.replay(hip, turn)
    point = rows["scp_mm"][:, 2] - 2.0 * np.sin(angle) - 0.5 * np.cos(angle)
    assert rows["contact"][1:].all()
    assert point.min() > -1e-3, f"{-point.min():.3f} mm below the plane"
