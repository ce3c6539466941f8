"""Materials on the way through the tuner: replays and tours feel them, keys tell scans apart by them."""

import numpy as np
import pytest
import trimesh

from hapticlod.ladder import Ladder, build_ladder
from hapticlod.motion import Motion, synthesise
from hapticlod.replay import DEFAULT_STATION
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.tool import ball
from tuning.grid import make_clock, make_grid
from tuning.replays import Bench, Tour, replay_fixed, tour_ladder

SOFT = (0.4, 0.3, 0.2)


def ball_of(row: tuple[float, ...] | None) -> Scan:
    mesh = trimesh.creation.icosphere(4, 10.0)
    made_of = None if row is None else np.tile(row, (len(mesh.faces), 1))
    return scan_from_arrays(np.array(mesh.vertices), np.array(mesh.faces), "ball", face_materials=made_of)


def toured(ladder: Ladder, motions: list[Motion]) -> Tour:
    tool = ball(0.3)
    grid = make_grid(ladder.rungs, tool)
    bench = Bench(ladder.rungs, ladder.scan.centre_mm, tool, DEFAULT_STATION, grid)
    clock = make_clock(motions)
    cut = [clock.cut(motion, i) for i, motion in enumerate(motions)]
    levels = [bench.level(r) for r in range(len(ladder.rungs))]
    finest = replay_fixed(bench, levels[0], 0, tool.balls, cut, 1)
    return tour_ladder(bench, levels, cut, finest, clock, 1.0, 2, lambda part: None)


@pytest.fixture(scope="module")
def tours() -> dict[str, Tour]:
    plain = ball_of(None)
    motions = [
        synthesise(plain, mode, seconds=2.0, loop_hz=1000.0, seed=i, tool=ball(0.3))
        for i, mode in enumerate(("trace", "scan"))
    ]
    scans = {
        "plain": plain,
        "soft": ball_of((0.4, np.nan, np.nan)),
        "hard": ball_of((9.0, np.nan, np.nan)),
        "rough": ball_of(SOFT),
    }
    return {name: toured(build_ladder(scan, rungs=3, coarsest_ratio=30), motions) for name, scan in scans.items()}


def test_a_tour_feels_stiffness_and_leaves_friction_aside(tours: dict[str, Tour]) -> None:
    """The same contacts as without materials; forces by the material's stiffness, at most by the station's."""
    assert tours["plain"].touching.any()
    assert np.abs(tours["plain"].offset_n).max() > 0.05
    for name, factor in (("soft", 0.4), ("hard", 1.0), ("rough", 0.4)):
        both = tours["plain"].held & tours["plain"].touching & tours[name].held
        apart = np.abs(tours[name].offset_n - factor * tours["plain"].offset_n)[both].max(axis=1)
        # The hand is drawn back to where the finest level held it; friction holds it elsewhere, once in a while.
        assert np.quantile(apart, 0.9 if name == "rough" else 1.0) < 1e-6
        assert np.mean(tours[name].held == tours["plain"].held) > 0.99


def test_a_key_covers_the_materials() -> None:
    assert len({ball_of(row).digest for row in (None, SOFT, (0.4, 0.3, 0.25))}) == 3
