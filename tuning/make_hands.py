"""Makes hands in several processes: a hand is made by Python, and Python's threads take turns.

A further process is a program that takes one task after the other from a folder and leaves motions there: it asks
nothing of who calls this, neither a guarded main module nor a process without threads. One that fails costs time and
nothing else. Tasks are taken by renaming them, which succeeds for one taker: who began late, or has something else to
do first, takes fewer.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion import Motion, synthesise
from hapticlod.motion.strokes import Mode
from hapticlod.motion.surface import ScanLike
from hapticlod.station import Station
from hapticlod.tool import Tool

# Seconds of hands that a further process must be worth: it takes a second or two to start and to know the surface.
FEWEST_S = 20.0
_TASK, _TAKEN, _MADE = ".task", ".taken", ".made"


@dataclass(frozen=True)
class Hand:
    """Which hand to make."""

    mode: Mode
    seconds: float
    seed: int


@dataclass(frozen=True, eq=False)
class _Walked:
    """What a process is told of the scan."""

    vertices: NDArray[np.float64]
    faces: NDArray[Any]
    name: str
    digest: str


def make_hands(scan: ScanLike, station: Station, tool: Tool, hands: Sequence[Hand], processes: int) -> list[Motion]:
    """The hands, in their order, by at most so many processes, this one among them; by one where there is little."""
    with Making(scan, station, tool, hands, processes) as making:
        return making.finish()


class Making:
    """Hands that are being made by further processes, so that this one may do something else before it asks for them.

    A context: leaving it ends the processes, whatever became of the hands.

    Args:
        scan, station, tool, hands, processes: as for `make_hands`. Processes begin at once.
    """

    def __init__(self, scan: ScanLike, station: Station, tool: Tool, hands: Sequence[Hand], processes: int) -> None:
        self._asked, self._hands = (scan, station, tool), hands
        self._open = ExitStack()
        self._running: list[subprocess.Popen[bytes]] = []
        self._folder = Path()
        worth = 1 + int(sum(hand.seconds for hand in hands) / FEWEST_S)
        further = min(processes, worth, len(hands)) - 1
        if further < 1:
            return
        self._folder = Path(self._open.enter_context(TemporaryDirectory()))
        name, digest = getattr(scan, "name", ""), getattr(scan, "digest", "")
        known = _Walked(np.asarray(scan.vertices), np.asarray(scan.faces), name, digest)
        _shared(self._folder).write_bytes(pickle.dumps((known, station, tool, hands)))
        for i in range(len(hands)):
            _file(self._folder, i, _TASK).touch()
        for _ in range(further):
            self._start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running:
            process.kill()
            process.wait()
        self._open.close()

    def finish(self) -> list[Motion]:
        """The hands, in their order: here are made those that nobody has taken, or whose taker failed."""
        made: dict[int, Motion] = {}
        if self._running:
            for i in _by_effort(self._hands):
                if _took(self._folder, i):
                    made[i] = _made(*self._asked, self._hands[i])
            for process in self._running:
                process.wait()
            for i in range(len(self._hands)):
                if i not in made:
                    with suppress(OSError, EOFError, pickle.UnpicklingError):
                        made[i] = pickle.loads(_file(self._folder, i, _MADE).read_bytes())
        return [made[i] if i in made else _made(*self._asked, hand) for i, hand in enumerate(self._hands)]

    def _start(self) -> None:
        """In a session of its own: Ctrl-C is ours to answer. One that cannot be started is done without."""
        known = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with suppress(OSError):
            self._running.append(
                subprocess.Popen(
                    [sys.executable, "-m", __spec__.name, str(self._folder)], env=known, start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )
            )  # fmt: skip


def _shared(folder: Path) -> Path:
    """What all processes of a folder are told."""
    return folder / "shared"


def _file(folder: Path, hand: int, suffix: str) -> Path:
    return folder / f"{hand}{suffix}"


def _took(folder: Path, hand: int) -> bool:
    """Whether this process is the one that makes it."""
    try:
        _file(folder, hand, _TASK).rename(_file(folder, hand, _TAKEN))
    except OSError:
        return False
    return True


def _made(scan: ScanLike, station: Station, tool: Tool, hand: Hand) -> Motion:
    return synthesise(
        scan, hand.mode, seconds=hand.seconds, loop_hz=station.loop_hz, seed=hand.seed, tool=tool,
        stiffness_n_mm=station.stiffness_n_mm, max_force_n=station.max_force_n, encoder_mm=station.encoder_mm,
    )  # fmt: skip


def _by_effort(hands: Sequence[Hand]) -> list[int]:
    """The longest first, so that nobody begins a long one when all others are done."""
    # Fast hands go further in the same time, and what takes time is the way.
    effort = [hand.seconds * (2.0 if hand.mode == "transfer" else 1.0) for hand in hands]
    return sorted(range(len(hands)), key=lambda i: -effort[i])


def main() -> None:
    """A further process: makes what it can take in the folder that is named."""
    folder = Path(sys.argv[1])
    scan, station, tool, hands = pickle.loads(_shared(folder).read_bytes())
    for i in _by_effort(hands):
        if _took(folder, i):
            part = _file(folder, i, ".part")
            part.write_bytes(pickle.dumps(_made(scan, station, tool, hands[i])))
            part.rename(_file(folder, i, _MADE))


if __name__ == "__main__":
    main()
