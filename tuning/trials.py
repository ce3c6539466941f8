"""Trials near the best that was measured: next comes what should gain most, chance allowed for.

p99.9 rests on a few dozen ticks: measured over like configurations it trembles by some per cent, of which no model
knows, and a few per cent of cost are worth a per cent or two of feel. So, of many configurations near the best, the one
of the greatest expected feasible improvement is measured: what the surrogate says would be gained, times the chance
that the cost holds the budget (Schonlau 1997; Gardner et al. 2014), by what was measured near it so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr

from hapticlod.station import Station
from tuning.candidate import COST, Candidate, cost_us
from tuning.search import Found, Limits
from tuning.space import Space

PROPOSED = 48  # points near the best that the surrogate looks at before each trial
LEAST_GAIN = 2e-3  # of the objective: less is expected of no proposal, and trials end
# ln measured over predicted cost: how far it varies from configuration to configuration where nothing is known yet, and
# how many measurements that counts as; what part of the variance even those that are alike do not share; and over how
# much of ln triangles, balls and cells they become unlike.
_VARIES, _COUNTS = 0.05, 2
_TREMBLES = 0.05
_REACH = np.array([0.3, 0.5, 0.6])
_NEAR = 0.3  # in ln predicted cost: what is further from the best tells nothing of it


class Glances(Protocol):
    """What a search offers: objective, p99.9 cost and memory of many points."""

    def glances(self, points: Sequence[NDArray[np.float64]], levels: int, limits: Limits) -> list[Found]: ...


class CostError:
    """ln measured over predicted cost near what was measured: ordinary kriging (Jones, Schonlau and Welch 1998).

    What is alike errs alike, and what was measured to cost too much is not tried again next to it.
    """

    def __init__(self, measured: Sequence[Candidate], levels: int, space: Space) -> None:
        known = [(c.found.x, cost_us(c) / c.predicted[COST]) for c in measured if c.found is not None]
        self._levels, self._space = levels, space
        self._at = np.array([self._scaled(x) for x, _ in known])
        error = np.log([ratio for _, ratio in known])
        self._factor = cho_factor(self._alike(self._at, self._at) + _TREMBLES * np.eye(len(known)))
        self._ones = cho_solve(self._factor, np.ones(len(known)))
        self._usual = float(self._ones @ error / self._ones.sum())
        self._weights = cho_solve(self._factor, error - self._usual)
        seen = float((error - self._usual) @ self._weights)
        self._variance = (_COUNTS * _VARIES**2 + seen) / (_COUNTS + len(known) - 1)

    def expected(self, x: NDArray[np.float64]) -> tuple[float, float]:
        """Mean and standard deviation at a point."""
        alike = self._alike(self._scaled(x)[None], self._at)[0]
        left = 1.0 + _TREMBLES - alike @ cho_solve(self._factor, alike)
        left += (1.0 - alike @ self._ones) ** 2 / self._ones.sum()
        return self._usual + float(alike @ self._weights), float(np.sqrt(self._variance * left))

    def _scaled(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return (self._space.log_levels(x, self._levels) / _REACH[:, None]).ravel()

    @staticmethod
    def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-np.linalg.norm(a[:, None] - b[None], axis=2))


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
    near = [c for c in like if abs(np.log(c.predicted[COST] / best.predicted[COST])) < _NEAR]
    error = CostError(near, levels, space)
    proposals = search.glances(space.around(at.x, levels, PROPOSED, random), levels, limits)

    def expected(found: Found) -> tuple[float, float]:
        """The cost, us, and how far ln of it is off."""
        mean, spread = error.expected(found.x)
        return found.predicted[COST] * float(np.exp(mean)), spread

    def gain(found: Found) -> float:
        if not np.isfinite(found.objective) or found.predicted["memory_mb"] > station.memory_mb:
            return 0.0
        us, spread = expected(found)
        chance = float(ndtr(np.log(station.budget_us / us) / spread))
        return max(best.objective - best.mispredicted * found.objective, 0.0) * chance

    first = max(proposals, key=gain)
    return (first, expected(first)[0]) if gain(first) > LEAST_GAIN * best.objective else None
