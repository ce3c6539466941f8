"""What prices get wrong by level and cell size: read from timed levels, and taken into account wherever costs are."""

import numpy as np
import pytest

from hapticlod.shipped import shipped_config
from hapticlod.station import CostCoefficients, load_station
from tuning.costing import Costing
from tuning.level_prices import NO_PRICES, TimedLevel, level_prices
from tuning.replays import COUNTERS

TRIANGLES, EDGE_MM, CELLS = (10_000, 1000, 100), (0.1, 0.3, 1.0), (1.5, 4.0, 10.0)
ERROR = np.array([[-0.1, 0.0, 0.1], [0.3, 0.1, -0.2], [0.2, 0.05, -0.1]])  # coarsest first


def timed(size: int, cell: int) -> TimedLevel:
    """Of the size-th level, coarsest first."""
    return TimedLevel(TRIANGLES[::-1][size], CELLS[cell], 1e4 * float(np.exp(ERROR[size, cell])), 1e4)


def test_levels_that_were_timed_are_priced_as_timed_and_others_in_between() -> None:
    prices = level_prices([timed(s, h) for s in range(3) for h in range(3)], TRIANGLES, EDGE_MM)
    for s, (triangles, edge_mm) in enumerate(zip(TRIANGLES[::-1], EDGE_MM[::-1], strict=True)):
        for h, cells in enumerate(CELLS):
            assert np.log(prices.factor(triangles, cells * edge_mm)) == pytest.approx(ERROR[s, h])
    between = np.log(prices.factor(round(np.sqrt(1000 * 10_000)), 4.0 * np.sqrt(0.1 * 0.3)))
    assert between == pytest.approx(0.075, abs=1e-4)
    assert np.log(prices.factor(1_000_000, 1e-3)) == pytest.approx(0.2)  # flat beyond the ends
    assert NO_PRICES.factor(500, 0.7) == 1.0


def test_a_level_too_large_to_be_timed_with_all_cells_does_as_the_next() -> None:
    some = [timed(s, h) for s in range(2) for h in range(3)] + [timed(2, 1)]
    prices = level_prices(some, TRIANGLES, EDGE_MM)
    assert prices.error[2] == pytest.approx(ERROR[1] + ERROR[2, 1] - ERROR[1, 1])


def test_a_time_that_cannot_be_is_not_believed() -> None:
    prices = level_prices([TimedLevel(100, 4.0, 0.0, 1e4), TimedLevel(1000, 4.0, 1e9, 1e4)], TRIANGLES, EDGE_MM)
    assert 0.4 < prices.factor(100, 4.0) < 0.6 and 1.7 < prices.factor(1000, 1.2) < 2.1


def test_counted_costs_are_multiplied_and_interrupts_told_from_what_a_level_costs() -> None:
    cost = CostCoefficients(
        base_ns=1000, cell_ns=0, triangle_ns=0, test_ns=10, iteration_ns=0, ball_ns=0, mapping_cell_ns=0
    )
    station = load_station(shipped_config("stations/desktop_1khz.toml"))
    rows = np.zeros(200, dtype=[(name, np.float64) for name in ("cost_ns", *COUNTERS)])
    rows["tests"] = 100.0
    rows["cost_ns"] = 3000.0
    factor = np.where(np.arange(200) < 100, 1.5, 1.0)
    costing = Costing(cost, station)
    assert costing.counted_ns(rows, 1000, 1, None, factor) == pytest.approx(2000.0 * factor)
    rows["cost_ns"] = 2000.0 * factor
    rows["cost_ns"][7] = 90_000.0
    told = costing.cost_ns(rows, 1000, 1, None, factor)
    assert told[8:] == pytest.approx(2000.0 * factor[8:]) and told[7] < 9000.0
