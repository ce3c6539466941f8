"""What is measured next near the best: what should gain most, by the surrogate and by what was measured."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hapticlod.config import Level, LodConfig
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from tuning.candidate import Candidate
from tuning.search import Found
from tuning.trials import CostError, next_trial

BUDGET_US = 100.0


def station() -> Station:
    return load_station(shipped_config("stations/desktop_1khz.toml")).adjusted(budget_us=BUDGET_US, memory_mb=50.0)


def found(predicted_us: float, objective: float, memory_mb: float = 10.0, triangles: float = 1000.0) -> Found:
    metrics = {"loop_cost_p999_us": predicted_us, "memory_mb": memory_mb}
    return Found(np.array([np.log(triangles), 0.0, 0.0]), objective, 0.0, metrics)


def measured(predicted_us: float, cost_us: float, objective: float = 1.0, triangles: float = 1000.0) -> Candidate:
    """Predicted to be of objective 1."""
    config = LodConfig(levels=(Level(triangles=round(triangles), cell_mm=1.0, balls=1),))
    point = found(predicted_us, 1.0, triangles=triangles)
    metrics = {"loop_cost_p999_us": cost_us}
    return Candidate(config, point.predicted, metrics, objective, cost_us <= BUDGET_US, found=point)


# A point is ln triangles, balls and cells of its one level.
SPACE: Any = SimpleNamespace(
    around=lambda x, levels, count, random: [], log_levels=lambda x, levels: np.asarray(x).reshape(3, 1)
)


def trial(best: Any, like: Sequence[Any], proposals: list[Found]) -> tuple[Found, float] | None:
    search: Any = SimpleNamespace(glances=lambda points, levels, limits: proposals)
    return next_trial(best, like, 1, search, SPACE, station(), np.random.default_rng(0))


def test_errors_of_cost_are_those_of_what_is_alike() -> None:
    """A fifth too little at 1000 triangles, a third at 8000; in between between them, and far away the usual one."""
    like = [measured(60.0, 72.0), measured(61.0, 73.2, triangles=1010.0), measured(90.0, 120.0, triangles=8000.0)]
    error = CostError(like, 1, SPACE)
    at = lambda triangles: error.expected(found(1.0, 1.0, triangles=triangles).x)
    assert at(1000.0)[0] == pytest.approx(np.log(1.2), abs=0.01)
    assert at(8000.0)[0] == pytest.approx(np.log(4 / 3), abs=0.01)
    assert at(1000.0)[0] < at(4000.0)[0] < at(8000.0)[0]
    assert at(1e6)[0] == pytest.approx(0.5 * np.log(1.2 * 4 / 3), abs=0.02)


def test_what_is_sure_of_a_cost_fades_with_distance() -> None:
    error = CostError([measured(60.0, 72.0)], 1, SPACE)
    spreads = [error.expected(found(1.0, 1.0, triangles=n).x)[1] for n in (1000.0, 1100.0, 2000.0, 1e6)]
    assert spreads == sorted(spreads)
    assert 0.01 < spreads[0] < 0.02
    # Two that vary by 5 %, each by itself.
    assert spreads[-1] == pytest.approx(np.sqrt(2) * 0.05, abs=0.005)
    unlike = [measured(60.0, 60.0), measured(60.0, 120.0, triangles=1e5)]
    assert CostError(unlike, 1, SPACE).expected(found(1.0, 1.0, triangles=1e8).x)[1] > 0.3


def test_next_to_what_cost_too_much_nothing_is_tried_again() -> None:
    """Either gains as much; beside the first, one of the same prediction has broken the budget."""
    best = measured(90.0, 95.0)
    beside, elsewhere = found(92.0, 0.8, triangles=1400.0), found(92.0, 0.8, triangles=700.0)
    unlike = trial(best, [best, measured(92.0, 106.0, triangles=1420.0)], [beside, elsewhere])
    assert unlike is not None and unlike[0] is elsewhere


def test_the_gain_is_weighed_by_the_chance_that_the_budget_holds() -> None:
    best = measured(80.0, 90.0)
    safe, bold, mad = found(82.0, 0.95), found(88.9, 0.93), found(120.0, 0.5)
    chosen = trial(best, [best], [safe, bold, mad])
    assert chosen is not None and chosen[0] is safe
    assert chosen[1] == pytest.approx(82.0 * 90.0 / 80.0, rel=0.01)
    better = found(88.9, 0.8)  # half a chance of four times the gain
    chosen = trial(best, [best], [safe, better, mad])
    assert chosen is not None and chosen[0] is better


def test_gains_are_scaled_by_how_the_best_was_mispredicted() -> None:
    """Predicted 1.0, measured 2.0: a proposal of 1.5 is better, one of 1.0 as predicted is not."""
    best = measured(80.0, 90.0, 2.0)
    assert trial(best, [best], [found(80.0, 1.0)]) is None
    chosen = trial(best, [best], [found(80.0, 1.0), found(80.0, 0.9)])
    assert chosen is not None and chosen[0].objective == 0.9


def test_nothing_is_tried_that_gains_nothing_or_cannot_hold() -> None:
    best = measured(80.0, 90.0)
    hopeless = [found(80.0, 1.0), found(80.0, 1.2), found(300.0, 0.1), found(80.0, 0.5, 60.0), found(80.0, np.nan)]
    assert trial(best, [best], hopeless) is None
    assert trial(replace(best, found=None), [], [found(80.0, 0.5)]) is None
