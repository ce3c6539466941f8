"""One piece of work that a worker does, and what came of it. Both travel between processes and machines."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from hapticlod.errors import HapticLODError
from tuning.compare.cell import Cell, measuring_digest


class Stage(Enum):
    """In this order: what is timed waits until nothing else runs."""

    TUNE = "tune"
    FEEL = "feel"
    TIME = "time"


@dataclass(frozen=True)
class Task:
    """`tuned`: what tuning gave, where the cell needs it. `core`: to time on; None: the worker's last."""

    stage: Stage
    cell: Cell
    tuned: dict[str, Any] | None = None
    core: int | None = None

    @property
    def key(self) -> str:
        """Different for every task of a comparison."""
        return f"{self.stage.value}-{self.cell.tuning_key if self.stage is Stage.TUNE else self.cell.key}"


@dataclass(frozen=True)
class Outcome:
    """A result, or in one line why there is none; `code`: what measured it, where the worker came to say so.

    `timing`: what a cell costs, where the replay that felt it has counted that as well.
    """

    result: dict[str, Any] | None = None
    error: str = ""
    code: str = ""
    timing: dict[str, Any] | None = None


def perform(task: Task) -> Outcome:
    """Does it here. Whatever goes wrong with a cell is its outcome: the comparison goes on."""
    from tuning.compare.measuring import feel_of, timing_of, tune_cell

    try:
        if task.stage is Stage.TUNE:
            return Outcome(tune_cell(task.cell), code=measuring_digest())
        if task.stage is Stage.FEEL:
            feel, timing = feel_of(task.cell, task.tuned)
            return Outcome(feel, code=measuring_digest(), timing=timing)
        return Outcome(timing_of(task.cell, task.tuned, task.core), code=measuring_digest())
    except HapticLODError as error:
        return Outcome(error=" ".join(str(error).split()))
    except Exception as error:  # of any library underneath: named in the table, and the next cell comes
        return Outcome(error=" ".join(f"{type(error).__name__}: {error}".split()))
