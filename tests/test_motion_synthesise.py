"""Hands made on surfaces whose geometry is known in closed form."""

import time
from pathlib import Path

import numpy as np
import pytest
from motion_shapes import Mesh, cube, plate, sphere

from hapticlod.errors import InputError
from hapticlod.motion import MODES, load_motion, save_motion, synthesise
from hapticlod.motion.hand import round_crests, shaft_orientation
from hapticlod.motion.strokes import (
    BASE_HZ,
    STROKES,
    Mode,
    draw_strokes,
    slow_noise,
    spread_normals,
    stroke_speed,
    tremor_mm,
)
from hapticlod.motion.surface import Surface
from hapticlod.motion.synthesise import strokes_in_air
from hapticlod.motion.walk import start_on
from hapticlod.tool import ball, load_tool

CONFIGS = Path(__file__).parents[1] / "configs"
# p50, p95, max in mm/s: the table of PERCEPTION.md section 4
TABLE = {"probe": (13, 30, 75), "trace": (31, 61, 113), "scan": (36, 85, 186), "transfer": (120, 304, 418)}


@pytest.fixture(scope="module")
def ball_mesh() -> Mesh:
    return sphere()


@pytest.fixture(scope="module")
def plate_mesh() -> Mesh:
    return plate()


@pytest.mark.parametrize("mode", MODES)
def test_speeds_are_those_of_the_table(mode: str, ball_mesh: Mesh) -> None:
    hands = [synthesise(ball_mesh, mode, seconds=20.0, loop_hz=1000.0, seed=seed) for seed in range(2)]  # type: ignore[arg-type]
    speed = np.concatenate([hand.speed_mm_s() for hand in hands])
    p50, p95, most = TABLE[mode]
    assert np.quantile(speed, 0.5) == pytest.approx(p50, rel=0.2)
    assert np.quantile(speed, 0.95) == pytest.approx(p95, rel=0.25)
    assert 0.6 * most < speed.max() < 1.4 * most


@pytest.mark.parametrize("radius_mm", [0.0, 1.0, 3.0])
def test_hip_is_pushed_in_by_force_over_stiffness(radius_mm: float, ball_mesh: Mesh) -> None:
    for stiffness in (0.5, 2.0):
        motion = synthesise(
            ball_mesh, "trace", seconds=10.0, loop_hz=1000.0, seed=3, tool=ball(radius_mm), stiffness_n_mm=stiffness,
            force_n=1.0, encoder_mm=0.0,
        )  # fmt: skip
        depth = 50.0 + radius_mm - np.linalg.norm(motion.position_mm, axis=1)
        force = stiffness * depth[depth > 0.1]
        assert 0.5 < np.median(force) < 2.0  # log-normal about 1 N, one draw per contact
        assert force.max() < 6.0
        assert 0.85 < np.mean(depth > 0) < 0.99  # some air
        assert motion.provenance["contact_share"] == pytest.approx(np.mean(depth > 0), abs=0.03)


def test_force_is_capped_by_the_device(ball_mesh: Mesh) -> None:
    motion = synthesise(ball_mesh, "scan", seconds=5.0, loop_hz=1000.0, seed=0, force_n=5.0, max_force_n=3.3)
    depth = 50.0 - np.linalg.norm(motion.position_mm, axis=1)
    assert depth.max() < 3.3 + 0.3


def test_starts_and_ends_in_the_air_and_taps(plate_mesh: Mesh) -> None:
    motion = synthesise(plate_mesh, "probe", seconds=20.0, loop_hz=1000.0, seed=0)
    height = motion.position_mm[:, 2]
    assert height[0] > 1.0 and height[-1] > 1.0
    touches = np.sum((height[1:] < 0) & (height[:-1] >= 0))
    assert touches >= 5
    carried = synthesise(plate_mesh, "transfer", seconds=20.0, loop_hz=1000.0, seed=0)
    assert 0.3 < np.mean(carried.position_mm[:, 2] < 0) < 0.85  # skims, and slides in contact
    fast_contact = carried.speed_mm_s()[carried.position_mm[:, 2] < -0.1]
    assert np.quantile(fast_contact, 0.9) > 120.0


@pytest.mark.parametrize("mode", MODES)
def test_stays_off_open_borders(mode: str, plate_mesh: Mesh) -> None:
    motion = synthesise(plate_mesh, mode, seconds=20.0, loop_hz=1000.0, seed=2)  # type: ignore[arg-type]
    inside = 50.0 - np.abs(motion.position_mm[:, :2]).max(axis=1)
    assert inside.min() > -1.0
    assert np.mean(inside < 1.0) < 0.02


def test_same_seed_is_the_same_hand_at_every_rate(plate_mesh: Mesh) -> None:
    slow, again, other = (
        synthesise(plate_mesh, "scan", seconds=3.0, loop_hz=1000.0, seed=seed, encoder_mm=0.0) for seed in (5, 5, 6)
    )
    fast = synthesise(plate_mesh, "scan", seconds=3.0, loop_hz=4000.0, seed=5, encoder_mm=0.0)
    assert slow.digest == again.digest != other.digest
    assert fast.ticks == 4 * slow.ticks == 12_000
    np.testing.assert_allclose(fast.position_mm[::4], slow.position_mm, atol=1e-9)


def test_encoder_steps(plate_mesh: Mesh) -> None:
    motion = synthesise(plate_mesh, "probe", seconds=2.0, loop_hz=1000.0, seed=0, encoder_mm=0.023)
    steps = motion.position_mm / 0.023
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_tremor_is_30_um_at_10_hz() -> None:
    shaken = tremor_mm(60_000, np.random.default_rng(0))
    assert shaken.std(axis=0) == pytest.approx(0.03, rel=0.15)
    power = np.abs(np.fft.rfft(shaken[:, 0])) ** 2
    frequency = np.fft.rfftfreq(len(shaken), 1 / BASE_HZ)
    assert frequency[np.argmax(power)] == pytest.approx(10.0, abs=2.0)
    band = power[(frequency > 7) & (frequency < 13)].sum() / power.sum()
    assert band > 0.7


def test_slow_noise_has_unit_rms_below_3_hz() -> None:
    noise = slow_noise(200_000, np.random.default_rng(0))
    assert noise.std() == pytest.approx(1.0, rel=0.1)
    power = np.abs(np.fft.rfft(noise)) ** 2
    assert power[np.fft.rfftfreq(len(noise), 1 / BASE_HZ) > 6.0].sum() < 0.01 * power.sum()


def test_shaft_follows_the_normal_slowly_and_without_flips(ball_mesh: Mesh) -> None:
    burr = load_tool(CONFIGS / "tools" / "burr_flame.toml")
    motion = synthesise(ball_mesh, "scan", seconds=5.0, loop_hz=1000.0, seed=1, tool=burr)
    assert motion.orientation is not None
    w, x, y, z = motion.orientation.T
    shaft = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    outward = motion.position_mm / np.linalg.norm(motion.position_mm, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", shaft, outward).min() > 0.9
    turn_rad = 2 * np.arccos(
        np.clip(np.abs(np.einsum("ij,ij->i", motion.orientation[1:], motion.orientation[:-1])), 0, 1)
    )
    assert turn_rad.max() * 1000.0 < 5.0  # rad/s
    assert synthesise(ball_mesh, "scan", seconds=1.0, loop_hz=1000.0, seed=1, tool=ball(1.0)).orientation is None


def test_shaft_orientation_through_the_pole_opposite_to_z() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 4000)
    normals = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    quaternions = shaft_orientation(normals, 1000.0)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-9)
    assert np.abs(np.diff(quaternions, axis=0)).max() < 0.01


def test_dirty_meshes_are_walked(tmp_path: Path) -> None:
    mesh = plate(60.0, 30)
    rng = np.random.default_rng(0)
    flipped = np.where((rng.random(len(mesh.faces)) < 0.05)[:, None], mesh.faces[:, ::-1], mesh.faces)
    soup = Mesh(vertices=mesh.vertices[flipped].reshape(-1, 3), faces=np.arange(3 * len(flipped)).reshape(-1, 3))
    fins = Mesh(
        vertices=np.vstack([mesh.vertices, [[0, 0, 8], [5, 5, 0]]]),
        faces=np.vstack([mesh.faces, mesh.faces[:50], [[480, 481, 961]], [[3, 3, 3]]]),
    )
    for dirty in (soup, fins):
        motion = synthesise(dirty, "scan", seconds=4.0, loop_hz=1000.0, seed=0)
        assert np.isfinite(motion.position_mm).all()
        assert np.abs(motion.position_mm[:, :2]).max() < 36.0


def test_thin_plate_keeps_to_its_side() -> None:
    upper, lower = plate(60.0, 60), plate(60.0, 60)
    apart = np.array([0.0, 0.0, 0.15])
    vertices = np.vstack([upper.vertices + apart, lower.vertices - apart])
    faces = np.vstack([upper.faces, lower.faces[:, ::-1] + len(upper.vertices)])
    motion = synthesise(Mesh(vertices=vertices, faces=faces), "trace", seconds=4.0, loop_hz=1000.0, seed=0)
    side = np.sign(motion.position_mm[0, 2])
    in_air = np.abs(motion.position_mm[:, 2]) > 1.5
    assert (np.sign(motion.position_mm[in_air, 2]) == side).all() and in_air.any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"seconds": 0.5},
        {"seconds": float("nan")},
        {"loop_hz": 0.0},
        {"stiffness_n_mm": -1.0},
        {"force_n": 0.0},
        {"mode": "probing"},
    ],
)
def test_senseless_requests_are_refused(wrong: dict, plate_mesh: Mesh) -> None:
    wanted = {"mode": "probe", "seconds": 2.0, "loop_hz": 1000.0, "seed": 0, **wrong}
    with pytest.raises(InputError):
        synthesise(plate_mesh, wanted.pop("mode"), **wanted)
    with pytest.raises(InputError, match="no area"):
        synthesise(
            Mesh(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]])), "probe", seconds=2.0, loop_hz=1000.0, seed=0
        )


def test_surface_of_a_sphere_in_closed_form(ball_mesh: Mesh) -> None:
    surface = Surface(ball_mesh)
    rng = np.random.default_rng(0)
    outward = rng.normal(size=(500, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    places, normals = surface.project(50.3 * outward)
    assert np.abs(np.linalg.norm(places, axis=1) - 50.0).max() < 0.03
    assert np.einsum("ij,ij->i", normals, outward).min() > 0.999
    assert np.isinf(surface.border_mm).all()


def slab(thickness_mm: float, side_mm: float = 40.0) -> Mesh:
    """Two parallel plates that face away from each other, open at the rim."""
    sheet = plate(side_mm, 40)
    apart = np.array([0.0, 0.0, 0.5 * thickness_mm])
    vertices = np.vstack([sheet.vertices + apart, sheet.vertices - apart])
    return Mesh(vertices, np.vstack([sheet.faces, sheet.faces[:, ::-1] + len(sheet.vertices)]))


def test_bearing_is_the_distance_to_the_medial_axis(ball_mesh: Mesh) -> None:
    places = np.column_stack([np.linspace(-8, 8, 50), np.linspace(5, -5, 50), np.full(50, 0.6)])
    up = np.tile([0.0, 0.0, 1.0], (50, 1))
    bearing = Surface(slab(1.2)).bearing_mm(places, up, np.full(50, 3.0))
    np.testing.assert_allclose(bearing, 0.6, atol=0.08)
    np.testing.assert_allclose(Surface(slab(1.2)).bearing_mm(places, up, np.full(50, 0.2)), 0.2)  # asked for less
    outward = places / np.linalg.norm(places, axis=1, keepdims=True)
    deep = Surface(sphere(2.0)).bearing_mm(2.0 * outward, outward, np.full(50, 5.0))
    np.testing.assert_allclose(deep, 2.0, rtol=0.08)


@pytest.mark.parametrize("mode", ["trace", "scan", "transfer"])
def test_a_pressed_ball_goes_round_an_edge_well_off_it(mode: Mode) -> None:
    """With the HIP on the edge itself, as deep as the ball is thick, the contact point may be anywhere round it."""
    motion = synthesise(cube(16.0, 0.8), mode, seconds=6.0, loop_hz=1000.0, seed=0, tool=ball(1.0), force_n=1.5)
    out_mm = np.maximum(np.abs(motion.position_mm) - 8.0, 0.0)
    at_edge = np.count_nonzero(out_mm, axis=1) >= 2
    assert at_edge.sum() > 100
    assert np.linalg.norm(out_mm[at_edge], axis=1).min() > 0.3


def test_hip_stays_on_its_side_of_a_thin_body() -> None:
    motion = synthesise(slab(1.2), "scan", seconds=5.0, loop_hz=1000.0, seed=0, force_n=2.0)
    side = np.sign(motion.position_mm[0, 2])
    depth = 0.6 - side * motion.position_mm[:, 2]
    assert 0.2 < depth.max() < 0.6 - 0.1  # pressed in, but not beyond the middle though 2 N ask for 2 mm


def test_20_s_are_made_in_seconds_of_processor_time(small_dentition) -> None:
    """About 1.2 s on a 3 GHz core; the bound only catches what grows out of all proportion."""
    surface_made = time.process_time()
    synthesise(small_dentition, "scan", seconds=1.0, loop_hz=1000.0, seed=0)
    surface_made = time.process_time() - surface_made
    spent = []
    for mode in MODES:
        began = time.process_time()
        synthesise(small_dentition, mode, seconds=20.0, loop_hz=1000.0, seed=0, tool=ball(0.5))
        spent.append(time.process_time() - began)
    assert np.median(spent) < 12.0 and surface_made < 15.0


def test_saved_motion_comes_back(tmp_path: Path, plate_mesh: Mesh) -> None:
    motion = synthesise(
        plate_mesh, "probe", seconds=1.0, loop_hz=1000.0, seed=1, tool=load_tool(CONFIGS / "tools/burr_flame.toml")
    )
    save_motion(tmp_path / "out.csv", motion)
    (again,) = load_motion(tmp_path / "out.csv", 1000.0)
    np.testing.assert_allclose(again.position_mm, motion.position_mm, atol=1e-8)
    assert again.orientation is not None and motion.orientation is not None
    np.testing.assert_allclose(again.orientation, motion.orientation, atol=1e-8)


def test_few_contacts_show_the_whole_spread_of_forces() -> None:
    """One from each n-th part of the normal distribution, whatever their order; and each alone is normal."""
    from scipy.special import ndtr

    rng = np.random.default_rng(0)
    for count in (1, 2, 7, 40):
        parts = np.floor(np.sort(ndtr(spread_normals(count, rng))) * count)
        assert np.array_equal(parts, np.arange(count))
    first = np.array([spread_normals(3, rng)[0] for _ in range(4000)])
    assert abs(first.mean()) < 0.05 and abs(first.std() - 1.0) < 0.05


def test_strokes_are_distributed_as_the_table_says() -> None:
    """Peaks and durations against their log-normal distributions, over many hands; and strokes fill the time."""
    from scipy.stats import kstest

    for mode, its in STROKES.items():
        hands = [draw_strokes(its, 6.0, np.random.default_rng(seed)) for seed in range(80)]
        for name, median, sigma in (
            ("peak_mm_s", its.peak_mm_s, its.peak_sigma),
            ("duration_s", its.duration_s, its.duration_sigma),
        ):
            first = np.array([getattr(hand, name)[0] for hand in hands])  # of other hands: drawn freely
            assert kstest(np.log(first / median) / sigma, "norm").pvalue > 1e-3, (mode, name)
        for hand in hands[:20]:
            assert hand.start_s[0] == 0.0 and hand.start_s[-1] < 6.0
            gap_s = np.diff(hand.start_s) / hand.duration_s[:-1]
            assert (np.abs(gap_s - 1.0 + its.overlap) <= 0.5 * its.overlap + 1e-9).all()
            assert hand.start_s[-1] + hand.duration_s[-1] > 6.0 - its.overlap * hand.duration_s.max() * 1.5
        order = np.concatenate([np.corrcoef(hand.peak_mm_s[:-1], hand.peak_mm_s[1:])[:1, 1] for hand in hands])
        assert abs(order.mean()) < 0.15, mode  # fast ones follow slow ones as often as fast ones


def test_two_hands_of_one_kind_have_about_the_same_speeds() -> None:
    """Mean speed of hands of 12 s spreads by 6 to 9 % when strokes are drawn apart from each other."""
    for mode, its in STROKES.items():
        mean = [stroke_speed(draw_strokes(its, 12.0, np.random.default_rng(seed)), 12_000).mean() for seed in range(40)]
        assert np.std(np.log(mean)) < 0.045, mode


def test_a_fast_hand_presses_less_over_a_crest_and_not_in_a_hollow() -> None:
    """m v^2 / R of the force is spent on the turn: 0.08 kg at 200 mm/s round 5 mm need 0.64 N."""
    turn = 200.0 / 5.0 * np.arange(400) / BASE_HZ
    outward = np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    depth = np.full(400, 2.0)
    for normal, spent_n in ((outward, 0.64), (-outward, 0.0)):
        carried = round_crests(5.0 * outward, normal, depth, 2.0)
        np.testing.assert_allclose(carried[150:250], 2.0 - spent_n / 2.0, atol=0.01)
    light = round_crests(5.0 * outward, outward, 0.1 * depth, 2.0)
    assert (light[150:250] == 0.0).all()  # it can let go, not pull


def test_strokes_in_the_air_are_as_fast_as_those_that_slide() -> None:
    peaks = np.random.default_rng(0).lognormal(size=40)
    rng = np.random.default_rng(1)
    flown = np.array([strokes_in_air(peaks, rng) for _ in range(2000)])
    assert np.abs(flown.mean(axis=0) - 0.4).max() < 0.06  # each stroke as often as the others
    assert set(flown.sum(axis=1)) == {16}
    slow = np.argsort(peaks)[:20]
    assert set(flown[:, slow].sum(axis=1)) == {8}


def test_hands_start_on_crests_no_more_often_than_elsewhere(plate_mesh: Mesh) -> None:
    """A plate folded to a roof of 10 degrees: near the crest twice as much surface is within reach as on the flanks."""
    lean = np.radians(85.0)
    x, y, _ = plate_mesh.vertices.T
    roof = Mesh(np.column_stack([x * np.cos(lean), y, -np.abs(x) * np.sin(lean)]), plate_mesh.faces)
    surface, rng = Surface(roof), np.random.default_rng(0)
    down = np.array([start_on(surface, rng)[0][2] for _ in range(200)])
    inside = surface.border_mm > surface.margin_mm
    zone_mm = 15.0
    share = surface.weights[inside & (surface.points_mm[:, 2] > -zone_mm)].sum() / surface.weights[inside].sum()
    assert np.mean(down > -zone_mm) == pytest.approx(share, abs=0.08)
