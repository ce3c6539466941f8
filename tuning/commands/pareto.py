"""`hapticlod pareto`: budget against feel, on one scan, after one preparation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.table import Table

from hapticlod.errors import InputError
from hapticlod.files import write_json
from hapticlod.shipped import shipped_config
from tuning.commands.outputs import check_writable
from tuning.commands.tune import DEFAULT_STATION, DEFAULT_TOOL, MOST_LEVELS, parse_levels
from tuning.progress import StageProgress

if TYPE_CHECKING:
    from tuning.front import Front, FrontPoint

DEFAULT_POINTS = 8


def pareto_command(
    scan: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    budgets: str = "",
    points: int | None = None,
    verify: Annotated[bool, Parameter(negative=())] = False,
    unit: str | None = None,
    station: Path | None = None,
    tool: Path | None = None,
    motions: Annotated[tuple[Path, ...], Parameter(consume_multiple=True, negative=(), show_default=False)] = (),
    levels: str = f"1-{MOST_LEVELS}",
    loop_hz: float | None = None,
    over: Literal["pooled", "mean", "worst"] = "pooled",
    seed: int = 0,
) -> None:
    """Show what each budget buys, on one scan.

    Parameters
    ----------
    scan
        Triangle mesh: STL, PLY, OBJ, OFF, GLB or 3MF.
    output
        The front to write (JSON).
    budgets
        Budgets, us, as 200,300,600. Default: chosen between the cheapest configuration and the full scan.
    points
        Instead of --budgets: how many of them. Default: 8.
    verify
        Also measure every point in the runtime, on motions kept apart.
    unit
        Unit of the scan's coordinates: mm, cm, m, um or in. Default: what the file says, else a guess from its size.
    station
        Station file. Default: a desktop at 1 kHz.
    tool
        Tool file. Default: a point.
    motions
        Recorded hand motions, CSV with t_s,x_mm,y_mm,z_mm. Default: strokes made on the scan's surface.
    levels
        Numbers of levels to consider, as 1-5 or 3.
    loop_hz
        Loop rate. Default: the station's.
    over
        What is minimised where motions are several: as in `hapticlod tune`.
    seed
        Of everything random.
    """
    from hapticlod.motion import load_motion
    from hapticlod.station import load_station
    from hapticlod.tool import load_tool

    level_counts = parse_levels(levels)
    asked = parse_budgets(budgets) if budgets else None
    if asked is not None and points is not None:
        raise InputError("--points", "goes without --budgets", "give one of the two")
    check_writable(output, [path for path in (scan, station, tool, *motions) if path is not None])
    target = load_station(station or shipped_config(DEFAULT_STATION))
    if loop_hz is not None:
        target = target.adjusted(loop_hz=loop_hz)
    for budget_us in asked or ():
        target.adjusted(budget_us=budget_us)
    if points is not None and points < 1:
        raise InputError("--points", f"{points} is no number of points", "give 1 or more")
    held = load_tool(tool or shipped_config(DEFAULT_TOOL))
    recorded = [motion for path in motions for motion in load_motion(path, target.loop_hz)]
    with StageProgress(Console(stderr=True, highlight=False)) as told:
        told("load and clean the scan", 0.0)
        from hapticlod.scan_file import check_mesh_file
        from tuning.kept_scan import load_kept_scan

        cleaned = load_kept_scan(check_mesh_file(scan), unit)
        from tuning.front import pareto

        front = pareto(
            cleaned, target, held, recorded or None, budgets_us=asked, points=points or DEFAULT_POINTS,
            levels=level_counts, over=over, seed=seed, verify=verify, progress=told,
        )  # fmt: skip
        about = {"scan": cleaned.name, "triangles": cleaned.triangles, "tool": held.name, "station": target.name}
        write_json(output, {**about, "loop_hz": target.loop_hz, "seed": seed, **front.document()})
    out = Console(highlight=False)
    out.print(front_table(front, f"{cleaned.name}, {held.name}, {target.loop_hz:g} Hz"))
    out.print(f"{output}: {len(front.points)} points", markup=False, soft_wrap=True)


def parse_budgets(text: str) -> list[float]:
    """`"200,300"` as numbers. Raises InputError."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(math.isfinite(budget) and budget > 0 for budget in found):
        raise InputError("--budgets", f"{text!r} is no list of budgets", "give numbers above 0, as 200,300,600")
    return found


def front_table(front: Front, title: str) -> Table:
    """One row per budget; predicted, and measured beside it where that was done."""
    verified = any(point.measured is not None for point in front.points)
    table = Table(title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    names = ("p99.9\n  us", "felt\n JND", "jumps\n 1/s")
    headings = ["\nbudget\nus", "\nK\n", *(f"pred.\n{name}" for name in names)]
    headings += [f"meas.\n{name}" for name in names] if verified else []
    for heading in [*headings, "gain of\n10 us\nmore", "\nholds\n" if verified else "\nfits\n"]:
        table.add_column(heading, justify="right", no_wrap=True)
    for point in front.points:
        cells = [f"{point.budget_us:g}", f"{len(point.config.levels)}", *_cells(point.predicted)]
        if point.measured is not None:
            cells += _cells(point.measured)
        table.add_row(*cells, _gain(point), "yes" if (point.holds if verified else point.fits) else "no")
    return table


def _cells(metrics: dict[str, float]) -> list[str]:
    keys = (("loop_cost_p999_us", 1), ("felt_error_jnd", 2), ("discontinuity_per_s", 3))
    return [f"{metrics[key]:.{digits}f}" for key, digits in keys]


def _gain(point: FrontPoint) -> str:
    """By how much the objective falls with 10 us more."""
    return "-" if point.marginal is None else f"{abs(10 * point.marginal):.3f}"
