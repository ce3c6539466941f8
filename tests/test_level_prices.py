"""What prices get wrong by level and cell size: read from timed levels, and taken into account wherever costs are."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import Motion
from hapticlod.shipped import shipped_config
from hapticlod.station import CostCoefficients, load_station
from tuning import timing
from tuning.costing import Costing
from tuning.grid import Grid
from tuning.level_prices import NO_PRICES, TimedLevel, level_prices
from tuning.replays import COUNTERS
from tuning.timing import prices_of_levels, time_ticks

STATION = load_station(shipped_config("stations/desktop_1khz.toml"))

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
    rows = np.zeros(200, dtype=[(name, np.float64) for name in ("cost_ns", *COUNTERS)])
    rows["tests"] = 100.0
    rows["cost_ns"] = 3000.0
    factor = np.where(np.arange(200) < 100, 1.5, 1.0)
    costing = Costing(cost, STATION)
    assert costing.counted_ns(rows, 1000, 1, None, factor) == pytest.approx(2000.0 * factor)
    rows["cost_ns"] = 2000.0 * factor
    rows["cost_ns"][7] = 90_000.0
    told = costing.cost_ns(rows, 1000, 1, None, factor)
    assert told[8:] == pytest.approx(2000.0 * factor[8:]) and told[7] < 9000.0


def test_ticks_are_timed_several_times_and_the_least_time_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passes are 1, 0.5 and 2 times as slow as what was counted says; every pass counts the same."""
    speed = iter(np.repeat([1.0, 0.5, 2.0], 6))
    motion = Motion(np.arange(400) / 1000.0, np.zeros((400, 3)), None, 1000.0, "still", {})
    rows = np.zeros(400, dtype=RECORD_DTYPE)
    rows["tests"] = 1 + np.arange(400) % 7

    def replayed(bench: Any, level: Any, rung: int, balls: int, motions: Any, repeats: int, cell: int) -> list[Any]:
        slow, made = next(speed), []
        for each in motions:
            part = rows[: each.ticks].copy()
            part["cost_ns"] = np.round(100.0 * slow * part["tests"] * (1 + rung) * (1.5 if cell else 1.0))
            made.append(part)
        return made

    monkeypatch.setattr(timing, "replay_fixed", replayed)
    monkeypatch.setattr(timing, "_TIMED_S", 0.0)
    level: Any = SimpleNamespace(bytes=1000)
    grid = Grid((1000, 100), (0.3, 1.0), (8, 2), cell_edges=(1.5, 4.0), base_cell=1)
    bench: Any = SimpleNamespace(grid=grid, level=lambda rung, cell: level)
    places, timed = time_ticks(bench, [level, level], (0, 1), [motion], [rows])
    assert places == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert [balls for _, _, balls in timed] == [8, 8, 8, 8, 2, 2]
    for (r, h), (made, size, _) in zip(places, timed, strict=False):
        assert size == 1000 and len(made) == 2 * timing.TIMED_TICKS
        assert made["cost_ns"] == pytest.approx(50.0 * made["tests"] * (1 + r) * (1.5 if h else 1.0))
    cost = CostCoefficients(
        base_ns=0, cell_ns=0, triangle_ns=0, test_ns=100, iteration_ns=0, ball_ns=0, mapping_cell_ns=0
    )
    prices = prices_of_levels(grid, places, timed, Costing(cost, STATION))
    assert prices.factor(1000, 1.5 * 0.3) == pytest.approx(0.5, rel=0.02)
    assert prices.factor(100, 4.0) == pytest.approx(1.5, rel=0.02)
