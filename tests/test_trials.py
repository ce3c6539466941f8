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


def found(predicted_us: float, objective: float, memory_mb: float = 10.0) -> Found:
    metrics = {"loop_cost_p999_us": predicted_us, "memory_mb": memory_mb}
    return Found(np.array([predicted_us]), objective, 0.0, metrics)


def measured(predicted_us: float, cost_us: float, objective: float = 1.0) -> Candidate:
    """Predicted to be of objective 1."""
    config = LodConfig(levels=(Level(triangles=1000, cell_mm=1.0, balls=1),))
    point = found(predicted_us, 1.0)
    metrics = {"loop_cost_p999_us": cost_us}
    return Candidate(config, point.predicted, metrics, objective, cost_us <= BUDGET_US, found=point)


def trial(best: Any, like: Sequence[Any], proposals: list[Found]) -> tuple[Found, float] | None:
    search: Any = SimpleNamespace(glances=lambda points, levels, limits: proposals)
    space: Any = SimpleNamespace(around=lambda x, levels, count, random: [])
    return next_trial(best, like, 1, search, space, station(), np.random.default_rng(0))


def test_errors_of_cost_are_those_of_what_was_predicted_to_cost_alike() -> None:
    """A fifth too little at 60 us, a third at 90."""
    like = [measured(60.0, 72.0), measured(61.0, 73.2), measured(90.0, 120.0), measured(91.0, 121.3)]
    error = CostError(like)
    assert error.mean(60.0) == pytest.approx(np.log(1.2), abs=0.01)
    assert error.mean(90.0) == pytest.approx(np.log(4 / 3), abs=0.01)
    assert error.mean(1e4) == pytest.approx(np.log(4 / 3), abs=0.01)
    assert 0.015 < error.spread < 0.03
    assert CostError([measured(60.0, 66.0)]).spread == pytest.approx(0.04)
    assert CostError([measured(60.0, 60.0), measured(60.0, 120.0)]).spread > 0.3


def test_the_gain_is_weighed_by_the_chance_that_the_budget_holds() -> None:
    best = measured(80.0, 90.0)
    safe, bold, mad = found(82.0, 0.95), found(88.9, 0.93), found(120.0, 0.5)
    chosen = trial(best, [best], [safe, bold, mad])
    assert chosen is not None and chosen[0] is safe
    assert chosen[1] == pytest.approx(82.0 * 90.0 / 80.0)
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
