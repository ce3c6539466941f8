"""Tuning and fronts from end to end on a tiny scan: another budget reuses what does not depend on it, and what is told
as measured is what the runtime gives."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh
from surrogate_cases import few_starts

import tuning.cli
from hapticlod.config import Level, LodConfig
from hapticlod.dentition import make_dentition
from hapticlod.metrics import measure
from hapticlod.motion import Motion, load_motion, save_motion, synthesise
from hapticlod.replay import replay_levels, runtime_levels
from hapticlod.scan import Scan, load_scan
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import Tool, load_tool

pytestmark = pytest.mark.slow
LEVELS = (1, 2)
TOOL = "tools/ball_1mm.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A scan, a motion on it, and an empty cache."""
    made = tmp_path_factory.mktemp("jobs")
    scan = make_dentition(4_000, seed=4)
    trimesh.Trimesh(scan.vertices, scan.faces, process=False).export(made / "jaw.ply")
    save_motion(made / "hand.csv", synthesise(scan, "scan", seconds=4.0, loop_hz=1000.0, seed=1, tool=tool()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTICLOD_CACHE", str(made / "cache"))
        few_starts(patch)
        yield made


def tool() -> Tool:
    return load_tool(shipped_config(TOOL))


def station(budget_us: float = 600.0) -> Station:
    return load_station(shipped_config("stations/desktop_1khz.toml")).adjusted(budget_us=budget_us)


def scan_and_motions(folder: Path) -> tuple[Scan, list[Motion]]:
    return load_scan(folder / "jaw.ply", "mm"), load_motion(folder / "hand.csv", 1000.0)


@pytest.fixture(scope="module")
def front(folder: Path) -> dict:
    """What `hapticlod pareto --verify` writes."""
    words = ["pareto", folder / "jaw.ply", "-o", folder / "front.json", "--verify", "--points", 3, "--unit", "mm"]
    words += ["--tool", shipped_config(TOOL), "--motions", folder / "hand.csv", "--levels", "1-2"]
    assert tuning.cli.run([str(word) for word in words]) == 0
    return json.loads((folder / "front.json").read_text())


def test_a_verified_front_tells_what_the_runtime_gives(folder: Path, front: dict) -> None:
    points = front["points"]
    assert [p["budget_us"] for p in points] == sorted(p["budget_us"] for p in points) and len(points) == 3
    for point in points:
        measured = point["measured"]
        within = measured["loop_cost_p999_us"] <= point["budget_us"] and measured["memory_mb"] <= station().memory_mb
        assert point["holds_measured"] == within
    held = [p["measured"]["felt_error_jnd"] for p in points if p["holds_measured"]]
    assert held, "the largest budget is what the full scan costs"
    # The same configuration again, on the part of the recording that was kept apart, without the tuner.
    from hapticlod.ladder import build_ladder
    from tuning.recordings import seen_and_apart

    scan, motions = scan_and_motions(folder)
    ladder, (_, (apart,)) = build_ladder(scan), seen_and_apart(scan, station(), tool(), motions)
    config = LodConfig.model_validate(points[-1]["config"])
    cell_mm = 4 * ladder.rungs[0].mean_edge_mm
    finest = LodConfig(levels=(Level(triangles=scan.triangles, cell_mm=cell_mm, balls=1),))
    mine, best = (
        replay_levels(
            runtime_levels(c, ladder), c, scan.centre_mm, apart, tool(), station(), 1, cut_short=False
        )
        for c in (config, finest)
    )  # fmt: skip
    again = measure([mine], [best])
    for name in ("felt_error_jnd", "discontinuity_per_s", "switches_per_s", "memory_mb"):
        assert points[-1]["measured"][name] == pytest.approx(again[name], rel=1e-9, abs=1e-9), name


def test_another_budget_replays_only_what_it_must(folder: Path, front: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    from tuning import prepare
    from tuning.deliver import document
    from tuning.tune import tune
    from tuning.verify import Verifier, clock_metrics

    def never(*args: object, **options: object) -> None:
        raise AssertionError("this does not depend on the budget")

    for name in ("ladder_of", "sample_ladder", "assemble", "OwnHands"):
        monkeypatch.setattr(prepare, name, never)
    scan, motions = scan_and_motions(folder)
    # A busy machine's times are not what this is about.
    monkeypatch.setattr(Verifier, "clocked", lambda self, config, _: clock_metrics(self.run(config).counted_us))
    cheapest = min(point["measured"]["loop_cost_p999_us"] for point in front["points"])
    budgets = 1.3 * cheapest, 3.0 * cheapest

    def tuned(budget_us: float) -> dict:
        told = document(tune(scan, station(budget_us), tool(), motions, levels=LEVELS), scan)
        del told["stages_s"], told["clock"]  # times
        return told

    first = tuned(budgets[0])
    other = tuned(budgets[1])
    assert first["measured"]["loop_cost_p999_us"] <= budgets[0]
    assert other["measured"]["felt_error_jnd"] <= first["measured"]["felt_error_jnd"] + 0.01
    # What was asked in between changes no answer.
    assert tuned(budgets[0]) == first
