"""`make evaluate-surrogate SCAN=file [MOTIONS="a.csv b.csv"] [TOOL=file] [CONFIGS=60] [HANDS=4] [JSON=out.json]`

Random configurations of one scan, each predicted by the surrogate and measured in the runtime on motions kept apart:
rank correlations and ratios per metric, beside trivial predictors. Motions that are made for this are four times as
long as tuning makes them, so that the model is judged and not the chance of short hands; HANDS=1 are tuning's own.
What the figures mean: `tuning.evaluate`.
"""

from __future__ import annotations

import sys
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

FEWEST_CONFIGS = 5
app = App(name="evaluate-surrogate", help="Compare what the surrogate predicts with what the runtime measures.")


@app.default
def evaluate_command(
    *,
    scan: Path | None = None,
    motions: str = "",
    tool: Path | None = None,
    station: Path | None = None,
    configs: int = 60,
    hands: float = 4.0,
    unit: str | None = None,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Compare what the surrogate predicts with what the runtime measures.

    Parameters
    ----------
    scan
        Triangle mesh: STL, PLY, OBJ, OFF, GLB or 3MF.
    motions
        Recorded hand motions, CSV files parted by spaces. Default: strokes made on the scan's surface.
    tool
        Tool file. Default: a point.
    station
        Station file. Default: a desktop at 1 kHz.
    configs
        How many random configurations, 1 to 5 levels in turn.
    hands
        Motions that are made are so many times as long as tuning makes them.
    unit
        Unit of the scan's coordinates: mm, cm, m, um or in. Default: what the file says, else a guess from its size.
    seed
        Of motions and configurations.
    json
        Also write the figures here.
    """
    from benchmarks.inputs import load_inputs
    from hapticlod.files import write_json
    from hapticlod.scan import load_scan

    if scan is None:
        raise InputError("SCAN", "no scan was given", "say make evaluate-surrogate SCAN=file")
    if configs < FEWEST_CONFIGS:
        raise InputError("CONFIGS", f"{configs} are too few to rank", f"give at least {FEWEST_CONFIGS}")
    if not 0.5 <= hands <= 100.0:
        raise InputError("HANDS", f"{hands:g} is no length", "give 0.5 to 100")
    if json is not None:
        check_writable(json)
    target, held, recorded = load_inputs(station, tool, motions)
    with StageProgress(Console(stderr=True, highlight=False)) as told:
        told("load and clean the scan", 0.0)
        cleaned = load_scan(scan, unit)
        from tuning.compile_cache import keep_compiled
        from tuning.evaluate import evaluate, scores
        from tuning.prepare import prepare
        from tuning.verify import Verifier

        keep_compiled()
        ready = prepare(cleaned, target, held, recorded, seed=seed, progress=told, hands=hands)
        verifier = Verifier(ready.ladder, held, target, ready.apart, ready.costing)
        trials = evaluate(ready, verifier, target, configs, seed, told)
    found = scores(trials)
    about = {
        "scan": cleaned.name, "triangles": cleaned.triangles, "tool": held.name, "balls": held.balls,
        "station": target.name, "configs": len(trials), "seed": seed, "hands": None if recorded else hands,
        "ticks_seen": ready.data.clock.ticks, "ticks_apart": sum(motion.ticks for motion in ready.apart),
    }  # fmt: skip
    title = (
        f"{cleaned.name}, {held.name}, {target.name}: {len(trials)} configurations; surrogate from "
        f"{about['ticks_seen']} ticks, measured on {about['ticks_apart']} others"
    )
    out = Console(highlight=False)
    out.print(_table(found, title))
    for key, score in found["clock"].items():
        ratios = " ".join(f"{score[name]:.2f}" for name in ("ratio_p5", "ratio_p50", "ratio_p95"))
        out.print(f"{key} counted over timed, single runs: {ratios} (5, 50, 95 %)", soft_wrap=True)
    if json is not None:
        write_json(json, {**about, **found})


def _table(found: dict[str, Any], title: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("metric", no_wrap=True)
    # Of what triangles predict, the rank correlation alone.
    headings = ("Spear-\nman", "Ken-\ndall", "ceil-\ning", "\np5", "ratio\np50", "\np95", "own\nhand", "trian-\ngles")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for key, score in found["metrics"].items():
        own = found["own_motions"][key]["spearman"]
        trivial = found["baselines"]["total_triangles"][key]["spearman"]
        values = [score[k] for k in ("spearman", "kendall", "ceiling", "ratio_p5", "ratio_p50", "ratio_p95")]
        table.add_row(key, *["-" if v is None else f"{v:.2f}" for v in (*values, own, trivial)])
    return table


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:], app))
