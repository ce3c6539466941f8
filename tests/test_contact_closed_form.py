"""The tick against what can be worked out by hand: plane, sphere, force law, limits, speed, switching, friction."""

from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

RADII_MM = [0.0, 0.5, 3.0]
FORCE_CLAMPED, SLEW_LIMITED, START_INSIDE = 1 << 6, 1 << 7, 1 << 9
MICRON_MM = 1e-3


def plane_core(radius_mm: float = 0.0, levels: int = 1, **fields: Any) -> Core:
    return Core([shapes.plane(cells=16)] * levels, point_or_ball(radius_mm), **fields)


def pressed(depth_mm: np.ndarray | float, radius_mm: float, ticks: int, x_mm: np.ndarray | float = 0.03) -> np.ndarray:
    """(ticks, 3) HIP below the place where a ball rests on z = 0, after one tick in free air."""
    hip = np.zeros((ticks, 3))
    hip[:, 0], hip[:, 1], hip[:, 2] = x_mm, 0.07, radius_mm - depth_mm
    hip[0, 2] = radius_mm + 0.5
    return hip


@pytest.mark.parametrize("radius_mm", RADII_MM)
def test_plane_rest_slide_leave_reenter(radius_mm: float) -> None:
    ticks = 600
    t = np.arange(ticks) / 1000.0
    depth = 0.5 * np.sin(2.0 * np.pi * 5.0 * t)  # in and out three times
    depth[100:150] = 0.5  # at rest in x too
    x = np.clip(np.arange(ticks) - 150, 0, None) * 0.01
    hip = pressed(depth, radius_mm, ticks, x)
    rows = plane_core(radius_mm, stiffness_n_mm=0.8).replay(hip)
    into = hip[:, 2] < radius_mm - 1e-6
    free = hip[:, 2] > radius_mm + 3e-4  # the skin is 0.11 um
    assert rows["contact"][into].all()
    assert not rows["contact"][free].any()
    expected = hip.copy()
    expected[into, 2] = radius_mm
    assert np.abs(rows["scp_mm"] - expected)[into | free].max() < MICRON_MM / 10.0
    force = 0.8 * (expected - hip)
    assert np.abs(rows["force_n"] - force)[into | free].max() < 1e-4


def chord_depth(vertices: np.ndarray, faces: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(n,) distance from the origin to a convex polyhedron's surface along unit directions (n, 3)."""
    corners = vertices.astype(np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    along = direction @ normal.T
    return np.where(along > 0.0, offset / np.where(along > 0.0, along, 1.0), np.inf).min(axis=1)


@pytest.mark.parametrize("radius_mm", RADII_MM)
def test_sphere_within_its_facets(radius_mm: float) -> None:
    """Pressed along a great circle: the SCP lies between the inscribed and the circumscribed sphere, about radially."""
    vertices, faces = shapes.sphere(10.0, 4)
    corners = vertices.astype(np.float64)[faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    circumradius = edge / np.sqrt(3.0) * 1.1  # nearly equilateral faces
    sagitta = 10.0 - np.sqrt(100.0 - circumradius**2)
    angle = np.linspace(0.0, 1.2, 900)
    depth = 0.4 * np.sin(np.linspace(0.0, 4.0 * np.pi, 900) - 0.3)
    direction = np.column_stack([np.sin(angle), 0.3 * np.ones(900), np.cos(angle)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hip = direction * (10.0 + radius_mm - depth)[:, None]
    rows = Core([(vertices, faces)], point_or_ball(radius_mm)).replay(hip)
    into = depth > sagitta + MICRON_MM
    free = depth < -MICRON_MM
    assert rows["contact"][into].all()
    assert not rows["contact"][free].any()
    held = rows["contact"] == 1
    height = np.linalg.norm(rows["scp_mm"][held], axis=1)
    assert height.max() < 10.0 + radius_mm + MICRON_MM
    assert height.min() > 10.0 + radius_mm - sagitta - MICRON_MM
    if radius_mm == 0.0:
        # A point lies on the polyhedron itself.
        scp = rows["scp_mm"][held]
        surface = chord_depth(vertices, faces, scp / height[:, None])
        assert np.abs(height - surface).max() < MICRON_MM


@pytest.mark.parametrize("slope_deg", [20.0, 30.0, 40.0])
@pytest.mark.parametrize("depth_mm", [0.2, 0.3, 0.45])
@pytest.mark.parametrize("ahead_mm", [1e-5, 3e-4, 3e-3])
def test_a_slow_slide_does_not_leap_over_where_it_ends(slope_deg: float, depth_mm: float, ahead_mm: float) -> None:
    """A ball over a roof's ridge, the HIP below it: it rolls off slowly at first, and is held by the flank beyond.

    The flank is narrow and ends in an open border: who leaps over it meets the roof from below.
    """
    slope, width_mm, radius_mm = np.radians(slope_deg), 0.4, 1.0
    profile = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, 0.0], [width_mm * np.cos(slope), -width_mm * np.sin(slope)]])
    along = np.arange(-6.0, 7.0)
    vertices = np.array([[x, y, z] for y in along for x, z in profile])
    first = np.array([row * 4 + k for row in range(len(along) - 1) for k in range(3)])
    faces = np.concatenate([np.stack([first, first + 1, first + 5], 1), np.stack([first, first + 5, first + 4], 1)])
    hip = np.tile([-0.3, 0.07, -depth_mm], (4, 1))
    hip[0, 2] = radius_mm + 0.5
    hip[2:, 0] = ahead_mm
    rows = Core([(vertices, faces)], point_or_ball(radius_mm)).replay(hip)
    assert rows["scp_mm"][1] == pytest.approx([-0.3, 0.07, radius_mm], abs=MICRON_MM)
    normal = np.array([np.sin(slope), 0.0, np.cos(slope)])
    on_flank = hip[3] + (radius_mm - hip[3] @ normal) * normal
    assert rows["scp_mm"][3] == pytest.approx(on_flank, abs=MICRON_MM)


def test_force_is_clamped_in_its_direction() -> None:
    hip = pressed(np.linspace(0.0, 5.0, 100), 0.0, 100)
    rows = plane_core(max_force_n=2.0).replay(hip)
    size = np.linalg.norm(rows["force_n"], axis=1)
    clamped = (rows["errors"] & FORCE_CLAMPED) != 0
    assert (clamped == (-hip[:, 2] > 2.0 + 1e-6)).all()
    assert np.abs(size[clamped] - 2.0).max() < 1e-9
    assert np.abs(rows["force_n"][clamped, :2]).max() < 1e-9


def test_slew_limit() -> None:
    hip = pressed(1.0, 0.0, 60)
    rows = plane_core(max_slew_n_s=50.0).replay(hip)
    steps = np.linalg.norm(np.diff(rows["force_n"], axis=0), axis=1)
    assert steps.max() <= 0.05 + 1e-12
    assert np.abs(rows["force_n"][1:21, 2] - 0.05 * np.arange(1, 21)).max() < 1e-3
    assert rows["force_n"][-1, 2] == pytest.approx(1.0, abs=1e-6)
    limited = (rows["errors"] & SLEW_LIMITED) != 0
    assert limited[1:20].all()
    assert not limited[25:].any()


def test_engagement_ramp() -> None:
    """Started 0.4 mm deep: contact at once, force growing linearly to k depth over engage_s."""
    hip = np.tile([0.03, 0.07, -0.4], (200, 1))
    rows = plane_core(engage_s=0.1).replay(hip)
    assert rows["errors"][0] & START_INSIDE
    assert rows["contact"].all()
    expected = 0.4 * np.clip(np.arange(200) / 100.0, 0.0, 1.0)
    assert np.abs(rows["force_n"][:, 2] - expected).max() < 0.4 * 0.02


def test_damping_never_pulls() -> None:
    """F = k d - b v, but never toward the surface on the way out."""
    depth = 1.0 - np.abs(np.linspace(-1.0, 1.0, 201))
    hip = pressed(depth, 0.0, 201)
    hip[0] = [0.03, 0.07, 0.01]
    rows = plane_core(damping_n_s_mm=0.02).replay(hip)
    velocity = np.concatenate([[0.0], np.diff(hip[:, 2])]) * 1000.0
    held = rows["contact"] == 1
    expected = np.maximum(-hip[:, 2] - 0.02 * velocity, 0.0)
    assert np.abs(rows["force_n"][held, 2] - expected[held]).max() < 1e-4
    assert rows["force_n"][:, 2].min() >= -1e-12
    assert (expected[held] == 0.0).sum() > 5


def test_speed_filter_hysteresis_and_dwell() -> None:
    """Speed and level of every tick against a plain re-implementation."""
    rng = np.random.default_rng(4)
    loop_hz, filter_hz, eta, dwell_s = 1000.0, 20.0, 0.15, 0.013
    thresholds = np.array([30.0, 60.0, 120.0])
    ticks = 4000
    along = np.cumsum(np.interp(np.arange(ticks), np.arange(0, ticks, 80), rng.uniform(0.0, 0.2, ticks // 80)))
    hip = np.column_stack([4.0 * np.sin(along / 4.0), 4.0 * np.cos(along / 4.0), np.full(ticks, 2.0)])
    hip += rng.normal(size=hip.shape) * 0.002
    speeds = np.full(8, 1e9)
    speeds[:3] = thresholds
    fields = {"filter_hz": filter_hz, "hysteresis": eta, "dwell_s": dwell_s, "speeds_mm_s": speeds}
    rows = plane_core(0.0, 4, **fields).replay(hip)

    alpha = 1.0 - np.exp(-2.0 * np.pi * filter_hz / loop_hz)
    times = np.arange(ticks) / loop_hz
    velocity, level, since = np.zeros(3), 0, np.inf
    want_speed, want_level = np.zeros(ticks), np.zeros(ticks, dtype=int)
    for k in range(ticks):
        period = times[k] - times[k - 1] if k else 1.0 / loop_hz
        if k:
            velocity = velocity + alpha * ((hip[k] - hip[k - 1]) / period - velocity)
        speed = float(np.linalg.norm(velocity))
        since += period
        asked = level
        if since >= dwell_s:
            asked += int((speed > thresholds[asked:] * (1.0 + eta)).sum())
            if asked == level:
                asked -= int((speed < thresholds[:asked] * (1.0 - eta)).sum())
        if asked != level:
            level, since = asked, 0.0
        want_speed[k], want_level[k] = speed, level
    assert np.abs(rows["speed_mm_s"] - want_speed).max() < 1e-4 * want_speed.max()
    assert (rows["level"] == want_level).all()
    switches = np.flatnonzero(np.diff(want_level))
    assert len(switches) > 20
    assert np.diff(switches).min() >= 13
    assert set(np.unique(want_level)) == {0, 1, 2, 3}


@pytest.mark.parametrize("blend_s", [0.0, 0.03])
def test_blend_bounds_the_step_at_a_switch(blend_s: float) -> None:
    """Two planes 0.2 mm apart: a jump of k d without the blend, at most k d dt / tau with it, plus the motion's own."""
    offset_mm, stiffness, ticks = 0.2, 1.0, 600
    low_v, faces = shapes.plane(cells=16)
    high = (low_v + np.array([0.0, 0.0, offset_mm], dtype=np.float32), faces)
    speeds = np.full(8, 1e9)
    speeds[0] = 50.0
    core = Core(
        [(low_v, faces), high], point_or_ball(0.0), blend_s=blend_s, speeds_mm_s=speeds, stiffness_n_mm=stiffness
    )
    fast = (np.arange(ticks) // 100) % 2  # slow, fast, slow ...: switches every 0.1 s
    x = np.abs(np.cumsum(np.where(fast, 0.1, 0.01)) % 6.0 - 3.0)
    hip = pressed(0.5 + 0.1 * np.sin(np.arange(ticks) / 40.0), 0.0, ticks, x)
    rows = core.replay(hip)
    switches = np.flatnonzero(np.diff(rows["level"].astype(int))) + 1
    switches = switches[switches > 5]  # the way down to the plane is fast too
    assert len(switches) == 5
    assert rows["contact"][1:].all()
    step = np.abs(np.diff(rows["force_n"][1:, 2]))
    motion = stiffness * 0.1 / 40.0
    if blend_s == 0.0:
        assert step[switches - 2].min() > stiffness * offset_mm - motion - 1e-3
    else:
        assert step.max() <= stiffness * offset_mm * 1e-3 / blend_s + motion + 1e-3
        settled = switches[0] + int(blend_s * 1000.0) + 2
        assert rows["scp_mm"][settled, 2] == pytest.approx(offset_mm, abs=MICRON_MM)


def inclined(slope: float) -> shapes.Mesh:
    """z = slope x, finer nowhere: one incline."""
    return shapes.height_field(lambda x, y: slope * x, 10.0, 16)


def pulled(normal: np.ndarray, depth_mm: float, downhill: np.ndarray, ticks: int) -> np.ndarray:
    """HIP at a steady depth, and beside that a sideways pull."""
    hip = -depth_mm * normal + downhill
    hip = np.tile(hip, (ticks, 1)) if hip.ndim == 1 else hip
    hip[0] = normal * 0.2
    hip[1] = -depth_mm * normal
    return hip


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_friction_on_an_incline(radius_mm: float) -> None:
    """The pull's angle against the static cone decides; sliding, the tangential force is mu_d times the normal one."""
    slope, mu_s, mu_d, depth = 0.5, 0.4, 0.25, 0.5
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    tangent = np.array([1.0, 0.0, slope]) / np.hypot(slope, 1.0)
    lift = normal * radius_mm
    mesh = inclined(slope)
    fields = {"friction_static": mu_s, "friction_dynamic": mu_d}

    held = Core([mesh], point_or_ball(radius_mm), **fields)
    rows = held.replay(lift + pulled(normal, depth, 0.9 * mu_s * depth * tangent, 500))
    # Held without drift: the SCP of the last tick is that of the first touch.
    assert np.abs(rows["scp_mm"][2:] - rows["scp_mm"][1]).max() < MICRON_MM / 10.0
    force = rows["force_n"][-1]
    assert force @ normal == pytest.approx(depth, rel=1e-3)
    assert force @ tangent == pytest.approx(-0.9 * mu_s * depth, rel=1e-3)

    slides = Core([mesh], point_or_ball(radius_mm), **fields)
    pull = np.linspace(0.0, 4.0, 400)[:, None] * tangent
    rows = slides.replay(lift + pulled(normal, depth, pull, 400))
    force = rows["force_n"][100:]
    across = -(force @ tangent)
    assert np.abs(force @ normal - depth).max() < 1e-3
    assert (across <= mu_s * depth + 1e-3).all()
    assert across.mean() == pytest.approx(mu_d * depth, rel=0.3)
    moved = np.linalg.norm(np.diff(rows["scp_mm"][100:], axis=0), axis=1) > 1e-6
    # While it slides, friction is the dynamic one.
    assert np.abs(across[1:][moved] - mu_d * depth).max() < 1e-3
    assert moved.any()
