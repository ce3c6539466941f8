"""`hapticlod experiment`: the paper's figures, drawn from our own records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.table import Table

from hapticlod.errors import InputError
from hapticlod.files import write_json
from hapticlod.shipped import shipped_config

DEFAULT_SECONDS = 3.0


def experiment_command(
    name: Literal["plane", "sphere", "dentition"],
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    seconds: float = DEFAULT_SECONDS,
    scan: Path | None = None,
    unit: str | None = None,
    tool: Path | None = None,
    slowdown: float | None = None,
) -> None:
    """Redraw the figures of one of the paper's experiments.

    Parameters
    ----------
    name
        Which experiment: plane, sphere or dentition.
    output
        Folder for the figures (SVG) and their numbers (JSON); made if it is not there.
    seconds
        Length of each motion.
    scan
        Dentition only: a scan instead of the generated one, with levels in the paper's proportions.
    unit
        Unit of that scan. Default: what the file says, else a guess by its size.
    tool
        Tool file. Default: a point, as the paper's.
    slowdown
        How much slower the paper's machine is taken to be. Default: so much that 80000 triangles of the plane just miss
        1 kHz at 80 mm/s.
    """
    if not 1.0 <= seconds <= 600.0:
        raise InputError("--seconds", f"{seconds:g} s", "give 1 to 600")
    if scan is not None and name != "dentition":
        raise InputError("--scan", f"goes with dentition, not with {name}", "leave it out")
    if slowdown is not None and not 0.0 < slowdown < 1e9:
        raise InputError("--slowdown", f"{slowdown:g} is no factor", "give a number above 0")
    if output.exists() and not output.is_dir():
        raise InputError(str(output), "is not a folder", "give another name")
    if not output.resolve().parent.is_dir():
        raise InputError(str(output), f"the folder {output.resolve().parent} does not exist", "create it first")
    from hapticlod.station import load_station
    from hapticlod.tool import load_tool
    from tuning.report import needed

    needed()
    from tuning.experiments.old_machine import slowdown_of, without_short_way

    held = without_short_way(load_tool(tool or shipped_config("tools/point.toml")))
    plain = load_station(shipped_config("stations/paper_2009.toml"))
    factor = slowdown or slowdown_of(plain, held)
    reason = "given" if slowdown else "assumed: 80000 triangles of the plane at 80 mm/s just miss 1 kHz"
    station = plain.adjusted(slowdown=factor, slowdown_reason=reason)
    if name == "plane":
        from tuning.experiments.plane import plane_experiment

        found = plane_experiment(station, held, seconds)
    elif name == "sphere":
        from tuning.experiments.sphere import sphere_experiment

        found = sphere_experiment(station, held, seconds)
    else:
        from tuning.experiments.dentition import dentition_experiment

        found = dentition_experiment(station, held, seconds, scan, unit)
    from tuning.report.style import save_svg

    output.mkdir(exist_ok=True)
    for file, figure in found.figures.items():
        save_svg(output / f"{file}.svg", figure)
    prefix = name if scan is None else f"{name}-{scan.stem}"
    assumed = {"slowdown": factor, "reason": reason, "tool": held.name, "seconds": seconds, **found.assumed}
    write_json(output / f"{prefix}.json", {"experiment": name, "assumed": assumed, "runs": found.rows})
    out = Console(highlight=False)
    out.print(_table(found.rows, f"{prefix}: on time, and on a machine {factor:.3g} times slower ({reason})"))
    out.print(f"{output}: {len(found.figures)} figures, {prefix}.json", markup=False, soft_wrap=True)


def _table(rows: list[dict], title: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = {
        "run": "\nrun", "mean_speed_mm_s": "mean\nmm/s", "felt_error_jnd": "felt\nJND", "switches_per_s": "switch\n1/s",
        "switch_jump_max_n": "jump\nmax N", "old_cost_p50_us": "p50 us\nslowed", "old_rate_hz": "rate\nHz",
        "old_late_share": "late\n%", "old_force_error_max_n": "error\nmax N",
    }  # fmt: skip
    for key, heading in columns.items():
        table.add_column(heading, justify="left" if key == "run" else "right", no_wrap=key != "run")
    for row in rows:
        shown = {**row, "old_late_share": 100.0 * row["old_late_share"]}
        digits = {"felt_error_jnd": 2, "switch_jump_max_n": 3, "old_force_error_max_n": 2}
        table.add_row(
            row["run"],
            *(
                f"{shown[key]:.{digits.get(key, 1 if key != 'old_cost_p50_us' else 0)}f}"
                for key in columns
                if key != "run"
            ),
        )
    return table
