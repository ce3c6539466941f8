"""How this machine's time becomes the station's: counters, what they get wrong, and the clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.station import CostCoefficients, Station
from tuning.calibrate import NO_CURVE, PriceCurve, counted_cost_ns, without_interrupts
from tuning.level_prices import NO_PRICES, LevelPrices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Costing:
    """How this machine's time becomes the station's.

    `here` are this machine's coefficients, `curve` what they get wrong by the size of a tick, `entering` the same of
    ticks that enter a level, and `levels` what is still wrong by the level. A station with coefficients of its own is
    taken to do the same counted work at its own prices; what nobody counts is taken to cost in proportion. `slowdown`
    multiplies everything.
    """

    here: CostCoefficients
    station: Station
    curve: PriceCurve = NO_CURVE
    entering: PriceCurve = NO_CURVE
    levels: LevelPrices = NO_PRICES

    def counted_ns(
        self, rows: NDArray, level_bytes: int | Array, level_balls: int | Array,
        enters: NDArray[np.bool_] | None = None, level_factor: float | Array = 1.0,
    ) -> Array:  # fmt: skip
        """(T,) cost on the station by counters alone: the same whenever it is asked for.

        `enters`: (T,) which ticks enter a level; None: none does. `level_factor`: `levels.factor` of each tick's level.
        """
        here = counted_cost_ns(rows, level_bytes, self.here, level_balls)
        cost = self.station.cost
        there = here if cost is None else counted_cost_ns(rows, level_bytes, cost, level_balls)
        return there * self._factor(here, enters) * level_factor * self.station.slowdown

    def cost_ns(
        self, rows: NDArray, level_bytes: int | Array, level_balls: int | Array,
        enters: NDArray[np.bool_] | None = None, level_factor: float | Array = 1.0,
    ) -> Array:  # fmt: skip
        """(T,) cost on the station by the clock, interrupts taken out. The rest as in `counted_ns`."""
        counted = counted_cost_ns(rows, level_bytes, self.here, level_balls)
        told = counted * self._factor(counted, enters) * level_factor
        cost = without_interrupts(rows, told) * self.station.slowdown
        if self.station.cost is None:
            return cost
        there = counted_cost_ns(rows, level_bytes, self.station.cost, level_balls)
        return cost * there / np.maximum(counted, 1.0)

    def _factor(self, counted_ns: Array, enters: NDArray[np.bool_] | None) -> Array:
        staying = self.curve.factor(counted_ns)
        return staying if enters is None else np.where(enters, self.entering.factor(counted_ns), staying)


def entered(rows: NDArray) -> NDArray[np.bool_]:
    """(T,) the ticks of one record that enter a level: those whose level is not that of the tick before."""
    return np.diff(rows["level"].astype(np.int64), prepend=rows["level"][:1]) != 0
