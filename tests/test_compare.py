"""Comparisons as users run them: planned, interrupted with kill -9, resumed, ranked, exported."""

import contextlib
import csv
import math
import multiprocessing
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from compare_cases import POLICIES, STATIONS, TOOLS, cells, words, write_globe

import tuning.cli
from hapticlod.errors import InputError
from hapticlod.metrics import METRIC_KEYS
from tuning.compare.batch import run_batch
from tuning.compare.ledger import APPLICATION_ID, Ledger, Row
from tuning.compare.local import LocalWorkers
from tuning.compare.measuring import COST_KEYS, bin_edges_us
from tuning.compare.plan import plan_cells
from tuning.compare.ranking import failures, ranks, standings
from tuning.compare.task import Outcome, Stage, Task, perform


class Here:
    """Executes tasks in this process: no worker has to start."""

    def __enter__(self) -> "Here":
        return self

    def __exit__(self, *ended: object) -> None: ...

    def outcomes(self, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
        for task in tasks:
            yield task, perform(task)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("compare")
    write_globe(made / "a.stl")
    write_globe(made / "b.stl", 12.0)
    (made / "broken.stl").write_bytes(b"junk")
    return made


@pytest.fixture(scope="module")
def whole(folder: Path) -> list[Row]:
    """Both globes and the broken one, measured without interruption."""
    with Ledger(folder / "whole.db") as ledger:
        found = run_batch(cells(folder, "a.stl", "b.stl", "broken.stl"), ledger, Here())
        assert (found.measured, found.kept, len(found.failed)) == (4, 0, 2)
        return ledger.rows()


def feels(rows: list[Row]) -> dict[tuple[str, ...], dict]:
    """By names, everything that does not hang on the clock."""
    return {(row.config, *row.group): row.feel for row in rows if row.feel is not None}


def test_every_cell_has_every_metric(whole: list[Row]) -> None:
    done = [row for row in whole if row.is_done]
    assert len(done) == 4
    for row in done:
        assert row.timing is not None and row.feel is not None
        assert row.metrics.keys() == set(METRIC_KEYS) and row.timing["metrics"].keys() == set(COST_KEYS)
        assert row.timing["basis"] == "timed here" and row.timing["core"] in os.sched_getaffinity(0)
        assert {"average_before", "others_cores", "interruptions"} <= row.timing["load"].keys()
        ticks = [sum(n for _, n in level) for level in row.timing["histograms"]]
        shares = [level["share"] for level in row.feel["levels"]]
        assert sum(ticks) == row.feel["counts"]["n_ticks"] == 1000
        assert [n / sum(ticks) for n in ticks] == pytest.approx(shares)
        # The histogram knows the median to within its bin.
        edges, pooled = bin_edges_us(), sorted(pair for level in row.timing["histograms"] for pair in level)
        below = np.cumsum([n for _, n in pooled])
        middle = pooled[int(np.searchsorted(below, 0.5 * sum(ticks)))][0]
        assert edges[middle] * 0.99 <= row.metrics["loop_cost_p50_us"] <= edges[middle + 1] * 1.01
    finest = [row for row in done if row.config == "fixed-finest"]
    assert all(row.metrics["felt_error_jnd"] == 0.0 and row.metrics["switches_per_s"] == 0.0 for row in finest)
    ours = [row for row in done if row.config == "velocity-ours"]
    assert all(row.metrics["switches_per_s"] > 0.0 for row in ours)


def test_a_second_run_measures_nothing(folder: Path, whole: list[Row]) -> None:
    with Ledger(folder / "whole.db") as ledger:
        found = run_batch(cells(folder, "a.stl", "b.stl"), ledger, Here())
        assert (found.measured, found.kept, len(found.failed)) == (0, 4, 0)
        assert feels(ledger.rows()) == feels(whole)


def test_other_inputs_are_other_cells(folder: Path) -> None:
    asked = {
        "scans": [str(folder / "a.stl")], "configs": [str(POLICIES / "fixed_finest.toml")],
        "tools": [str(TOOLS / "point.toml")], "stations": [str(STATIONS / "desktop_1khz.toml")], "motions": ["trace"],
    }  # fmt: skip
    changes = (
        {"scans": [str(folder / "b.stl")]}, {"configs": [str(POLICIES / "fixed_coarse.toml")]},
        {"tools": [str(TOOLS / "ball_1mm.toml")]}, {"stations": [str(STATIONS / "desktop_4khz.toml")]},
        {"motions": ["probe"]}, {"seconds": 2.0}, {"seed": 1}, {"unit": "cm"},
    )  # fmt: skip
    keys = [plan_cells(**{**asked, **change})[0].key for change in ({}, *changes)]
    assert len(set(keys)) == len(keys)
    assert plan_cells(**asked)[0].key == keys[0]


@pytest.fixture
def environment(folder: Path) -> dict[str, str]:
    """Of a program in which importing JAX fails: comparing needs none of it, in no process."""
    without = folder / "without_jax"
    (without / "jax").mkdir(parents=True, exist_ok=True)
    (without / "jax" / "__init__.py").write_text("raise AssertionError('jax was imported')\n")
    return {
        **os.environ, "COLUMNS": "80", "HAPTICLOD_CACHE": str(folder / "cache"), "PYTHONPATH": str(without),
    }  # fmt: skip


def test_kill_9_loses_nothing_and_the_next_run_goes_on(
    folder: Path, whole: list[Row], environment: dict[str, str]
) -> None:
    output = folder / "killed.db"
    asked = [*words(folder, "a.stl", "b.stl"), "-o", str(output), "--workers", "1"]
    call = [sys.executable, "-m", "tuning.cli", "compare", *asked]
    running = subprocess.Popen(call, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert running.stderr is not None
    seen = 0
    for line in running.stderr:
        seen += line.startswith("feel")
        if seen == 3:
            break
    running.send_signal(signal.SIGKILL)
    running.wait()
    running.stderr.read()  # the worker held the pipe too: its end comes when the worker's does
    running.stderr.close()
    with Ledger(output) as ledger:  # nobody holds it
        kept = feels(ledger.rows())
    assert 3 <= len(kept) <= 4
    with Ledger(output) as ledger:
        found = run_batch(cells(folder, "a.stl", "b.stl"), ledger, Here())
        rows = ledger.rows()
    assert (found.measured, found.failed) == (4, ())
    assert all(row.is_done for row in rows)
    expected = {place: feel for place, feel in feels(whole).items() if place[1] != "broken.stl"}
    assert feels(rows) == expected
    assert {path.name for path in folder.iterdir() if "killed" in path.name} == {"killed.db"}


def test_ranking_and_exporting_import_no_jax(folder: Path, whole: list[Row], environment: dict[str, str]) -> None:
    call = [
        sys.executable,
        "-m",
        "tuning.cli",
        "compare",
        "-o",
        str(folder / "whole.db"),
        "--csv",
        str(folder / "x.csv"),
    ]
    shown = subprocess.run(call, env=environment, capture_output=True, text=True)
    assert shown.returncode == 3 and "velocity-ours" in shown.stdout and shown.stderr == ""
    tried = subprocess.run([sys.executable, "-c", "import jax"], env=environment, capture_output=True, text=True)
    assert "jax was imported" in tried.stderr


# What the ledger asks of a cell, without the imports that a real one needs.
CELL = """
import resource, signal, sys
from pathlib import Path
from types import SimpleNamespace as Made
from tuning.compare.ledger import Ledger
from hapticlod.errors import InputError
folder = Path(sys.argv[1])
def cell(number):
    motion = Made(modes=(), seconds=1.0, seed=0, path=None, digest="")
    scan, tool = Made(path="a.stl", unit="mm", digest=""), Made(balls=1, digest="")
    names = ("a", f"c{number % 7}", "t", "s", "m")
    station = Made(model_dump=lambda mode: {})
    return Made(key=str(number % 7), names=names, scan=scan, tool=tool, station=station, motion=motion)
"""

WRITER = (
    CELL
    + """
with Ledger(folder / "written.db") as ledger:
    for n in range(1_000_000):
        ledger.put_feel(cell(n), {"n": n, "text": "x" * 3000})
        print(n, flush=True)
"""
)


def test_what_was_said_to_be_written_is_there_after_kill_9(folder: Path) -> None:
    for wanted in (1, 40):
        call = [sys.executable, "-c", WRITER, str(folder)]
        running = subprocess.Popen(call, stdout=subprocess.PIPE, text=True)
        assert running.stdout is not None
        said = -1
        while said < wanted:
            said = int(running.stdout.readline())
        running.kill()
        said = max([said, *(int(line) for line in running.stdout.read().split("\n")[:-1])])
        running.wait()
        running.stdout.close()
        with sqlite3.connect(folder / "written.db") as base:
            assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        base.close()
        with Ledger(folder / "written.db") as ledger:
            assert max(row.feel["n"] for row in ledger.rows() if row.feel) in (said, said + 1)


@contextlib.contextmanager
def killing(times: int) -> Iterator[None]:
    """Kills this process's children, as they appear, so many times."""
    over = threading.Event()

    def kill() -> None:
        left = times
        while left and not over.is_set():
            for child in multiprocessing.active_children()[:left]:
                if child.pid is not None and child.is_alive():
                    os.kill(child.pid, signal.SIGKILL)
                    left -= 1
            time.sleep(0.02)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_a_worker_that_dies_costs_a_second_try(folder: Path, whole: list[Row]) -> None:
    tasks = [Task(Stage.FEEL, cell) for cell in cells(folder, "a.stl")]
    with killing(1):
        found = {task.cell.names: outcome for task, outcome in LocalWorkers(1).outcomes(tasks, alone=False)}
    assert len(found) == 2
    for row in whole:
        if row.scan == "a.stl":
            assert found[row.scan, row.config, row.tool, row.station, row.motion].result == row.feel
    with killing(1_000_000):
        ((_, outcome),) = LocalWorkers(2).outcomes(tasks[:1], alone=False)
    assert outcome.result is None and outcome.error == "the worker was ended by signal 9, 2 times"
    assert multiprocessing.active_children() == []


def test_what_is_counted_is_replayed_once_and_comes_out_the_same(folder: Path) -> None:
    class Watched(Here):
        def outcomes(self, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
            asked.extend((task.cell.station.name, alone) for task in tasks if task.stage is Stage.TIME)
            return super().outcomes(tasks, alone=alone)

    stations = [str(STATIONS / name) for name in ("paper_2009.toml", "desktop_1khz.toml")]
    scan, config, tool = folder / "a.stl", POLICIES / "velocity_ours.toml", TOOLS / "point.toml"
    made = plan_cells([str(scan)], [str(config)], [str(tool)], stations, ["trace"], seconds=1.0)
    told = []
    for name, left in (("first.db", []), ("second.db", []), ("second.db", [("paper-2009", False)])):
        asked: list[tuple[str, bool]] = []
        if left:  # as after a run that ended between feel and cost: the one is kept, the other counted by itself
            with contextlib.closing(sqlite3.connect(folder / name)) as base, base:
                base.execute("UPDATE cells SET timing = NULL")
        with Ledger(folder / name) as ledger:
            asked_for = made[: 1 if left else 2]
            assert run_batch(asked_for, ledger, Watched()).measured == len(asked_for)
            (row,) = [row for row in ledger.rows() if row.station == "paper-2009"]
        assert asked == (left or [("desktop-1khz", True)])
        assert row.timing is not None and row.timing["core"] is None and row.timing["basis"].startswith("counted")
        told.append((row.timing["metrics"], row.timing["histograms"]))
    assert told[0] == told[1] == told[2]


def test_what_other_code_measured_is_not_kept(folder: Path) -> None:
    class Changed(Here):
        def outcomes(self, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
            yield from ((task, Outcome({"metrics": {"felt_error_jnd": 0.0}}, code="another")) for task in tasks[:1])

    with Ledger(folder / "changed.db") as ledger:
        with pytest.raises(InputError, match="other code"):
            run_batch(cells(folder, "a.stl"), ledger, Changed())
        assert ledger.rows() == []


def test_ranking_puts_what_holds_the_budget_first(whole: list[Row]) -> None:
    found = {standing.config: standing for standing in standings([row for row in whole if row.scan != "broken.stl"])}
    assert found["fixed-finest"].wins == 2 and found["fixed-finest"].mean_rank == 1.0  # holds, and has no error
    assert found["velocity-ours"].mean_rank == 2.0 and found["velocity-ours"].holds == 2
    # The same rows, with a budget that only the second one holds.
    changed = []
    for row in whole:
        if row.is_done and row.timing is not None:
            cost = 1e4 if row.config == "fixed-finest" else 1.0
            timing = {**row.timing, "metrics": {**row.timing["metrics"], "loop_cost_p999_us": cost}}
            changed.append(Row(**{**row.__dict__, "timing": timing}))
    assert [s.config for s in standings(changed)] == ["velocity-ours", "fixed-finest"]
    # A group that lacks a configuration is no ground to rank on.
    assert len(ranks(changed[1:])) == 1


def test_failing_cells_are_named_and_do_not_stop_the_rest(
    folder: Path, whole: list[Row], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (line,) = failures(whole)
    assert line.startswith("broken.stl: 2 cells: ") and "STL" in line
    tables = ["--csv", str(tmp_path / "out.csv"), "--parquet", str(tmp_path / "out.parquet")]
    assert tuning.cli.run(["compare", "-o", str(folder / "whole.db"), *tables]) == 3
    shown = capsys.readouterr().out
    assert line in shown and "velocity-ours" in shown and "4 of 6 cells on 3 scans" in shown
    with (tmp_path / "out.csv").open(newline="") as stream:
        flat = list(csv.DictReader(stream))
    assert [row["state"] for row in flat] == ["done"] * 4 + ["failed"] * 2
    by_key = {row.key: row for row in whole}
    for row in flat[:4]:
        for key in METRIC_KEYS:
            assert math.isclose(float(row[key]), by_key[row["key"]].metrics[key], rel_tol=1e-12)
    import pyarrow.parquet

    held = pyarrow.parquet.read_table(tmp_path / "out.parquet").to_pylist()
    assert [str(row["felt_error_jnd"]) for row in held[:4]] == [row["felt_error_jnd"] for row in flat[:4]]
    assert held[4]["felt_error_jnd"] is None and held[4]["error"] == flat[4]["error"]


def test_one_bad_scan_among_fifty(
    folder: Path, whole: list[Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run of the command over fifty files: 49 that measure as a globe did, and one that is no mesh."""
    for number in range(49):
        (tmp_path / f"{number:02}.stl").write_bytes((folder / "a.stl").read_bytes())
    (tmp_path / "31a.stl").write_bytes(b"junk")
    done = {row.config: row for row in whole if row.scan == "a.stl"}

    class Remembered(Here):
        def outcomes(self, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
            for task in tasks:
                row = done[task.cell.config_name]
                known = Outcome(row.feel if task.stage is Stage.FEEL else row.timing, code=row.code)
                yield task, perform(task) if task.cell.scan.name == "31a.stl" else known

    monkeypatch.setattr("tuning.commands.compare._executor", lambda scheduler, workers: Remembered())
    asked = words(tmp_path, "*.stl")
    asked.remove(str(POLICIES / "velocity_ours.toml"))
    assert tuning.cli.run(["compare", *asked, "-o", str(tmp_path / "fifty.db")]) == 3
    shown = capsys.readouterr()
    (named,) = [line for line in shown.out.splitlines() if line.startswith("31a.stl")]
    assert named.startswith("31a.stl: fixed-finest with point: ") and "49 of 50 cells on 50 scans" in shown.out
    assert "49 cells measured, 0 were done before, 1 failed" in shown.err
    assert [line.split()[1:3] for line in shown.out.splitlines() if line.startswith("fixed-finest")] == [
        ["1.00", "49/49"]
    ]


def refused(capsys: pytest.CaptureFixture[str], *asked: object) -> str:
    status = tuning.cli.run(["compare", *map(str, asked)])
    shown = capsys.readouterr()
    assert status == 2 and shown.out == "" and len(shown.err.splitlines()) == 1, shown
    return shown.err


class TestBadInput:
    def test_no_scan_matches(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        line = refused(capsys, "--scans", folder / "*.ply", "-o", folder / "none.db")
        assert "*.ply" in line and "matches no file" in line

    def test_two_configurations_with_one_name(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        twin = folder / "twin.toml"
        twin.write_text((POLICIES / "fixed_finest.toml").read_text())
        asked = ["--scans", folder / "a.stl", "--configs", POLICIES / "fixed_finest.toml", twin]
        line = refused(capsys, *asked, "-o", folder / "none.db")
        assert "twin.toml" in line and "fixed-finest" in line and "another name" in line

    def test_a_newer_ledger(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = folder / "newer.db"
        Ledger(path).close()
        with sqlite3.connect(path) as base:
            base.execute("PRAGMA user_version = 99")
        base.close()
        before = path.read_bytes()
        assert "newer HapticLOD (ledger version 99" in refused(capsys, "-o", path)
        assert "newer HapticLOD" in refused(capsys, *words(folder, "a.stl"), "-o", path)
        assert path.read_bytes() == before

    def test_a_file_that_is_no_ledger(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        text = folder / "notes.txt"
        text.write_text("not a ledger, but mine\n" * 100)
        assert "notes.txt" in refused(capsys, *words(folder, "a.stl"), "-o", text)
        assert text.read_text().startswith("not a ledger")
        foreign = folder / "foreign.db"
        with sqlite3.connect(foreign) as base:
            base.execute("CREATE TABLE cells (mine TEXT)")
        base.close()
        assert "no ledger of a comparison" in refused(capsys, *words(folder, "a.stl"), "-o", foreign)
        assert APPLICATION_ID > 0

    def test_a_ledger_that_is_being_written(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        with Ledger(folder / "held.db"):
            assert "another comparison" in refused(capsys, *words(folder, "a.stl"), "-o", folder / "held.db")
            assert tuning.cli.run(["compare", "-o", str(folder / "held.db")]) == 0  # looking is allowed
        capsys.readouterr()

    def test_numbers_that_cannot_be(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        asked = [*words(folder, "a.stl"), "-o", folder / "none.db"]
        assert "--workers 0" in refused(capsys, *asked, "--workers", 0)
        assert "--core 4096" in refused(capsys, *asked, "--core", 4096)
        assert "--seconds" in refused(capsys, *asked[:-4], "--seconds", 0.1, "-o", folder / "none.db")
        assert "furlong" in refused(capsys, *asked, "--unit", "furlong")
        assert "--scans" in refused(capsys, "-o", folder / "absent.db")


FULL = (
    CELL
    + """
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
with Ledger(folder / "full.db") as ledger:
    ledger.put_feel(cell(1), {"n": 1})
    size = (folder / "full.db").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    try:
        ledger.put_feel(cell(2), {"n": 2, "text": "x" * 100_000})
    except InputError as error:
        print(error)
"""
)


def test_a_full_disk_is_said_and_what_was_written_stays(folder: Path) -> None:
    call = [sys.executable, "-c", FULL, str(folder)]
    shown = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "full.db: cannot be written" in shown.stdout and "every cell that was finished is kept" in shown.stdout
    with Ledger(folder / "full.db") as ledger:
        assert [row.feel for row in ledger.rows()] == [{"n": 1}]
