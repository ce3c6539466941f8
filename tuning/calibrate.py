"""Station cost coefficients from timed replays: nanoseconds per counted thing, robustly.

A tick's time is its counters times coefficients that are not negative, plus what nobody counts: cache misses, branch
mispredictions, and interrupts. Relative errors are fitted by iteratively reweighted non-negative least squares, with
weights that ignore outliers (Geman-McClure); what is left is reported as the tail. Levels too big for the caches cost
more per count: the gain over small levels is fitted from the residuals. It stays a model: on levels much larger than
those measured the gain is an extrapolation.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hapticlod.station import CostCoefficients
from tuning.replays import COUNTERS

Array = NDArray[np.float64]

_ROUNDS = 12
_IDLE = 2  # the first features: a tick, and the balls that it turns
_SCALE = 0.5  # relative error beyond which a tick counts little
_FLOOR_NS = 200.0  # below this a tick's time is mostly the clock's
_MOST_TICKS = 40_000
_CACHE_MB = 32.0
_CURVE_STEP, _FEWEST_ON_CURVE = 0.5 * np.log(2.0), 20
_TOGETHER = 0.3  # how far ln(time / counted) of undisturbed ticks of one size spreads


def calibrate(
    records: Sequence[NDArray],
    level_bytes: Sequence[int],
    level_balls: Sequence[int],
    seed: int = 0,
    repeated: int | None = None,
) -> CostCoefficients:
    """Coefficients of this machine.

    Args:
        records: rows of RECORD_DTYPE of fixed-level replays, timed; the wider the range of counters, the better.
        level_bytes: of the level of each record. level_balls: likewise, how many of the tool's balls it has.
        seed: of the ticks that are drawn where there are more than some ten thousands.
        repeated: how many records, from the first, hold the least time of several runs: the tail is read from these,
            since in the others it is mostly the operating system's. None: all.
    """
    counters, cost, size, source = _gather(records, level_bytes, seed)
    balls = np.asarray(level_balls, dtype=np.float64)[source.astype(np.intp)]
    several = counters[:, COUNTERS.index("tests")] * (1.0 - 1.0 / balls)
    features = np.column_stack([np.ones(len(cost)), balls - 1.0, counters, several])
    scale = np.maximum(np.abs(features).max(axis=0), 1.0)
    weight = 1.0 / np.maximum(cost, _FLOOR_NS)
    coefficients = np.zeros(features.shape[1])
    factor = np.ones(len(cost))
    gain = 0.0
    for _ in range(_ROUNDS):
        # what a tick costs that touches nothing does not depend on the level's size, everything counted does
        design = np.column_stack([features[:, :_IDLE], features[:, _IDLE:] * factor[:, None]])
        solution, _ = nnls((design / scale) * weight[:, None], cost * weight)
        coefficients = solution / scale
        fitted = np.maximum(design @ coefficients, 1.0)
        error = (cost - fitted) / np.maximum(fitted, _FLOOR_NS)
        weight = 1.0 / (np.maximum(fitted, _FLOOR_NS) * (1.0 + (error / _SCALE) ** 2))
        idle = features[:, :_IDLE] @ coefficients[:_IDLE]
        gain = _cache_gain(features[:, _IDLE:] @ coefficients[_IDLE:], cost - idle, size, weight)
        factor = 1.0 + gain * size / (size + _CACHE_MB)
    fitted = np.column_stack([features[:, :_IDLE], features[:, _IDLE:] * factor[:, None]]) @ coefficients
    clean = source < (len(records) if repeated is None else repeated)
    fitted, cost = fitted[clean], cost[clean]
    dear = fitted >= np.quantile(fitted, 0.9)  # the tail of cheap ticks threatens no budget
    ratio = cost[dear] / np.maximum(fitted[dear], 1.0)
    names = ("base_ns", "carried_ball_ns", *(f"{name[:-1]}_ns" for name in COUNTERS), "union_test_ns")
    values = dict(zip(names, map(float, coefficients), strict=True))
    return CostCoefficients(
        **values,
        cache_mb=_CACHE_MB,
        cache_gain=gain,
        tail_p99=max(1.0, float(np.quantile(ratio, 0.99))),
        tail_p999=max(1.0, float(np.quantile(ratio, 0.999))),
        measured_on=f"{_processor()}, {len(source)} ticks",
    )


def _gather(records: Sequence[NDArray], level_bytes: Sequence[int], seed: int) -> tuple[Array, Array, Array, Array]:
    """Counters (n, 6), cost ns, level size MB and number of the record (n,) of ticks drawn evenly from all records."""
    rng = np.random.default_rng(seed)
    share = max(1, _MOST_TICKS // max(len(records), 1))
    counters, cost, size, source = [], [], [], []
    for number, (rows, count) in enumerate(zip(records, level_bytes, strict=True)):
        drawn = rows[_drawn(rows["cost_ns"], share, rng)]
        counters.append(np.column_stack([drawn[name].astype(np.float64) for name in COUNTERS]))
        cost.append(drawn["cost_ns"].astype(np.float64))
        size.append(np.full(len(drawn), count / 1e6))
        source.append(np.full(len(drawn), number))
    return np.concatenate(counters), np.concatenate(cost), np.concatenate(size), np.concatenate(source)


def _drawn(cost: Array, share: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Ticks of one record: half of them from the dearest tenth, which decides what a loop must afford."""
    if len(cost) <= share:
        return np.arange(len(cost))
    order = np.argsort(cost)
    cut = len(cost) - len(cost) // 10
    dear = rng.choice(order[cut:], min(share // 2, len(cost) - cut), replace=False)
    return np.concatenate([dear, rng.choice(order[:cut], min(share - len(dear), cut), replace=False)])


def _cache_gain(work: Array, cost: Array, size_mb: Array, weight: Array) -> float:
    """Least-squares g >= 0 of cost = work (1 + g s / (s + cache_mb))."""
    slope = work * size_mb / (size_mb + _CACHE_MB) * weight
    total = float(slope @ slope)
    return max(0.0, float(slope @ ((cost - work) * weight)) / total) if total > 0 else 0.0


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def counted_cost_ns(
    rows: NDArray, level_bytes: int | Array, coefficients: CostCoefficients, level_balls: int | Array = 1
) -> Array:
    """(T,) cost of ticks by their counters alone, on levels of so many bytes and balls."""
    counters = {name: rows[name].astype(np.float64) for name in COUNTERS}
    return np.asarray(coefficients.tick_cost_ns(**counters, level_bytes=level_bytes, level_balls=level_balls))


@dataclass(frozen=True)
class PriceCurve:
    """What counters alone get wrong by the size of a tick: ln(time / counted) along ln counted, flat beyond its ends.

    One price per counted thing holds on average only: a tick of many iterations asks more of each test than one that
    rests. `log_ns`, `log_ratio`: (n,).
    """

    log_ns: Array
    log_ratio: Array

    def factor(self, counted_ns: Array) -> Array:
        """What a counted cost must be multiplied by."""
        return np.exp(np.interp(np.log(np.maximum(counted_ns, 1.0)), self.log_ns, self.log_ratio))


NO_CURVE = PriceCurve(np.zeros(1), np.zeros(1))


def price_curve(time_ns: Array, counted_ns: Array) -> PriceCurve:
    """The commonest ratio per half octave; ticks that are few there are left out.

    Not the median: on a busy machine most of the longest ticks lose the processor once, and the operating system would
    be priced in.
    """
    log = np.log(np.maximum(counted_ns, 1.0))
    ratio = np.log(np.maximum(time_ns, 1.0)) - log
    place = np.floor(log / _CURVE_STEP).astype(int)
    order = np.argsort(place, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(place[order])) + 1)
    knots = [(np.median(log[g]), commonest(ratio[g])) for g in groups if len(g) >= _FEWEST_ON_CURVE]
    if not knots:
        return PriceCurve(np.zeros(1), np.array([np.median(ratio) if len(ratio) else 0.0]))
    return PriceCurve(*np.array(knots).T)


def commonest(values: Array) -> float:
    """Where most values lie together: the median of those in the fullest interval of a width, the lowest if several."""
    ordered = np.sort(values)
    count = np.searchsorted(ordered, ordered + _TOGETHER, side="right") - np.arange(len(ordered))
    first = int(np.argmax(count))
    return float(np.median(ordered[first : first + count[first]]))


def without_interrupts(rows: NDArray, counted_ns: Array) -> Array:
    """(T,) measured cost, ns, without the excess of ticks that were interrupted.

    A tick whose measured over counted cost lies far outside what its record's other ticks show did not do more work:
    the operating system did. What is far is taken from the record itself, so that a cost that nobody counts but many
    ticks pay is kept.
    """
    cost = rows["cost_ns"].astype(np.float64)
    log = np.log(np.maximum(cost, 1.0) / np.maximum(counted_ns, 1.0))
    middle, high = np.quantile(log, (0.5, 0.95))
    limit = middle + 3.0 * max(high - middle, 0.1)
    return cost * np.exp(np.minimum(0.0, limit - log))
