"""Runs a comparison: what the ledger does not hold yet is measured, in two phases, and committed as it comes.

First everything that does not hang on the clock, in parallel; then the timings, one at a time on a core of their own.
Configurations that must be tuned are tuned before both, one at a time: the tuner times replays, with all cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Protocol

from hapticlod.errors import InputError
from tuning.compare.cell import Cell, measuring_digest
from tuning.compare.ledger import Ledger, Row
from tuning.compare.task import Outcome, Stage, Task
from tuning.machine import this_machine

Told = Callable[[str], None]


class Executor(Protocol):
    """Where tasks are done: `LocalWorkers`, or Dask workers (`tuning.compare.cluster`)."""

    def __enter__(self) -> Executor: ...
    def __exit__(self, *ended: object) -> None: ...

    def outcomes(self, tasks: Sequence[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome]]:
        """Each task with its outcome, as they come; `alone`: nothing beside it on its machine."""
        ...


@dataclass(frozen=True)
class Found:
    """What a run came to. `measured`: cells this run finished; `kept`: cells that were done before it."""

    measured: int
    kept: int
    failed: tuple[Row, ...]


def run_batch(
    cells: Sequence[Cell], ledger: Ledger, executor: Executor, *, core: int | None = None, told: Told | None = None
) -> Found:
    """Measures the cells that the ledger does not hold.

    Args:
        cells: of `tuning.compare.plan`. core: to time on.
        told: gets a line for every task that ends.

    Raises:
        InputError: the ledger cannot be written any more, or a worker ran other code; what was finished before is kept.
    """
    say: Told = told or (lambda line: None)
    about = {"cells": len(cells), "hapticlod": version("hapticlod"), "code": measuring_digest(), **this_machine()}
    ledger.note_run(about)
    held = {row.key: row for row in ledger.rows()}
    todo = [cell for cell in cells if cell.key not in held or not held[cell.key].is_done]
    felt = {cell.key for cell in todo if cell.key in held and held[cell.key].feel is not None}
    tuned = ledger.tunings()
    failed: set[str] = set()
    costed: set[str] = set()

    def fail(cell: Cell, stage: str, error: str) -> None:
        ledger.put_error(cell, error)
        failed.add(cell.key)
        say(f"{stage}  {_place(cell)}: failed: {error}")

    unknown = {c.tuning_key: c for c in todo if c.config is None and c.tuning_key not in tuned}
    for task, outcome, count in _counted(executor, [Task(Stage.TUNE, cell) for cell in unknown.values()], alone=True):
        key = task.cell.tuning_key
        if outcome.result is None:
            for cell in todo:
                if cell.config is None and cell.tuning_key == key:
                    fail(cell, count, outcome.error)
        else:
            ledger.put_tuning(key, outcome.result)
            tuned[key] = outcome.result
            levels = len(outcome.result["config"]["levels"])
            say(f"{count}  {_place(task.cell)}: tuned, {levels} level{'s' if levels > 1 else ''}")

    def tasks(stage: Stage, of: Iterable[Cell]) -> list[Task]:
        known = {c.key: tuned.get(c.tuning_key) if c.config is None else None for c in todo}
        return [Task(stage, cell, known[cell.key], core) for cell in of if cell.key not in failed]

    for task, outcome, count in _counted(
        executor, tasks(Stage.FEEL, [cell for cell in todo if cell.key not in felt]), alone=False
    ):
        if outcome.result is None:
            fail(task.cell, count, outcome.error)
            continue
        ledger.put_feel(task.cell, outcome.result)
        line = f"felt error {outcome.result['metrics']['felt_error_jnd']:.2f} JND"
        if outcome.timing is not None:
            ledger.put_timing(task.cell, outcome.timing)
            costed.add(task.cell.key)
            line += f", p99.9 {outcome.timing['metrics']['loop_cost_p999_us']:.1f} us"
        say(f"{count}  {_place(task.cell)}: {line}")
    # Only a clock needs the machine for itself. What is counted is left over where a run ended between feel and cost.
    left = [cell for cell in todo if cell.key not in costed]
    for clocked in (False, True):
        of = tasks(Stage.TIME, [cell for cell in left if (cell.station.cost is None) is clocked])
        for task, outcome, count in _counted(executor, of, alone=clocked):
            if outcome.result is None:
                fail(task.cell, count, outcome.error)
                continue
            ledger.put_timing(task.cell, outcome.result)
            say(f"{count}  {_place(task.cell)}: p99.9 {outcome.result['metrics']['loop_cost_p999_us']:.1f} us")
    bad = tuple(row for row in ledger.rows() if row.key in failed)
    return Found(len(todo) - len(failed), len(cells) - len(todo), bad)


def _counted(executor: Executor, tasks: list[Task], *, alone: bool) -> Iterator[tuple[Task, Outcome, str]]:
    for done, (task, outcome) in enumerate(executor.outcomes(tasks, alone=alone), 1):
        if outcome.result is not None and outcome.code != measuring_digest():
            # It would be kept under the code of this process.
            what, remedy = "a worker ran other code than this comparison was started with", "run the same command again"
            raise InputError("HapticLOD was changed meanwhile", what, remedy)
        yield task, outcome, f"{task.stage.value} {done}/{len(tasks)}"


def _place(cell: Cell) -> str:
    scan, config, tool, station, motion = cell.names
    return f"{scan}, {config}, {tool}, {station}, {motion}"
