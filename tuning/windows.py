"""Short parts of motions that stand for all of them: from the middle, and about the dearest ticks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion import Motion

SETTLING_TICKS = 32  # before those that are asked for: they put the tool in its place


def middle(motion: Motion, ticks: int) -> Motion:
    """So many ticks of a motion, or all where it is shorter."""
    return _stretch(motion, (motion.ticks - ticks) // 2, ticks)


def dearest(motion: Motion, rows: NDArray, ticks: int) -> Motion:
    """So many ticks of a motion about those that ask most, by what was counted over its first so many."""
    asked = np.sum(
        [rows[name][: motion.ticks] / max(rows[name].mean(), 1e-9) for name in ("triangles", "tests")], axis=0
    )
    # Where the window's tail is largest, not its sum: p99.9 rests on single ticks.
    at = int(np.argmax(np.convolve(np.square(asked), np.ones(ticks - SETTLING_TICKS), mode="same")))
    return _stretch(motion, at - ticks // 2, ticks)


def _stretch(motion: Motion, first: int, ticks: int) -> Motion:
    """So many ticks from about the first on, moved to where the motion has them."""
    first = min(max(first, 0), max(motion.ticks - ticks, 0))
    return motion.part(first / motion.loop_hz, min(first + ticks, motion.ticks) / motion.loop_hz)
