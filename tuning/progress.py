"""Progress of the stages of a long job: a live bar on a terminal, one line per finished stage elsewhere.

A job reports by calling `progress(stage, fraction)`: the stage's name as users read it, and how much of it is done,
0 to 1. A new name ends the stage before it.
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
        self._stage: str | None = None
        self._started_s = 0.0
        self._task: TaskID | None = None
        self._bars: Progress | None = None
        if console.is_terminal:
            self._bars = Progress(
                TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True
            )

    def __enter__(self) -> Report:
        if self._bars is not None:
            self._bars.start()
        return self._report

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        if kind is None:
            self._close_stage()
        if self._bars is not None:
            self._bars.stop()

    def _report(self, stage: str, fraction: float) -> None:
        if stage != self._stage:
            self._close_stage()
            self._stage, self._started_s = stage, time.monotonic()
            if self._bars is not None:
                self._task = self._bars.add_task(stage, total=1.0)
        if self._bars is not None and self._task is not None:
            self._bars.update(self._task, completed=min(max(fraction, 0.0), 1.0))

    def _close_stage(self) -> None:
        if self._stage is None:
            return
        if self._bars is not None and self._task is not None:
            self._bars.remove_task(self._task)
        seconds = time.monotonic() - self._started_s
        self._console.print(f"{self._stage:<44} {seconds:6.1f} s", highlight=False, markup=False)
        self._stage = None
