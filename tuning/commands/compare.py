"""`hapticlod compare`: configurations over many scans, measured in the runtime, resumable at any moment."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from hapticlod.errors import InputError
from hapticlod.shipped import shipped_config
from tuning.commands.outputs import check_writable
from tuning.commands.status import DONE, INTERRUPTED, PARTIAL
from tuning.commands.tune import DEFAULT_STATION, DEFAULT_TOOL

if TYPE_CHECKING:
    from tuning.compare.batch import Executor

Several = Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=(), show_default=False)]


def compare_command(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    scans: Several = (),
    configs: Several = (),
    tools: Several = (),
    stations: Several = (),
    motions: Several = ("strokes",),
    unit: str | None = None,
    seconds: float = 4.0,
    seed: int = 0,
    workers: int | None = None,
    core: int | None = None,
    scheduler: str = "",
    csv: Path | None = None,
    parquet: Path | None = None,
) -> int:
    """Measure configurations on many scans, and rank them.

    Every cell (scan, configuration, tool, station, motion) goes into one file as soon as it is measured. Run the same
    command again after an interruption: what is in the file is not measured again. Without --scans nothing is measured;
    the table of what the file holds is printed.

    Exit status: 0 all cells are done, 3 some failed (named on standard error and in the file), 2 bad input.

    Parameters
    ----------
    output
        The ledger to write or to go on with (SQLite).
    scans
        Triangle meshes: paths and patterns such as "scans/**/*.stl".
    configs
        Configurations (configs/levels/), schemes in proportions (configs/policies/), and the word tuned. Default: all
        that are shipped in configs/policies/.
    tools
        Tool files. Default: a point.
    stations
        Station files. Default: a desktop at 1 kHz.
    motions
        Recordings; or probe, trace, scan, transfer: strokes of that kind; or strokes: all four together.
    unit
        Unit of the scans' coordinates. Default: what each file says, else a guess by its size.
    seconds
        Length of each kind of strokes.
    seed
        Of strokes and tuning.
    workers
        Processes that measure what does not hang on the clock. Default: one per core. Timings run one at a time.
    core
        To time on. Default: the last one.
    scheduler
        Address of a Dask scheduler (tcp://...), or local: workers of a cluster instead of processes here.
    csv
        Also write all cells as CSV.
    parquet
        Also write all cells as Parquet.
    """
    from tuning.compare.ledger import Ledger

    for table in (csv, parquet):
        if table is not None:
            check_writable(table, [output, *[other for other in (csv, parquet) if other is not table and other]])
    out, notes = Console(highlight=False), Console(stderr=True, highlight=False, soft_wrap=True)
    if not scans and not output.exists():
        raise InputError("--scans", "is missing", "say which scans to measure")
    failed = 0
    with Ledger(output, writable=bool(scans)) as ledger:
        if scans:
            from tuning.compare.batch import run_batch
            from tuning.compare.plan import plan_cells

            shipped = str(shipped_config("policies/fixed_finest.toml").parent / "*.toml")
            cells = plan_cells(
                scans, configs or (shipped,), tools or (str(shipped_config(DEFAULT_TOOL)),),
                stations or (str(shipped_config(DEFAULT_STATION)),), motions, unit=unit, seconds=seconds, seed=seed,
            )  # fmt: skip
            _check_core(core)
            try:
                with _executor(scheduler, workers) as executor:
                    found = run_batch(
                        cells, ledger, executor, core=core, told=lambda line: notes.print(line, markup=False)
                    )
            except KeyboardInterrupt:
                notes.print(f"interrupted; {output} keeps what was measured: run the same command to go on")
                return INTERRUPTED
            failed = len(found.failed)
            notes.print(f"{found.measured} cells measured, {found.kept} were done before, {failed} failed")
            known = {cell.key for cell in cells}
            rows = [row for row in ledger.rows() if row.key in known]
        else:
            rows = ledger.latest()
            failed = sum(row.error is not None and not row.is_done for row in rows)
    _show(rows, out)
    if csv is not None or parquet is not None:
        from tuning.compare.export import write_csv, write_parquet

        if csv is not None:
            write_csv(csv, rows)
        if parquet is not None:
            write_parquet(parquet, rows)
    return PARTIAL if failed else DONE


def _show(rows: list, out: Console) -> None:
    from tuning.compare.ranking import failures, ranking_table

    scans, done = len({row.scan for row in rows}), sum(row.is_done for row in rows)
    title = f"{done} of {len(rows)} cells on {scans} scan{'s' if scans != 1 else ''}; medians over cells"
    out.print(ranking_table(rows, title))
    for line in failures(rows):
        out.print(line, markup=False, soft_wrap=True)


def _check_core(core: int | None) -> None:
    allowed = os.sched_getaffinity(0)
    if core is not None and core not in allowed:
        raise InputError(f"--core {core}", "is no core that this process may use", f"give one of {sorted(allowed)}")


def _executor(scheduler: str, workers: int | None) -> Executor:
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}", "is no number of processes", "give 1 or more")
    count = workers or len(os.sched_getaffinity(0))
    if scheduler:
        from tuning.compare.cluster import DaskWorkers

        return DaskWorkers(scheduler, count)
    from tuning.compare.local import LocalWorkers

    return LocalWorkers(count)
