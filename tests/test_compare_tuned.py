"""`hapticlod compare --configs tuned`: each scan is tuned once for tool and station, kept, and measured as all are."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from compare_cases import POLICIES, STATIONS, TOOLS, write_globe

import tuning.tune
from hapticlod.config import Level, LodConfig
from hapticlod.ladder import build_ladder
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.compare.batch import run_batch
from tuning.compare.cell import Cell
from tuning.compare.ledger import Ledger, Row
from tuning.compare.plan import plan_cells
from tuning.compare.ranking import failures, standings
from tuning.compare.task import Outcome, Stage, Task, perform


class Here:
    """Executes tasks in this process, and remembers which; `until`: the power goes off before a task of that stage."""

    def __init__(self, until: Stage | None = None) -> None:
        self.until = until
        self.done: list[Task] = []

    def __enter__(self) -> "Here":
        return self

    def __exit__(self, *ended: object) -> None: ...

    def outcomes(self, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
        for task in tasks:
            if task.stage is self.until:
                raise KeyboardInterrupt
            self.done.append(task)
            yield task, perform(task)


def tuned_by_hand(scan: Scan, station: Station, tool: Tool, *, seed: int) -> tuning.tune.TuneResult:
    """Stands in for the tuner, which takes half a minute: what it gives, with two levels."""
    assert (scan.name, station.name, tool.name, seed) == ("globe", "desktop-1khz", "point", 3)
    levels = (Level(triangles=scan.triangles, cell_mm=2.0), Level(triangles=321, cell_mm=4.0))
    nothing: dict[str, Any] = {
        "measured": {}, "clock": {}, "baselines": {}, "ticks": {}, "feasible": {}, "candidates": (), "stages_s": {},
        "population": {}, "sensitivities": {}, "motions": (), "golden": None, "costing": None,
    }  # fmt: skip
    return tuning.tune.TuneResult(
        config=LodConfig(name="tuned", speeds_mm_s=(20.0,), levels=levels), ladder=build_ladder(scan),
        predicted={"felt_error_jnd": 0.1, "mapping_hit_rate": float("nan")}, explanation="By hand.", **nothing,
    )  # fmt: skip


def cells(folder: Path) -> list[Cell]:
    return plan_cells(
        [str(folder / "globe.stl"), str(folder / "broken.stl")],
        ["tuned", str(POLICIES / "fixed_finest.toml")],
        [str(TOOLS / "point.toml")],
        [str(STATIONS / "desktop_1khz.toml")],
        ["trace", "probe"],
        seconds=1.0,
        seed=3,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tuned")
    write_globe(made / "globe.stl")
    (made / "broken.stl").write_bytes(b"junk")
    return made


@pytest.fixture(scope="module")
def rows(folder: Path) -> Iterator[list[Row]]:
    """Two runs: one that was ended when tuning was done, and the one that went on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTICLOD_CACHE", str(folder / "cache"))
        patch.setattr(tuning.tune, "tune", tuned_by_hand)
        first = Here(until=Stage.FEEL)
        with Ledger(folder / "out.db") as ledger, pytest.raises(KeyboardInterrupt):
            run_batch(cells(folder), ledger, first)
        # One tuning per scan, tool and station, whatever the motions.
        assert [task.cell.scan.name for task in first.done] == ["globe.stl", "broken.stl"]
        assert all(task.stage is Stage.TUNE for task in first.done)
        second = Here()
        with Ledger(folder / "out.db") as ledger:
            found = run_batch(cells(folder), ledger, second)
            assert (found.measured, found.kept, len(found.failed)) == (4, 0, 4)
            # What was tuned before the interruption is not tuned again; what failed is tried again.
            tuned = [task.cell.scan.name for task in second.done if task.stage is Stage.TUNE]
            assert tuned == ["broken.stl"]
            (kept,) = ledger.tunings().values()
            # A metric without a value is left out: JSON has no NaN.
            assert kept["predicted"] == {"felt_error_jnd": 0.1} and kept["explanation"] == "By hand."
            yield ledger.rows()


def test_a_tuned_configuration_is_measured_like_the_others(rows: list[Row]) -> None:
    done = [row for row in rows if row.is_done]
    assert sorted((row.config, row.motion) for row in done) == [
        ("fixed-finest", "probe"), ("fixed-finest", "trace"), ("tuned", "probe"), ("tuned", "trace"),
    ]  # fmt: skip
    used = [LodConfig.model_validate(row.feel["config"]) for row in done if row.config == "tuned" and row.feel]
    assert len(used) == 2 and used[0] == used[1] and len(used[0].levels) == 2
    for row in done:
        assert row.feel is not None
        held = [level["triangles"] for level in row.feel["levels"]]  # what was built, beside what was asked for
        assert held == [level["triangles"] for level in row.feel["config"]["levels"]]
    assert {standing.config for standing in standings([row for row in rows if row.scan == "globe.stl"])} == {
        "tuned", "fixed-finest",
    }  # fmt: skip


def test_a_scan_that_cannot_be_tuned_is_named_and_stops_nothing(rows: list[Row]) -> None:
    (line,) = failures(rows)
    assert line.startswith("broken.stl: 4 cells: ")
