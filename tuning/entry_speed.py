"""How much dearer it is to enter a level when the hand is fast: a relay, which switches at any speed, does not say it.

A station switches at the speeds of its thresholds. A relay's entries are those of all the hand's speeds, so their costs
are moved to the speed of the threshold, along slopes that all rungs share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from hapticlod.surrogate.cost import share_middles

Array = NDArray[np.float64]

# Cut-off of the speed that is compared with thresholds: the middle of those that may be chosen.
SPEED_HZ = 13.0
_CLASSES, _FEWEST = 6, 40
_STEEPEST = 1.0
_LEAST_MM_S = 1.0


def smooth_speed_mm_s(velocity_mm_s: Array, loop_hz: float) -> Array:
    """(T,) speed of the hand behind a one-pole filter on each component, as in the runtime."""
    gain = np.exp(-2 * np.pi * SPEED_HZ / loop_hz)
    return np.linalg.norm(np.asarray(lfilter([1 - gain], [1, -gain], velocity_mm_s, axis=0)), axis=1)


def speed_slopes(costs: Sequence[Array], speeds_mm_s: Sequence[Array]) -> tuple[Array, Array]:
    """Slopes of ln cost along ln speed, and the speeds they hold for.

    Args:
        costs, speeds_mm_s: (n,) of the ticks that entered a level, in contact, one array for each level.

    Returns:
        (M,) slopes, at least 0, of each of the shares `hapticlod.surrogate.cost.SWITCH_SHARES`; and ln of low, usual
        and high speed, mm/s. All slopes are 0 where too few ticks entered to tell.
    """
    used = [(np.log(c), np.log(np.maximum(v, _LEAST_MM_S))) for c, v in zip(costs, speeds_mm_s, strict=True) if len(c)]
    middles = share_middles()
    if not used or sum(len(c) for c, _ in used) < _CLASSES * _FEWEST:
        return np.zeros(len(middles)), np.zeros(3)
    excess = np.concatenate([c - np.median(c) for c, _ in used])
    speed = np.concatenate([v for _, v in used])
    parts = np.array_split(np.argsort(speed, kind="stable"), _CLASSES)
    at = np.array([speed[part].mean() for part in parts])
    quantiles = np.array([np.quantile(excess[part], middles) for part in parts])
    centred = at - at.mean()
    slopes = centred @ quantiles / max(float(centred @ centred), 1e-12)
    span = np.array([*np.quantile(speed, (0.02, 0.5, 0.98))])
    return np.clip(slopes, 0.0, _STEEPEST), span
