"""Searches that begin at a given point, where what was found before is out of reach or nearly right."""

import jax
import numpy as np
import pytest
from surrogate_cases import few_starts, made_measurement, made_space

from tuning.search import Found, Limits, Search

SPACE = made_space()
CELL = 2 * SPACE.most_levels  # the first level's, among the coordinates


@pytest.fixture(scope="module")
def search():
    with pytest.MonkeyPatch.context() as patch, jax.enable_x64(True):
        few_starts(patch)
        yield Search(made_measurement(perfect=True), SPACE, 200.0)


def full_scan(search: Search, cell: float) -> Found:
    """Of one level, with cells of this size."""
    whole = np.ones(SPACE.size)
    whole[CELL : CELL + SPACE.most_levels] = cell
    return search.look(SPACE.ordered(whole, 1), 1, Limits(1e4, 100.0))


@pytest.mark.parametrize("share", [0.5, 0.7, 0.85])
def test_a_search_leaves_the_full_scan_when_the_budget_takes_it_away(search: Search, share: float) -> None:
    """Felt error grows like a root from it: its slope there, without a bound, must not outweigh the limit."""
    budget_us = share * full_scan(search, 1.0).predicted["loop_cost_p999_us"]
    anew = search.best(1, Limits(budget_us, 100.0), 0)
    full = full_scan(search, anew.x[CELL])  # cells have basins of their own
    assert full.predicted["felt_error_jnd"] < 1e-6 and full.predicted["loop_cost_p999_us"] > budget_us
    beside = search.best(1, Limits(budget_us, 100.0), 0, full.x)
    assert max(anew.excess, beside.excess) <= 0.0
    assert beside.objective <= 1.01 * anew.objective
    # And on from there with a little more: what that gains is kept, though it is little.
    for more in (1.001, 1.01, 1.05):
        limits = Limits(more * budget_us, 100.0)
        again = search.best(1, limits, 0, beside.x)
        assert again.objective < beside.objective - 1e-5
        assert again.objective <= 1.01 * search.best(1, limits, 0).objective
