"""Trials near the best that was measured: next comes what should gain most, chance allowed for.

p99.9 rests on a few dozen ticks: measured over like configurations it trembles by some per cent, of which no model
knows, and a few per cent of cost are worth a per cent or two of feel. So, of many configurations near the best, the one
of the greatest expected feasible improvement is measured: what the surrogate says would be gained, times the chance
that the cost holds the budget (Schonlau 1997; Gardner et al. 2014), the noise being that of what was measured so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hapticlod.station import Station
from tuning.candidate import COST, Candidate, cost_us
from tuning.search import Found, Limits
from tuning.space import Space

PROPOSED = 48  # points near the best that the surrogate looks at before each trial
LEAST_GAIN = 2e-3  # of the objective: less is expected of no proposal, and trials end
# Noise of ln measured over predicted cost: of one measurement that is always counted, and the least that is believed.
_PRIOR, _LEAST_NOISE = 0.04, 0.02
_LIKE = 0.08  # in ln predicted cost: how near others tell of one


class Glances(Protocol):
    """What a search offers: objective, p99.9 cost and memory of many points."""

    def glances(self, points: Sequence[NDArray[np.float64]], levels: int, limits: Limits) -> list[Found]: ...


class CostError:
    """ln measured over predicted cost along predicted cost, and how far single measurements lie off.

    A mean weighted by nearness in ln predicted cost (Nadaraya 1964, Watson 1964).
    """

    def __init__(self, measured: Sequence[Candidate]) -> None:
        told_us = [candidate.predicted[COST] for candidate in measured]
        self._at = np.log(told_us)
        self._error = np.log([cost_us(candidate) for candidate in measured]) - self._at
        off = self._error - [self.mean(told) for told in told_us]
        self.spread = max(float(np.sqrt((_PRIOR**2 + np.sum(np.square(off))) / len(told_us))), _LEAST_NOISE)

    def mean(self, predicted_us: float) -> float:
        """Expected where so much is predicted."""
        off = np.square((self._at - np.log(predicted_us)) / _LIKE)
        weight = np.exp(-0.5 * (off - off.min()))
        return float(weight @ self._error / weight.sum())


def next_trial(
    best: Candidate, like: Sequence[Candidate], levels: int, search: Glances, space: Space, station: Station,
    random: np.random.Generator,
) -> tuple[Found, float] | None:  # fmt: skip
    """The point near the best that is worth measuring next, and the cost that is expected of it; None: none is.

    Args:
        best: that holds its limits. like: all that were measured of so many levels, the best among them.
    """
    at = best.found
    if at is None:
        return None
    limits = Limits(station.budget_us, station.memory_mb)
    error = CostError(like)
    proposals = search.glances(space.around(at.x, levels, PROPOSED, random), levels, limits)

    def expected_us(found: Found) -> float:
        told = found.predicted[COST]
        return told * float(np.exp(error.mean(told)))

    def gain(found: Found) -> float:
        if not np.isfinite(found.objective) or found.predicted["memory_mb"] > station.memory_mb:
            return 0.0
        chance = float(ndtr(np.log(station.budget_us / expected_us(found)) / error.spread))
        return max(best.objective - best.mispredicted * found.objective, 0.0) * chance

    first = max(proposals, key=gain)
    return (first, expected_us(first)) if gain(first) > LEAST_GAIN * best.objective else None
