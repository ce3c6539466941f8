"""Makes hands in several processes: a hand is made by Python, and Python's threads take turns.

A further process is a program that reads its share from one file and writes motions to another: it asks nothing of who
calls this, neither a guarded main module nor a process without threads. One that fails costs time and nothing else.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion import Motion, synthesise
from hapticlod.motion.strokes import Mode
from hapticlod.motion.surface import ScanLike
from hapticlod.station import Station
from hapticlod.tool import Tool

# Seconds of hands that a further process must be worth: it takes a second or two to start and to know the surface.
FEWEST_S = 20.0


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
    """The hands, in their order, by at most so many processes; by one where there is little to do."""
    worth = 1 + int(sum(hand.seconds for hand in hands) / FEWEST_S)
    ours, *others = _shares(hands, max(1, min(processes, worth)))
    known = _Walked(
        np.asarray(scan.vertices), np.asarray(scan.faces), getattr(scan, "name", ""), getattr(scan, "digest", "")
    )
    made: dict[int, Motion] = {}
    with TemporaryDirectory() as folder:
        files = [Path(folder) / str(i) for i in range(len(others))]
        if others:
            _shared(files[0]).write_bytes(pickle.dumps((known, station, tool)))
        running: list[subprocess.Popen[bytes] | None] = []
        try:
            for file, share in zip(files, others, strict=True):
                file.write_bytes(pickle.dumps([hands[i] for i in share]))
                running.append(_started(file))
            made |= {i: _made(scan, station, tool, hands[i]) for i in ours}
            for file, share, process in zip(files, others, running, strict=True):
                if process is not None and process.wait() == 0:
                    motions = pickle.loads(_answer(file).read_bytes())
                else:
                    motions = [_made(scan, station, tool, hands[i]) for i in share]
                made |= zip(share, motions, strict=True)
        finally:
            for process in filter(None, running):
                process.kill()
                process.wait()
    return [made[i] for i in range(len(hands))]


def _started(file: Path) -> subprocess.Popen[bytes] | None:
    """In a session of its own: Ctrl-C is ours to answer. None: it cannot be."""
    known = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        return subprocess.Popen(
            [sys.executable, "-m", __spec__.name, str(file)], env=known, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except OSError:
        return None


def _shared(file: Path) -> Path:
    """What all processes of a folder are told."""
    return file.with_name("shared")


def _answer(file: Path) -> Path:
    return file.with_suffix(".made")


def _made(scan: ScanLike, station: Station, tool: Tool, hand: Hand) -> Motion:
    return synthesise(
        scan, hand.mode, seconds=hand.seconds, loop_hz=station.loop_hz, seed=hand.seed, tool=tool,
        stiffness_n_mm=station.stiffness_n_mm, max_force_n=station.max_force_n, encoder_mm=station.encoder_mm,
    )  # fmt: skip


def _shares(hands: Sequence[Hand], count: int) -> list[list[int]]:
    """Who makes which, by index: the longest hands first, each to who has least to do."""
    # Fast hands go further in the same time, and what takes time is the way.
    effort = [hand.seconds * (2.0 if hand.mode == "transfer" else 1.0) for hand in hands]
    shares: list[list[int]] = [[] for _ in range(count)]
    for i in sorted(range(len(hands)), key=lambda i: -effort[i]):
        min(shares, key=lambda share: sum(effort[j] for j in share)).append(i)
    return shares


def main() -> None:
    """A further process: the file that is named tells what to make."""
    file = Path(sys.argv[1])
    scan, station, tool = pickle.loads(_shared(file).read_bytes())
    hands = pickle.loads(file.read_bytes())
    _answer(file).write_bytes(pickle.dumps([_made(scan, station, tool, hand) for hand in hands]))


if __name__ == "__main__":
    main()
