"""Policies are configurations: what drives the levels, against distances and speeds worked out here."""

from pathlib import Path

import numpy as np
import pytest
from contact_core import Core, point_or_ball
from contact_shapes import sphere

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder, build_ladder
from hapticlod.layout import POLICY_DISTANCE
from hapticlod.metrics import measure
from hapticlod.motion import synthesise
from hapticlod.replay import replay
from hapticlod.scan import scan_from_arrays
from hapticlod.scheme import Scheme, load_scheme
from hapticlod.tool import ball, point

CONFIGS = Path(__file__).parents[1] / "configs"
SHIPPED = sorted((CONFIGS / "policies").glob("*.toml"))


@pytest.fixture(scope="module")
def globe() -> Ladder:
    vertices, faces = sphere(10.0, 4)
    return build_ladder(scan_from_arrays(vertices.astype(np.float64), faces, "globe"), rungs=5, coarsest_ratio=60.0)


def scheme(name: str) -> Scheme:
    found = load_scheme(CONFIGS / "policies" / f"{name}.toml")
    assert isinstance(found, Scheme)
    return found


def test_the_shipped_policies_are_named_as_their_files_and_fit_a_scan(globe: Ladder) -> None:
    assert len(SHIPPED) == 6
    for path in SHIPPED:
        found = load_scheme(path)
        assert isinstance(found, Scheme) and found.name == path.stem.replace("_", "-")
        config = found.on(globe, point())
        assert config.levels[0].triangles == globe.at(round(globe.scan.triangles * found.levels[0].share)).triangles
        assert config.name == found.name and config.policy == found.policy


def test_the_papers_scheme_has_the_papers_numbers(globe: Ladder) -> None:
    config = scheme("velocity_paper").on(globe, point())
    shares = [level.triangles / globe.scan.triangles for level in config.levels]
    np.testing.assert_allclose(shares, [1.0, 26556 / 66224, 14830 / 66224], atol=2e-3)
    assert config.speeds_mm_s == (30.0, 120.0) and (config.mapping, config.l_out_mm) == ("paper", 5.0)
    assert config.filter_hz == config.hysteresis == config.blend_ms == config.l_in_mm == 0.0


def test_lengths_follow_the_scan(globe: Ladder) -> None:
    config = scheme("velocity_ours").on(globe, point())
    # Between the rungs the offset is read from its neighbours: no further off than they are.
    coarser = next(r for r in globe.rungs if r.triangles <= config.levels[-1].triangles)
    finer = globe.rungs[globe.rungs.index(coarser) - 1]
    assert 4.0 * finer.rms_mm <= config.l_in_mm == config.l_out_mm <= 4.0 * coarser.rms_mm
    far = scheme("distance").on(globe, point())
    assert far.speeds_mm_s == pytest.approx([0.002 * globe.scan.extent_mm, 0.01 * globe.scan.extent_mm])


def test_levels_that_come_out_alike_are_dropped_with_their_threshold(globe: Ladder) -> None:
    levels = [{"share": share} for share in (1.0, 1e-4, 5e-5)]  # both below what simplification reaches
    config = Scheme.model_validate({"name": "s", "speeds_mm_s": (10.0, 20.0), "levels": levels}).on(globe, point())
    assert len(config.levels) == 2 and config.speeds_mm_s == (10.0,)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('name = "a"\nspeeds_mm_s = [3.0]\nlevels = [{ share = 1.0 }]\n', ":2:1: speeds_mm_s: 1 levels need 0, not 1"),
        ('name = "a"\ndistances = [0.1]\nlevels = [{ share = 1.0 }]\n', ":2:1: distances: goes with the other policy"),
        ('name = "a"\nlevels = [{ share = 1.5 }]\n', ":2"),
        ('levels = [{ share = 1.0 }]\n', "name"),
        ('name = "a"\nspeeds_mm_s = [3.0]\nlevels = [{ share = 0.5 }, { share = 0.6 }]\n', "must become coarser"),
        ('name = "a"\nlevels = [{ triangles = 4 }]\n', "cell_mm"),  # no share: read as a configuration
        ("name = \n", ":1"),
    ],
)  # fmt: skip
def test_what_a_scheme_file_cannot_say(text: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "scheme.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scheme(path)
    assert "scheme.toml" in str(caught.value) and expected in str(caught.value)


def test_a_file_with_triangles_is_a_configuration() -> None:
    assert isinstance(load_scheme(CONFIGS / "levels" / "paper_sphere.toml"), LodConfig)


TOOLS = {
    "point": point_or_ball(0.0),
    "ball": point_or_ball(0.7),
    "burr": np.array([[0.0, 0.0, 0.0, 0.3], [0.5, 0.2, 1.0, 0.4], [-0.8, 0.3, 0.6, 0.0]]),
}


@pytest.mark.parametrize("name", TOOLS)
@pytest.mark.parametrize("hysteresis", [0.0, 0.2])
def test_the_distance_policy_follows_the_exact_distance(name: str, hysteresis: float) -> None:
    """A tool that comes and goes, turning, over a plate: levels as a Schmitt trigger on the closed form gives them."""
    balls = TOOLS[name]
    n, half = 24, 20.0
    line = np.linspace(-half, half, n + 1)
    grid = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    vertices = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    corner = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    lower = np.stack([corner, corner + n + 1, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n + 2], axis=1)
    plate = (vertices, np.concatenate([lower, upper]))
    speeds = np.full(8, 1e9)
    speeds[:2] = [0.6, 4.0]
    core = Core([plate] * 3, balls, 5.0, policy=POLICY_DISTANCE, speeds_mm_s=speeds, hysteresis=hysteresis)

    rng = np.random.default_rng(2)
    ticks = 3000
    at = np.arange(ticks) / 1000.0
    height = 4.0 + 4.5 * np.sin(9.0 * at) + 0.02 * rng.normal(size=ticks)
    hip = np.column_stack([6.0 * np.sin(2.0 * at), 5.0 * np.cos(3.0 * at), height])
    half_turn = 0.4 * np.sin(5.0 * at)
    orientation = np.column_stack([np.cos(half_turn), np.sin(half_turn), 0.0 * at, 0.0 * at])  # about x
    rows = core.replay(hip, orientation)

    y, z = balls[:, 1], balls[:, 2]
    lowest = (np.sin(2 * half_turn)[:, None] * y + np.cos(2 * half_turn)[:, None] * z - balls[:, 3]).min(axis=1)
    clear = np.maximum(height + lowest, 0.0)
    # Levels are chosen by where the tool was in the tick before, turned as it is now. A distance within rounding of a
    # threshold may go either way: those ticks follow the runtime.
    level, followed = 0, 0
    for t in range(ticks):
        lowest_now = lowest[t]
        before = clear[0] if t == 0 else max(height[t - 1] + lowest_now, 0.0)
        if t == 0:
            level = int(rows["level"][0])
            continue
        edges = np.concatenate([speeds[:2] * (1 + hysteresis), speeds[:2] * (1 - hysteresis)])
        if np.abs(before - edges).min() < 2e-3 or rows["contact"][t - 1] == 1:
            level = int(rows["level"][t])
            followed += 1
            continue
        while level < 2 and before > speeds[level] * (1 + hysteresis):
            level += 1
        while level > 0 and before < speeds[level - 1] * (1 - hysteresis):
            level -= 1
        assert rows["level"][t] == level, (t, before, clear[t])
    assert followed < ticks / 2
    assert set(rows["level"]) == {0, 1, 2}
    assert (rows["level"][1:][rows["contact"][:-1] == 1] == 0).all()


def test_shading_takes_facets_away_on_a_coarse_level(globe: Ladder) -> None:
    tool = ball(0.5)
    found = {"fixed_coarse": 0.0, "fixed_coarse_shaded": 0.0}
    for seed in range(10):  # one may happen to cross few edges: 0.34 to 0.88, all of sixteen 0.46
        motion = synthesise(globe.scan, "trace", seconds=2.0, loop_hz=1000.0, seed=seed, tool=tool)
        reference = replay(scheme("fixed_finest").on(globe, tool), globe, motion, tool)
        for name in found:
            record = replay(scheme(name).on(globe, tool), globe, motion, tool)
            found[name] += measure(record, reference)["facet_vibration_n"]
    assert found["fixed_coarse_shaded"] < 0.6 * found["fixed_coarse"]
