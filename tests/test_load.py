"""How busy the machine was: against what really ran meanwhile, and in the words of the report."""

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from contact_shapes import sphere

import tuning.cli
from hapticlod.bundle import read_bundle
from hapticlod.config import Level, LodConfig
from hapticlod.ladder import build_ladder
from hapticlod.motion import synthesise
from hapticlod.scan import scan_from_arrays
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station
from hapticlod.tool import point
from tuning.deliver import document, write_tuned
from tuning.load import LoadMeter, load_in_words, mean_load
from tuning.machine import this_machine
from tuning.tune import TuneResult
from tuning.verify import CLOCK_RUNS, Measured, Verifier

STATION = shipped_config("stations/desktop_1khz.toml")


def test_the_meter_tells_its_own_work_from_that_of_others() -> None:
    meter, begun, spent = LoadMeter(), time.monotonic(), time.process_time()
    while time.process_time() - spent < 0.3:
        pass
    mine = meter.read()
    assert mine["own_share"] * (time.monotonic() - begun) == pytest.approx(0.3, abs=0.03)
    meter, begun = LoadMeter(), time.monotonic()
    burn = "import time\nwhile time.process_time() < 0.5: pass"
    subprocess.run([sys.executable, "-c", burn], check=True)
    others = meter.read()
    wall_s = time.monotonic() - begun
    # The child spent 0.5 s at least; the system counts in ticks of 10 ms. Whatever else ran adds to it.
    assert others["others_cores"] * wall_s > 0.4
    assert others["own_share"] < 0.5
    assert others["average_after"] == pytest.approx(os.getloadavg()[0], abs=0.5)


def test_several_readings_come_to_their_mean() -> None:
    readings = [{"others_cores": 0.5, "interruptions": 10.0}, {"others_cores": 1.0, "interruptions": 20.0}]
    assert mean_load(readings) == {"others_cores": 0.75, "interruptions": 15.0}
    assert mean_load([]) == {}
    assert load_in_words(mean_load(readings)) == "0.75 cores busy with other programs, 15 interruptions"
    assert load_in_words({"others_cores": None}) == load_in_words({}) == "not recorded"


@pytest.mark.parametrize(("bound_us", "runs"), [(1e9, 1), (0.0, CLOCK_RUNS)])
def test_the_clock_says_under_which_load_it_was_read(
    bound_us: float, runs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reading per run that was timed, the first one's included, and none for what is only looked up."""
    readings = iter([{"others_cores": float(n)} for n in range(100)])
    monkeypatch.setattr("tuning.verify.LoadMeter", lambda: SimpleNamespace(read=lambda: next(readings)))
    times = (np.full(1000, 5.0, dtype=np.float32),)
    first = Measured({}, times, times, ((1, 0),), {"others_cores": 100.0})
    monkeypatch.setattr(Verifier, "run", lambda self, config: first)
    monkeypatch.setattr(Verifier, "runs_of", lambda self, config: ([], times))
    station, nothing = load_station(STATION), SimpleNamespace()
    ladder: Any = nothing
    verifier = Verifier(ladder, point(), station, [], costing=ladder)
    said = verifier.clocked(LodConfig(levels=(Level(triangles=100, cell_mm=1.0, balls=1),)), bound_us)
    seen = [100.0, *range(runs - 1)]
    assert said["runs"] == runs and said["load_others_cores"] == pytest.approx(sum(seen) / len(seen), abs=1e-3)
    assert said["loop_cost_p999_us"] == 5.0


def test_the_bundle_says_what_was_timed_on_which_machine_under_which_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    vertices, faces = sphere(10.0, 3)
    scan = scan_from_arrays(vertices.astype(np.float64), faces, "globe")
    ladder, station = build_ladder(scan, rungs=2, coarsest_ratio=4.0), load_station(STATION)
    motion = synthesise(scan, "trace", seconds=1.0, loop_hz=1000.0, seed=1, tool=point())
    clock = {"loop_cost_mean_us": 5.0, "runs": 2.0, "load_average_before": 3.25, "load_others_cores": 0.75}
    level = Level(triangles=scan.triangles, cell_mm=2.0, balls=1)
    nothing: dict[str, Any] = {
        "predicted": {}, "measured": {}, "baselines": {}, "candidates": (), "stages_s": {}, "population": {},
        "sensitivities": {}, "motions": (), "costing": None,
    }  # fmt: skip
    result = TuneResult(
        config=LodConfig(name="tuned", levels=(level,)), clock=clock, ladder=ladder, golden=motion,
        ticks={"tuned": 1000}, feasible={"tuned": True}, explanation="By hand.", **nothing,
    )  # fmt: skip
    write_tuned(tmp_path / "globe.hlod", result, scan, station, point(), 0)
    held = read_bundle(tmp_path / "globe.hlod").manifest
    assert held["clock"] == clock and held["machine"] == this_machine()
    assert held["golden_load"].keys() == LoadMeter().read().keys()
    assert document(result, scan)["machine"] == held["machine"]
    assert tuning.cli.run(["inspect", str(tmp_path / "globe.hlod")]) == 0
    assert "load average 3.25 before, 0.75 cores busy with other programs" in capsys.readouterr().out
