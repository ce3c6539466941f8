"""Stiffness and friction of the surface against closed forms: plateaus, ramps between vertices, switches, energy."""

from typing import Any

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball
from test_contact_friction import fast_and_slow, switching_core

from hapticlod.layout import RECORD_DTYPE

DEPTH_MM = 0.5
PITCH_MM = 0.5  # of the plane's vertices
AS_STATION = -1.0
PLANE = shapes.plane(10.0, 40)


def by_x(mesh: shapes.Mesh, left: tuple, right: tuple) -> np.ndarray:
    """(n, 3) materials: `left` at the vertices with x < 0, `right` at the others."""
    return np.where(mesh[0][:, :1] < -1e-6, left, right)


def along_x(speed_mm_s: float, radius_mm: float, half_mm: float = 4.0) -> np.ndarray:
    """(T, 3) HIP at 1 kHz, DEPTH_MM under z = 0, from -half_mm to half_mm."""
    x = np.arange(-half_mm, half_mm, speed_mm_s / 1000.0)
    hip = np.column_stack([x, np.full_like(x, 0.07), np.full_like(x, radius_mm - DEPTH_MM)])
    hip[0, 2] = radius_mm + 0.2
    return hip


@pytest.mark.parametrize("radius_mm", [0.0, 0.5, 2.0])
@pytest.mark.parametrize(("left", "right", "station"), [(0.2, 0.8, 1.0), (0.9, 0.3, 1.0), (0.2, 5.0, 0.6)])
def test_plane_of_two_materials(left: float, right: float, station: float, radius_mm: float) -> None:
    """k depth on either side, never more than the station's k, linear between the vertices at the border."""
    made_of = by_x(PLANE, (left, AS_STATION, AS_STATION), (right, AS_STATION, AS_STATION))
    core = Core([PLANE], point_or_ball(radius_mm), materials=[made_of], stiffness_n_mm=station)
    hip = along_x(5.0, radius_mm)
    rows, x = core.replay(hip)[5:], hip[5:, 0]
    force = rows["force_n"][:, 2]
    low, high = min(left, station), min(right, station)
    expected = DEPTH_MM * np.interp(x, [-PITCH_MM, 0.0], [low, high])
    assert np.abs(force - expected).max() < 1e-6
    assert np.abs(rows["force_n"][:, :2]).max() < 1e-9
    assert (np.diff(force) * np.sign(high - low) > -1e-9).all()
    slope = DEPTH_MM * abs(high - low) / PITCH_MM
    assert np.abs(np.diff(force)).max() < slope * 0.005 * (1.0 + 1e-3)


def test_what_is_not_stated_is_the_stations() -> None:
    """A level whose vertices all say nothing feels like one without materials; an impossibly hard one too."""
    hip = along_x(20.0, 0.5)
    fields: dict[str, Any] = {"friction_static": 0.5, "friction_dynamic": 0.5, "stiffness_n_mm": 0.7, "shading": 1}
    plain = Core([PLANE], point_or_ball(0.5), **fields).replay(hip)
    for row in ((AS_STATION, AS_STATION, AS_STATION), (1e6, 0.5, 0.5)):
        rows = Core([PLANE], point_or_ball(0.5), materials=[by_x(PLANE, row, row)], **fields).replay(hip)
        assert np.abs(rows["force_n"] - plain["force_n"]).max() < 1e-6
        assert np.abs(rows["scp_mm"] - plain["scp_mm"]).max() < 1e-6


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_incline_holds_on_one_material_and_slides_on_the_other(radius_mm: float) -> None:
    """Pressed straight down on a slope of 0.4: mu 0.7 holds it, mu 0.2 lets it slide at the lean of its dynamic mu."""
    slope, mu_hold, mu_slip, mu_slide = 0.4, 0.7, 0.2, 0.15
    angle = np.arctan(slope)
    mesh = shapes.height_field(lambda x, y: slope * x, 20.0, 40)
    rough, smooth = (AS_STATION, mu_hold, 0.5), (AS_STATION, mu_slip, mu_slide)
    core = Core([mesh], point_or_ball(radius_mm), materials=[by_x(mesh, rough, smooth)])
    normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    uphill = np.array([np.cos(angle), 0.0, np.sin(angle)])
    press = np.concatenate([np.linspace(0.002, 1.0, 600), np.full(50, 1.0)])
    for x, holds in ((-8.0, True), (8.0, False)):
        place = normal * radius_mm + [x, 0.2, slope * x]
        hip = np.concatenate([place + [[0, 0, 1.0], [0, 0, 0.01]], place - press[:, None] * [0.0, 0.0, 1.0]])
        rows = core.replay(hip)[102:]
        along, across = rows["force_n"] @ normal, rows["force_n"] @ uphill
        moved = np.linalg.norm(np.diff(rows["scp_mm"], axis=0), axis=1) > 1e-6
        if holds:
            assert not moved.any()
            assert np.abs(rows["force_n"] - np.outer(press[100:], [0, 0, 1.0])).max() < 2e-3
        else:
            lean = np.degrees(np.arctan2(across, along))[1:][moved]
            assert moved.sum() >= 4
            assert np.abs(lean - np.degrees(np.arctan(mu_slide))).max() < 0.2
            assert (across <= mu_slip * along + 2e-3).all()


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_dragged_over_a_border_friction_follows_the_place(radius_mm: float) -> None:
    """mu_s = mu_d = mu(x): the pull is mu(SCP) k depth, within the way of a tick, and takes no step."""
    left, right, speed = 0.1, 0.5, 5.0
    made_of = by_x(PLANE, (AS_STATION, left, left), (AS_STATION, right, right))
    core = Core([PLANE], point_or_ball(radius_mm), materials=[made_of])
    hip = along_x(speed, radius_mm)
    rows = core.replay(hip)[200:]
    pull = -rows["force_n"][:, 0]
    mu = np.interp(rows["scp_mm"][:, 0], [-PITCH_MM, 0.0], [left, right])
    step = DEPTH_MM * (right - left) / PITCH_MM * speed / 1000.0
    assert np.abs(pull - mu * DEPTH_MM).max() < 1.5 * step
    assert np.abs(np.diff(rows["force_n"], axis=0)).max() < 1.5 * step
    assert pull[0] == pytest.approx(left * DEPTH_MM, abs=1e-6)
    assert pull[-1] == pytest.approx(right * DEPTH_MM, abs=1e-6)


def test_what_friction_holds_stays_on_its_material() -> None:
    """Stuck on the soft side with the hand over the hard one: the stiffness is that of the place that is touched."""
    made_of = by_x(PLANE, (0.3, 2.0, 1.5), (0.9, 2.0, 1.5))
    core = Core([PLANE], point_or_ball(0.0), materials=[made_of])
    hip = np.tile([-0.6, 0.07, -0.3], (300, 1))
    hip[:, 0] += np.clip(np.arange(300) - 50, 0, 100) * 0.005  # 0.5 mm within a cone of 0.6 mm
    hip[0, 2] = 0.2
    rows = core.replay(hip)[5:]
    assert np.abs(rows["scp_mm"][:, 0] + 0.6).max() < 1e-6
    assert np.abs(rows["force_n"][:, 2] - 0.3 * 0.3).max() < 1e-6
    assert rows["force_n"][-1, 0] == pytest.approx(-0.3 * 0.5, abs=1e-6)


@pytest.mark.parametrize("radius_mm", [0.0, 0.3])
def test_two_balls_on_two_materials(radius_mm: float) -> None:
    """2 mm apart on a plane, both touching: the mean of what lies below them, and no step as either crosses."""
    left, right, speed = 0.2, 0.8, 5.0
    tool = np.array([[0.0, 0.0, 0.0, radius_mm], [2.0, 0.0, 0.0, radius_mm]])
    made_of = by_x(PLANE, (left, AS_STATION, AS_STATION), (right, AS_STATION, AS_STATION))
    core = Core([PLANE], tool, materials=[made_of])
    hip = along_x(speed, radius_mm)
    rows, x = core.replay(hip)[5:], hip[5:, 0]
    under = [np.interp(x + offset, [-PITCH_MM, 0.0], [left, right]) for offset in (0.0, 2.0)]
    force = rows["force_n"][:, 2]
    assert np.abs(force - DEPTH_MM * np.mean(under, axis=0)).max() < 1e-3
    assert np.abs(np.diff(force)).max() < 1.1 * DEPTH_MM * (right - left) / PITCH_MM * speed / 1000.0
    # The torque is that of the force that is felt, wherever on the plane it acts.
    lever = rows["torque_n_mm"][:, 1] / force
    assert (lever <= 1e-6).all() and (lever >= -2.0 - 1e-6).all()


def test_a_groove_between_two_materials() -> None:
    """Walls of 0.3 and 0.9 N/mm: deep in the groove each counts by how hard it is pressed."""
    mesh = shapes.groove(10.0, 40)
    made_of = np.where(mesh[0][:, :1] < -1e-6, (0.3, -1, -1), (0.9, -1, -1))
    made_of[np.abs(mesh[0][:, 0]) < 1e-6, 0] = 0.6
    core = Core([mesh], point_or_ball(0.5), materials=[made_of])
    shift = np.linspace(-0.3, 0.3, 601)
    hip = np.column_stack([shift, np.full(601, 0.07), np.full(601, np.sqrt(2.0) * 0.5 - 0.5)])
    hip[0, 2] += 1.0
    rows = core.replay(hip)[5:]
    pull = rows["scp_mm"] - rows["hip_mm"]
    stiffness = np.linalg.norm(rows["force_n"], axis=1) / np.linalg.norm(pull, axis=1)
    # Pressed against the walls (1, 0, 1) and (-1, 0, 1) by these much; both are touched 0.35 mm up the wall.
    on_left, on_right = 0.5 - shift[5:], 0.5 + shift[5:]
    at = np.interp(0.5 / np.sqrt(2.0), [0.0, 0.5], [0.6, 0.3]), np.interp(0.5 / np.sqrt(2.0), [0.0, 0.5], [0.6, 0.9])
    expected = at[0] * on_left + at[1] * on_right
    assert np.abs(stiffness - expected).max() < 1e-3


@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_level_switch_blends_the_material(friction: float, radius_mm: float) -> None:
    """Levels on one plane, of 0.9 and 0.3 N/mm: without the blend a switch steps by 0.3 N, with it by a share."""
    meshes = [shapes.plane(30.0, 20), shapes.plane(30.0, 10)]
    made_of = [
        by_x(mesh, (k, mu, mu), (k, mu, mu))
        for mesh, k, mu in zip(meshes, (0.9, 0.3), (friction, 0.5 * friction), strict=True)
    ]
    hip = fast_and_slow(radius_mm)
    speeds = np.full(8, 1e9)
    speeds[0] = 50.0
    hard = Core(meshes, point_or_ball(radius_mm), materials=made_of, speeds_mm_s=speeds).replay(hip)
    soft = switching_core(meshes, radius_mm, materials=made_of).replay(hip)
    for rows in (hard, soft):
        assert rows["contact"][5:].all()
        assert np.count_nonzero(np.diff(rows["level"].astype(int))[10:]) >= 4
        k = np.where(rows["level"] == 0, 0.9, 0.3)
        settled = np.arange(len(rows)) % 150 > 60
        settled[:150] = False
        assert np.abs(rows["force_n"][:, 2] - k * DEPTH_MM)[settled].max() < 1e-6
    steps = [np.linalg.norm(np.diff(rows["force_n"], axis=0), axis=1)[10:].max() for rows in (hard, soft)]
    assert steps[0] > 0.29
    # A share of the normal force, of friction's (the trail starts anew), and the hand's way while it sticks.
    trail = friction * DEPTH_MM
    assert steps[1] < 1.2 * (0.6 * DEPTH_MM + trail) / 30.0 + (0.08 if friction else 0.0)


def test_levels_with_and_without_materials_mix() -> None:
    """A level without materials is the station's, whatever its neighbour says."""
    meshes = [shapes.plane(30.0, 20), shapes.plane(30.0, 10)]
    rows = switching_core(meshes, 0.0, materials=[by_x(meshes[0], (0.4, -1, -1), (0.4, -1, -1)), None]).replay(
        fast_and_slow(0.0)
    )
    settled = (np.arange(len(rows)) % 150 > 60) & (np.arange(len(rows)) > 150)
    expected = np.where(rows["level"] == 0, 0.4, 1.0) * DEPTH_MM
    assert np.abs(rows["force_n"][:, 2] - expected)[settled].max() < 1e-6


def test_energy_of_a_border_is_what_the_page_says() -> None:
    """Pressed in where it is soft, let go where it is hard: the hand gets half (k2 - k1) depth^2 back, and no more."""
    low, high = 0.2, 0.8
    core = Core([PLANE], point_or_ball(0.0), materials=[by_x(PLANE, (low, -1, -1), (high, -1, -1))])
    down = np.column_stack([np.full(201, -2.0), np.full(201, 0.07), np.linspace(0.5, -DEPTH_MM, 201)])
    over = np.column_stack([np.linspace(-2.0, 2.0, 801), np.full(801, 0.07), np.full(801, -DEPTH_MM)])
    up = down[::-1] + [4.0, 0.0, 0.0]
    hip = np.concatenate([down, over[1:], up[1:]])
    force = core.replay(hip)["force_n"]
    gained = np.einsum("ij,ij->", 0.5 * (force[1:] + force[:-1]), np.diff(hip, axis=0))
    assert gained == pytest.approx(0.5 * (high - low) * DEPTH_MM**2, abs=2e-4)
    back = core.replay(hip[::-1])["force_n"]
    assert np.einsum("ij,ij->", 0.5 * (back[1:] + back[:-1]), np.diff(hip[::-1], axis=0)) == pytest.approx(-gained)


def test_friction_of_materials_can_be_left_aside() -> None:
    """For replays that compare levels without friction: the stiffness stays, the friction is the station's."""
    from hapticlod import _runtime

    made_of = by_x(PLANE, (0.4, 0.6, 0.5), (0.4, 0.6, 0.5))
    core = Core([PLANE], point_or_ball(0.0), materials=[made_of])
    hip = along_x(5.0, 0.0)
    smooth = _runtime.Renderer(core.levels, core.config.tobytes(), point_or_ball(0.0), material_friction=False)
    raw = smooth.replay(np.arange(len(hip)) / 1000.0, hip, None, 1)
    rows = np.frombuffer(raw, dtype=RECORD_DTYPE)[5:]
    assert np.abs(rows["force_n"] - [0.0, 0.0, 0.4 * DEPTH_MM]).max() < 1e-6
    assert np.abs(core.replay(hip)["force_n"][200:, 0]).max() > 0.08


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ((np.nan, 0.1, 0.1), "stiffness is out of range"),
        ((0.0, 0.1, 0.1), "stiffness is out of range"),
        ((-2.0, 0.1, 0.1), "stiffness is out of range"),
        ((2e6, 0.1, 0.1), "stiffness is out of range"),
        ((1.0, np.inf, 0.1), "static friction is out of range"),
        ((1.0, AS_STATION, 0.1), "static friction is out of range"),
        ((1.0, 0.1, 0.2), "exceeds its static friction"),
        ((1.0, 0.1, AS_STATION), "negative"),
    ],
)
def test_impossible_materials_are_refused(row: tuple, fault: str) -> None:
    made_of = by_x(PLANE, (1.0, 0.2, 0.1), (1.0, 0.2, 0.1))
    made_of[7] = row
    with pytest.raises(ValueError, match=fault):
        Core([PLANE], point_or_ball(0.0), materials=[made_of])


def test_a_material_for_every_vertex() -> None:
    with pytest.raises(ValueError, match="differ in number"):
        Core([PLANE], point_or_ball(0.0), materials=[by_x(PLANE, (1, -1, -1), (1, -1, -1))[1:]])
    level = Core([PLANE], point_or_ball(0.0), materials=[by_x(PLANE, (1, -1, -1), (1, -1, -1))]).levels[0]
    plain = Core([PLANE], point_or_ball(0.0)).levels[0]
    assert level.bytes - plain.bytes == 12 * len(PLANE[0])
    assert "materials" in level.arrays() and "materials" not in plain.arrays()


@pytest.mark.parametrize("balls", [1, 25])
@pytest.mark.parametrize("friction", [0, 1])
def test_never_stiffer_than_the_station_nor_softer_than_the_softest(friction: int, balls: int) -> None:
    """Random materials on three levels of a sphere, a path with switches: |F| = k |SCP - HIP|, k in range."""
    rng = np.random.default_rng(balls + friction)
    meshes = [shapes.sphere(10.0, 4), shapes.sphere(9.97, 3), shapes.sphere(10.02, 2)]
    made_of = []
    for vertices, _ in meshes:
        mu = rng.uniform(0.1, 0.6, len(vertices)) * friction
        made_of.append(np.column_stack([rng.uniform(0.3, 3.0, len(vertices)), mu, 0.8 * mu]))
    tool = np.column_stack([rng.normal(size=(balls, 3)) * 0.4, rng.uniform(0.05, 0.3, balls)])
    speeds = np.full(8, 1e9)
    speeds[:2] = [25.0, 45.0]
    core = Core(meshes, tool, materials=made_of, blend_s=0.03, speeds_mm_s=speeds, filter_hz=30.0, stiffness_n_mm=0.8)
    t = np.arange(6000) / 1000.0
    way = np.column_stack([np.sin(4.0 * t) ** 3, np.cos(2.3 * t), 0.3 + np.sin(3.1 * t)])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    reach = float(np.linalg.norm(tool[:, :3], axis=1).max())
    rows = core.replay(way * (10.0 + 0.5 * reach + 0.7 * np.sin(9.0 * t))[:, None])
    assert len(set(rows["level"][rows["contact"] == 1])) == 3
    pull = np.linalg.norm(rows["scp_mm"] - rows["hip_mm"], axis=1)
    force = np.linalg.norm(rows["force_n"], axis=1)
    clear = pull > 1e-4
    stiffness = (force / np.maximum(pull, 1e-12))[clear & (rows["contact"] == 1)]
    assert len(stiffness) > 1000
    assert stiffness.min() > 0.3 - 1e-6 and stiffness.max() < 0.8 + 1e-9
    assert np.ptp(stiffness) > 0.2


def test_materials_do_not_move_the_contact() -> None:
    """40 balls, turned, over two levels, without friction: every SCP is the one without materials."""
    rng = np.random.default_rng(5)
    meshes = [shapes.sphere(10.0, 4), shapes.sphere(9.97, 3)]
    made_of = [np.column_stack([rng.uniform(0.3, 3.0, len(v)), *np.full((2, len(v)), AS_STATION)]) for v, _ in meshes]
    tool = np.column_stack([rng.normal(size=(40, 3)) * 0.5, rng.uniform(0.05, 0.3, 40)])
    t = np.arange(4000) / 1000.0
    way = np.column_stack([np.sin(4.0 * t) ** 3, np.cos(2.3 * t), 0.3 + np.sin(3.1 * t)])
    hip = way / np.linalg.norm(way, axis=1, keepdims=True) * (10.6 + 0.7 * np.sin(9.0 * t))[:, None]
    turn = np.column_stack([np.ones_like(t), 0.3 * np.sin(2.0 * t), 0.2 * np.cos(3.0 * t), 0.1 * t])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    speeds = np.full(8, 1e9)
    speeds[0] = 30.0
    plain, made = (
        Core(meshes, tool, materials=materials, blend_s=0.03, speeds_mm_s=speeds, filter_hz=30.0).replay(hip, turn)
        for materials in (None, made_of)
    )
    assert np.count_nonzero(np.diff(plain["level"].astype(int))) > 5
    assert np.abs(plain["scp_mm"] - made["scp_mm"]).max() < 1e-9
    assert np.array_equal(plain["contact"], made["contact"]) and plain["contact"].mean() > 0.5
    assert np.abs(plain["force_n"] - made["force_n"]).max() > 0.1
