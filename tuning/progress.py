"""Progress of the stages of a long job: a live bar on a terminal, a line per stage elsewhere, then seconds per stage.

A job reports by calling `progress(stage, fraction)`: the stage's name as users read it, and how much of it is done,
0 to 1. Stages may take turns.
"""

import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

Report = Callable[[str, float], None]


class StageProgress:
    """Shows stages on `console` (standard error, so that standard output stays clean) while the `with` block runs."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._seconds: dict[str, float] = {}
        self._stage = ""
        self._since_s = 0.0
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        if console.is_terminal:
            columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
            self._bars = Progress(*columns, console=console, transient=True)

    def __enter__(self) -> Report:
        if self._bars is not None:
            self._bars.start()
        return self._report

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._turn_to("")
        if self._bars is not None:
            self._bars.stop()
        if kind is None:
            for stage, seconds in self._seconds.items():
                self._console.print(f"{seconds:7.1f} s  {stage}", highlight=False, markup=False)

    def _report(self, stage: str, fraction: float) -> None:
        if stage != self._stage:
            self._turn_to(stage)
        if self._bars is not None:
            self._bars.update(self._tasks[stage], completed=min(max(fraction, 0.0), 1.0))

    def _turn_to(self, stage: str) -> None:
        now = time.monotonic()
        if self._stage:
            self._seconds[self._stage] += now - self._since_s
        self._stage, self._since_s = stage, now
        if not stage or stage in self._seconds:
            return
        self._seconds[stage] = 0.0
        if self._bars is not None:
            self._tasks[stage] = self._bars.add_task(stage, total=1.0)
        else:
            self._console.print(f"{stage} ...", highlight=False, markup=False)
