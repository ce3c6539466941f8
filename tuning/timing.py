"""Times a few ticks of the ladder so often that what else slows a machine does not count."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion import Motion
from hapticlod.station import CostCoefficients
from tuning.calibrate import PriceCurve, counted_cost_ns, price_curve, without_interrupts
from tuning.costing import Costing
from tuning.grid import Grid
from tuning.level_prices import LevelPrices, TimedLevel, level_prices
from tuning.replays import Bench, replay_fixed
from tuning.windows import SETTLING_TICKS, dearest, middle

# So many ticks from the middle of each motion and as many about its dearest, of which a tick's time is its least over
# passes that lie seconds apart: other programs, and whatever else slows a machine, come in bursts.
TIMED_TICKS, _FEWEST_PASSES, _MOST_PASSES, _TIMED_S = 120, 3, 8, 3.0
_TAIL_SHARE = 0.02  # of these ticks decide what a level is priced at


# Rows of one level, and its bytes and balls.
Timed = tuple[NDArray, int, int]


def counters_only(rows: NDArray) -> NDArray:
    """Time and counters of rows of RECORD_DTYPE."""
    names = ["cost_ns", "cells", "triangles", "tests", "iterations", "balls", "mapping_cells"]
    out = np.zeros(len(rows), dtype=[(name, rows.dtype[name]) for name in names])
    for name in names:
        out[name] = rows[name]
    return out


def curve_of(records: Sequence[Timed], here: CostCoefficients) -> PriceCurve:
    """What these prices get wrong by the size of a tick."""
    counted = [counted_cost_ns(rows, size, here, balls) for rows, size, balls in records]
    return price_curve(np.concatenate([rows["cost_ns"] for rows, _, _ in records]), np.concatenate(counted))


def time_ticks(
    bench: Bench, levels: Sequence, chosen: Sequence[int], motions: Sequence[Motion], first: Sequence[NDArray]
) -> tuple[list[tuple[int, int]], list[Timed]]:
    """A few replays, one after the other, again and again: a tick's time is its least of all passes.

    Returns:
        rung and cell size of those with all balls, and the rows: of these, then of the fewest balls.
    """
    grid, ticks = bench.grid, SETTLING_TICKS + TIMED_TICKS
    parts = [middle(motion, ticks) for motion in motions]
    parts += [dearest(motion, rows, ticks) for motion, rows in zip(motions, first, strict=True)]
    places = [(0, grid.base_cell)] if 0 not in chosen else []
    places += [(r, h) for r in chosen for h in range(len(grid.cell_edges))]
    few = [(r, grid.base_cell) for r in chosen] if grid.shape[1] > 1 else []
    most, fewest = max(grid.balls), min(grid.balls)
    asked = [(r, h, most) for r, h in places] + [(r, h, fewest) for r, h in few]
    built = {(r, h): levels[r] if h == grid.base_cell else bench.level(r, h) for r, h in places}
    least: list[NDArray] = []
    began, passes = time.monotonic(), 0
    while passes < _FEWEST_PASSES or (passes < _MOST_PASSES and time.monotonic() - began < _TIMED_S):
        for i, (r, h, balls) in enumerate(asked):
            replays = replay_fixed(bench, built[r, h], r, balls, parts, 1, h)
            rows = counters_only(np.concatenate([rows[SETTLING_TICKS:] for rows in replays]))
            if passes:
                rows["cost_ns"] = np.minimum(rows["cost_ns"], least[i]["cost_ns"])
                least[i] = rows
            else:
                least.append(rows)
        passes += 1
    made = [(rows, built[r, h].bytes, balls) for rows, (r, h, balls) in zip(least, asked, strict=True)]
    return places, made


def prices_of_levels(
    grid: Grid, places: Sequence[tuple[int, int]], timed: Sequence[Timed], costing: Costing
) -> LevelPrices:
    """`places`: rung and cell size of the first that were timed."""
    made = []
    for (r, h), (rows, size, balls) in zip(places, timed, strict=False):
        counted_ns = counted_cost_ns(rows, size, costing.here, balls)
        counted_ns *= costing.curve.factor(counted_ns)
        time_ns = without_interrupts(rows, counted_ns)
        made.append(
            TimedLevel(grid.triangles[r], grid.cell_edges[h], _dearest_mean(time_ns), _dearest_mean(counted_ns))
        )
    return level_prices(made, grid.triangles, grid.edge_mm)


def _dearest_mean(cost: NDArray[np.float64]) -> float:
    count = max(1, round(_TAIL_SHARE * len(cost)))
    return float(np.partition(cost, -count)[-count:].mean())
