"""`make bench-tuners SCAN=file [TOOL=file] [EVALUATIONS=400]`: our tuner against those that only measure.

Ours runs cold, from the scan to its answer. Every other method then has its evaluations (random search 2.5 times as
many) on the same motions; shown is what it had found when ours was done, and at its end. The best of each is measured
once more; regret is ours less the least of these. Costs are by counters, for all alike. Packages: the extra `bench`.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cyclopts import App
from rich import box
from rich.console import Console
from rich.table import Table

from hapticlod.errors import InputError
from tuning.cli import run
from tuning.commands.outputs import check_writable
from tuning.progress import StageProgress

OURS = "ours"
AGAIN = 3  # configurations of each method that are measured again until one holds its limits
app = App(name="bench-tuners", help="Compare our tuner with those that only measure.")


@app.default
def bench_tuners_command(
    *,
    scan: Path | None = None,
    motions: str = "",
    tool: Path | None = None,
    station: Path | None = None,
    budget_us: float | None = None,
    evaluations: int = 400,
    seconds: float = 0.0,
    unit: str | None = None,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Compare our tuner with those that only measure.

    Parameters
    ----------
    scan
        Triangle mesh.
    motions
        Recorded hand motions, CSV files parted by spaces. Default: strokes made on the scan's surface.
    tool
        Tool file. Default: a point.
    station
        Station file. Default: a desktop at 1 kHz.
    budget_us
        Default: the station's.
    evaluations
        Configurations that each method measures.
    seconds
        That each method goes on for at least.
    unit
        Unit of the scan's coordinates: mm, cm, m, um or in. Default: what the file says, else a guess from its size.
    seed
        Of motions and methods.
    json
        Also write the figures here.
    """
    if scan is None:
        raise InputError("SCAN", "no scan was given", "say make bench-tuners SCAN=file")
    if evaluations < 1 or not 0 <= seconds < 1e6:
        raise InputError("EVALUATIONS", f"{evaluations} for {seconds:g} s is no share", "give 1 or more, and seconds")
    if json is not None:
        check_writable(json)
    if missing := [name for name in ("optuna", "cmaes") if find_spec(name) is None]:
        raise InputError(", ".join(missing), "is not installed", "pip install -e '.[bench]'")
    with tempfile.TemporaryDirectory() as cache:  # ours starts cold
        os.environ["HAPTICLOD_CACHE"] = cache
        with StageProgress(Console(stderr=True, highlight=False)) as told:
            found = _compared(scan, motions, tool, station, budget_us, evaluations, seconds, unit, seed, told)
    Console(highlight=False).print(_table(found))
    Console(highlight=False).print(_verdict(found), markup=False)
    if json is not None:
        from hapticlod.files import write_json

        write_json(json, found)


def _compared(
    scan: Path, motions: str, tool: Path | None, station: Path | None, budget_us: float | None,
    evaluations: int, seconds: float, unit: str | None, seed: int, told: Any,
) -> dict[str, Any]:  # fmt: skip
    from benchmarks.black_box import METHODS, Trials
    from benchmarks.inputs import load_inputs
    from hapticlod.scan import load_scan
    from tuning.objective import holds
    from tuning.prepare import prepare
    from tuning.tune import tune
    from tuning.verify import Verifier

    target, held, recorded = load_inputs(station, tool, motions, budget_us)
    told("load and clean the scan", 0.0)
    cleaned = load_scan(scan, unit)
    began = time.monotonic()
    result = tune(cleaned, target, held, recorded, seed=seed, progress=told)
    ours_s = time.monotonic() - began
    ready = prepare(cleaned, target, held, recorded, seed=seed, progress=told)
    verifier = Verifier(ready.ladder, held, target, ready.apart, ready.costing)
    verifier.reference()
    counts = [k for k in range(1, ready.space.most_levels + 1) if ready.space.fits(k)] or [1]

    rows: dict[str, dict[str, Any]] = {}
    # By counters, as the others': what the clock refuses of it depends on what else this machine does.
    ours = sorted((c for c in result.candidates if holds(c.measured, target)), key=lambda c: c.objective)
    leaders = {OURS: [(c.config, c.objective) for c in ours]}
    # Candidates, of which the finest level is one, and two more baselines; what was asked for twice ran once.
    measured = len({c.config.changed(name="").model_dump_json() for c in result.candidates}) + 2
    rows[OURS] = {
        "evaluations": measured, "seconds": ours_s, "best_in_our_time": leaders[OURS][0][1],
        "best": leaders[OURS][0][1], "chosen": result.candidates[0].objective,
    }  # fmt: skip
    for name, (method, factor) in METHODS.items():
        told(name, 0.0)
        trials = Trials(verifier, target, max(1, round(factor * evaluations)), seconds)
        method(trials, ready, counts, seed)
        early, late = trials.best(ours_s), trials.best()
        leaders[name] = [(e.config, e.objective) for e in late]
        rows[name] = {
            "evaluations": len(trials.made), "seconds": trials.made[-1].after_s,
            "best_in_our_time": early[0].objective if early else None, "best": late[0].objective if late else None,
        }  # fmt: skip
    told("measure the best again", 0.0)
    for name, best in leaders.items():
        rows[name] |= _again(best, verifier, target)
    held_again = {name: row["again"] for name, row in rows.items() if row["again"] is not None}
    again, least = rows[OURS]["again"], min(held_again.values(), default=None)
    regret = None if again is None or least is None else again - least
    return {
        "scan": cleaned.name, "triangles": cleaned.triangles, "tool": held.name, "station": target.name,
        "budget_us": target.budget_us, "seed": seed, "methods": rows, "regret": regret,
        "regret_relative": None if regret is None or not least else regret / least,
    }  # fmt: skip


def _again(best: Sequence[tuple[Any, float]], verifier: Any, station: Any) -> dict[str, Any]:
    """The first of the best that holds its limits when it is measured again."""
    from tuning.objective import holds, objective

    for config, _ in best[:AGAIN]:
        metrics = verifier.measured(config)
        if holds(metrics, station):
            keys = ("loop_cost_p999_us", "felt_error_jnd", "discontinuity_per_s")
            value = float(objective(metrics, station.budget_us))
            return {"again": value, "levels": len(config.levels), **{key: metrics[key] for key in keys}}
    return {"again": None, "levels": None}


def _table(found: Mapping[str, Any]) -> Table:
    title = (
        f"{found['scan']}, {found['tool']}, {found['station']}, budget {found['budget_us']:g} us: measured objective"
    )
    table = Table(title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for heading in ("measured\nconfigs", "\nseconds", "in our\ntime", "at the\nend", "again", "\nK", "p99.9\nus"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, row in found["methods"].items():
        values = [row["best_in_our_time"], row["best"], row["again"]]
        cells = ["-" if v is None else f"{v:.4f}" for v in values]
        cost = row.get("loop_cost_p999_us")
        cells += [str(row["levels"] or "-"), "-" if cost is None else f"{cost:.1f}"]
        table.add_row(name, str(row["evaluations"]), f"{row['seconds']:.0f}", *cells)
    return table


def _verdict(found: Mapping[str, Any]) -> str:
    if found["regret"] is None:
        return "no regret to tell: ours did not hold its limits when it was measured again"
    relative = found["regret_relative"]
    part = "" if relative is None else f" ({100 * relative:.1f} %)"
    configs = found["methods"][OURS]["evaluations"]
    regret = f"regret {found['regret']:.4f}{part} against the best of all, with {configs} measured configurations"
    chosen = found["methods"][OURS]["chosen"]
    if chosen > found["methods"][OURS]["best"]:
        regret += f"; the clock refused ours, so that tuning answered {chosen:.4f}; it was not asked of the others'"
    return regret


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:], app))
