"""`hapticlod tune`: a scan, a tool and a station in; one bundle and the reason for it out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.console import Console

from hapticlod.errors import InputError
from hapticlod.files import write_json
from hapticlod.shipped import shipped_config
from tuning.commands.outputs import check_writable
from tuning.progress import StageProgress
from tuning.tables import comparison_table

if TYPE_CHECKING:
    from hapticlod.station import Station
    from tuning.tune import TuneResult

DEFAULT_STATION = "stations/desktop_1khz.toml"
DEFAULT_TOOL = "tools/point.toml"
MOST_LEVELS = 5


def tune_command(
    scan: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    unit: str | None = None,
    strict: bool = False,
    station: Path | None = None,
    tool: Path | None = None,
    materials: Path | None = None,
    motions: Annotated[tuple[Path, ...], Parameter(consume_multiple=True, negative=(), show_default=False)] = (),
    levels: str = f"1-{MOST_LEVELS}",
    budget_us: float | None = None,
    loop_hz: float | None = None,
    over: Literal["pooled", "mean", "worst"] = "pooled",
    seed: int = 0,
    json: Path | None = None,
    key: Path | None = None,
) -> None:
    """Tune a scan for a station and a tool, and write one bundle.

    Parameters
    ----------
    scan
        Triangle mesh: STL, PLY, OBJ, OFF, GLB or 3MF; or a scene of several (TOML, docs/scenes.md).
    output
        The bundle to write (.hlod).
    unit
        Unit of the scan's coordinates: mm, cm, m, um or in. Default: what the file says, else a guess from its size.
    strict
        Refuse a scan that needs repair instead of mending it; `hapticlod check` shows what it needs.
    station
        Station file (configs/stations/): rate, budget, limits. Default: a desktop at 1 kHz.
    tool
        Tool file (configs/tools/). Default: a point.
    materials
        Material map (configs/materials/): stiffness and friction of the scan's parts, by component or colour. Default:
        the scan's own, which are properties of a PLY file's faces, if it has any.
    motions
        Recorded hand motions, CSV with t_s,x_mm,y_mm,z_mm. Default: strokes made on the scan's surface.
    levels
        Numbers of levels to consider, as 1-5 or 3.
    budget_us
        Loop cost that one tick may have at p99.9. Default: the station's.
    loop_hz
        Loop rate. Default: the station's.
    over
        What is minimised where motions are several: what all of them feel as one long motion, or the mean or the worst
        of what each feels. Budget and memory hold for all together.
    seed
        Of everything random: the same seed gives the same answer from the same measurements.
    json
        Also write the result as JSON.
    key
        Secret key that signs the bundle. Default: your own; it is made the first time.
    """
    read = None
    if scan.suffix.lower() != ".toml":
        from hapticlod.scan_file import check_mesh_file

        read = check_mesh_file(scan)  # before anything that is slow to import
    from hapticlod.first_key import own_or_first_key
    from hapticlod.material_map import load_materials
    from hapticlod.motion import load_motion
    from hapticlod.signature import load_key
    from hapticlod.station import load_station
    from hapticlod.tool import load_tool

    level_counts = parse_levels(levels)
    inputs = [path for path in (scan, station, tool, materials, *motions) if path is not None]
    check_writable(output, inputs)
    if json is not None:
        check_writable(json, [*inputs, output])
    target = _adjusted(load_station(station or shipped_config(DEFAULT_STATION)), loop_hz, budget_us)
    signing = None if key is None else load_key(key)
    made_of = None if materials is None else load_materials(materials)
    held = load_tool(tool or shipped_config(DEFAULT_TOOL))
    recorded = [motion for path in motions for motion in load_motion(path, target.loop_hz)]

    notes = Console(stderr=True, highlight=False)
    with StageProgress(notes) as progress:
        progress("load and clean the scan", 0.0)
        from hapticlod.material import material_lines
        from hapticlod.scene_file import load_scene
        from tuning.kept_scan import load_kept_scan

        cleaned = load_scene(scan, unit, strict=strict) if read is None else load_kept_scan(read, unit, strict=strict)
        read = None  # tuning needs the memory
        if made_of is not None:
            cleaned = made_of.applied(cleaned)
        for line in [*cleaned.report.lines(), *material_lines(cleaned, target.stiffness_n_mm)]:
            notes.print(f"    {line}", markup=False)
        if key is None:  # not before there is something to sign: a refused scan leaves no key behind
            signing, of_key = own_or_first_key()
            if of_key:
                notes.print(f"    {of_key}", markup=False, soft_wrap=True)
        from tuning.deliver import document, write_tuned
        from tuning.tune import tune

        result = tune(
            cleaned, target, held, recorded or None, levels=level_counts, over=over, seed=seed, progress=progress
        )
        for line in result.ladder.notes:
            notes.print(f"    {line}", markup=False, soft_wrap=True)
        progress("write the bundle", 0.0)
        write_tuned(output, result, cleaned, target, held, seed, signing)
        if json is not None:
            write_json(json, document(result, cleaned))
    _show(result, target, output, json, "not signed" if signing is None else f"signed by {signing.name}")


def _show(result: TuneResult, station: Station, output: Path, json: Path | None, signed: str) -> None:
    """The table, the configuration in one line, the reason, and where it went."""
    out = Console(highlight=False)
    measured = {**result.baselines, "tuned": result.measured}
    title = f"measured on motions kept apart, {station.loop_hz:g} Hz, budget {station.budget_us:g} us"
    out.print(comparison_table(measured, result.feasible, title))
    for name, ticks in result.ticks.items():
        if ticks < result.ticks["tuned"]:
            out.print(f"{name}: on {ticks} ticks; the others on {result.ticks['tuned']}", markup=False)
    out.print(result.explanation, markup=False)
    for path in (output, json):
        if path is not None:
            said = f", {signed}" if path == output else ""
            out.print(f"{path}: {path.stat().st_size / 1e6:.1f} MB{said}", markup=False, soft_wrap=True)


def parse_levels(text: str) -> tuple[int, int]:
    """`"1-5"` or `"3"` as the least and the largest number of levels. Raises InputError."""
    match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", text)
    if match:
        least, most = int(match[1]), int(match[2] or match[1])
        if 1 <= least <= most <= MOST_LEVELS:
            return least, most
    raise InputError(
        "--levels", f"{text!r} is no range of level counts", f"give one number or a range within 1-{MOST_LEVELS}"
    )


def _adjusted(station: Station, loop_hz: float | None, budget_us: float | None) -> Station:
    if loop_hz is None and budget_us is None:
        return station
    return station.adjusted(loop_hz=loop_hz, budget_us=budget_us)
