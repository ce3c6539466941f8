"""What the surrogate is asked for so that what is measured meets the budget."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hapticlod.station import Station
from tuning.candidate import Candidate, cost_us
from tuning.search import Limits

AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected
MUCH_LESS = 0.7  # how much less is asked for, at least, after several measurements over the budget in a row
# How much more is asked for, at most, than what held: two noisy tails once made a slope that asked for three times it.
MORE = 1.5
# Slopes of ln (measured / predicted) along ln budget that are believed, and how near to the ends of a bracket one goes.
_SLOPES, _INSET = (-0.8, 3.0), 0.05


@dataclass
class Correction:
    """What the surrogate's budget is multiplied by so that the measured cost meets the station's.

    How measured exceeds predicted cost changes with the budget, so the last two measurements make a line of one's
    logarithm along the other's.

    Attributes:
        value: that is in use. held, broke: the largest that was measured within the budget, the least that was not.
        misses: measurements over the budget in a row.
        factors: ln value and ln measured over predicted cost, of every measurement. last: of them.
    """

    value: float
    held: float = 0.0
    broke: float = np.inf
    misses: int = 0
    factors: list[tuple[float, float]] = field(default_factory=list)
    last: Candidate | None = None

    def expected_us(self, predicted_us: float) -> float:
        """What a cost that is predicted at the value in use should be measured as."""
        if not self.factors:
            return predicted_us / self.value
        at, factor, slope = self._line()
        return predicted_us * float(np.exp(factor + slope * (np.log(self.value) - at)))

    def _line(self) -> tuple[float, float, float]:
        """The last point, and the slope there; it is kept where a larger budget still buys more cost."""
        (at, factor), before = self.factors[-1], self.factors[-2:-1]
        slope = (factor - before[0][1]) / (at - before[0][0]) if before and at != before[0][0] else 0.0
        return at, factor, float(np.clip(slope, *_SLOPES))

    def corrected(self, candidate: Candidate, station: Station) -> bool:
        """Takes a measurement in. False: it is as near to the budget as makes sense, or the budget does not bind."""
        self.take(candidate)
        return self.goes_on(station, AGREE)

    def take(self, candidate: Candidate) -> None:
        """Learns from what was measured at the value in use."""
        self.last = candidate
        predicted_us = candidate.predicted["loop_cost_p999_us"]
        self.factors.append((float(np.log(self.value)), float(np.log(cost_us(candidate) / predicted_us))))
        if candidate.feasible:
            self.held, self.misses = max(self.held, self.value), 0
        else:
            self.broke, self.misses = min(self.broke, self.value), self.misses + 1

    def goes_on(self, station: Station, near: float) -> bool:
        """Sets the value that should meet the budget. False: the last is within `near` of it, or it does not bind."""
        assert self.last is not None
        at, factor, slope = self._line()
        value = float(np.exp(at))
        share = self.last.predicted["loop_cost_p999_us"] / (value * station.budget_us)
        wanted = float(np.exp(at + (np.log((1.0 - 0.5 * near) / share) - factor - at) / (1.0 + slope)))
        if self.last.feasible:
            if cost_us(self.last) > (1.0 - near) * station.budget_us or share < 1.0 - AGREE:
                return False
            wanted = float(np.clip(wanted, (1.0 + 0.5 * near) * value, MORE * value))
        else:
            wanted = min(wanted, (1.0 - near if self.misses == 1 else MUCH_LESS) * value)
        if self.held > 0.0 and self.broke < np.inf:
            if self.broke < (1.0 + 0.5 * near) * self.held:
                return False
            inset = min(_INSET * np.log(self.broke / self.held), 0.5 * near)
            wanted = float(np.clip(wanted, self.held * np.exp(inset), self.broke * np.exp(-inset)))
        self.value = float(np.clip(wanted, 0.03, 3.0))
        return True


def limits_of(station: Station, correction: float) -> Limits:
    """Of a station, its budget times the correction."""
    return Limits(station.budget_us * correction, station.memory_mb)
