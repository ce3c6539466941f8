"""Derivatives at the surrogate's optimum, against optimising again with 5 % more and 5 % less."""

import jax
import numpy as np
import pytest
from surrogate_cases import made_measurement, made_space

from hapticlod.station import Station
from tuning.search import Limits, Search
from tuning.sensitivity import METRICS, UNBOUND, Optimum, moving, sensitivities, sentence

SPACE = made_space()


def station(limits):
    return Station(
        name="desk", loop_hz=1000.0, budget_us=limits.budget_us, memory_mb=limits.memory_mb, stiffness_n_mm=1.0,
        max_force_n=10.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def search():
    with jax.enable_x64(True):
        return Search(made_measurement(), SPACE, 200.0)


def optimum(search, levels, limits, near=None):
    found = search.best(levels, limits, 0, near)
    for _ in range(2):
        found = search.best(levels, limits, 0, found.x)
    return found


# Where ladder curves bend, 5 % more and 5 % less differ: their mean is what a derivative can be held against.
@pytest.mark.parametrize(
    ("moved", "levels", "limits", "close"),
    [
        ("budget_us", 1, Limits(200.0, 100.0), 0.1),
        ("budget_us", 2, Limits(200.0, 100.0), 0.1),
        ("memory_mb", 1, Limits(300.0, 4.0), 0.03),
        ("memory_mb", 2, Limits(300.0, 4.0), 0.03),
    ],
)
def test_derivatives_are_those_of_optimising_again(search, moved, levels, limits, close):
    found = optimum(search, levels, limits)
    told = sensitivities(search, SPACE, Optimum(found.x, levels, limits), station(limits))
    assert told["reliable"] and told["residual"] < 0.01
    ends = []
    for factor in (0.95, 1.05):
        changed = {**vars(limits), moved: factor * getattr(limits, moved)}
        ends.append(optimum(search, levels, Limits(**changed), found.x))
    width = 0.1 * getattr(limits, moved)
    assert told[moved]["binds"]
    assert told[moved]["objective"] == pytest.approx((ends[1].objective - ends[0].objective) / width, rel=close)
    for name in ("felt_error_jnd", "memory_mb"):
        again = (ends[1].predicted[name] - ends[0].predicted[name]) / width
        assert told[moved][name] == pytest.approx(again, rel=2 * close), name
    other = next(name for name in ("budget_us", "memory_mb") if name != moved)
    assert not told[other]["binds"] and all(told[other][name] == 0.0 for name in ("objective", *METRICS))
    assert "more" in sentence(told, station(limits)) and "lower the felt error" in sentence(told, station(limits))


def test_a_search_that_did_not_reach_a_minimum_claims_nothing(search):
    limits = Limits(40.0, 100.0)  # less than anything costs
    found = search.best(2, limits, 0)
    told = sensitivities(search, SPACE, Optimum(found.x, 2, limits), station(limits))
    assert not told["reliable"] and told["budget_us"]["felt_error_jnd"] is None
    assert sentence(told, station(limits)) == ""


def test_the_full_scan_alone_is_held_back_by_nothing():
    assert UNBOUND["reliable"] and UNBOUND["budget_us"]["objective"] == 0.0
    assert "would not improve" in sentence(UNBOUND, station(Limits(200.0, 100.0)))


def test_coordinates_of_absent_levels_stay(search):
    assert moving(SPACE, 5).all()
    # One level: its triangles, balls and cells.
    assert np.flatnonzero(moving(SPACE, 1)).tolist() == [0, 5, 10]
    x = np.full(SPACE.size, 0.4)
    for levels in (1, 2):
        gradient, _, jacobian = search.slopes(SPACE.ordered(x, levels), levels, Limits(200.0, 100.0))
        assert not gradient[~moving(SPACE, levels)].any() and not jacobian[:, ~moving(SPACE, levels)].any()
