"""Points with a level more: what they share with the point they come from, and what is split."""

import numpy as np
import pytest
from surrogate_cases import made_space

from tuning.split import FEWEST, FIRST, LATER, splits

SPACE = made_space()
K = SPACE.most_levels


def some_point(levels: int) -> np.ndarray:
    return SPACE.sample(1, levels, seed=levels)[0]


def speeds(x: np.ndarray, levels: int) -> np.ndarray:
    return x[3 * K : 3 * K + levels - 1]


@pytest.mark.parametrize("levels", range(1, K))
def test_keeps_the_order(levels: int) -> None:
    rows, limits = SPACE.order_rows(levels + 1)
    points = splits(SPACE, some_point(levels), levels)
    assert len(points) == (2 * FIRST if levels == 1 else levels * max(LATER // levels, FEWEST))
    for point in points:
        assert (rows @ point <= limits + 1e-9).all()
        assert ((point >= 0.0) & (point <= 1.0)).all()


@pytest.mark.parametrize("levels", range(2, K))
def test_every_level_is_split_at_a_speed_of_its_own(levels: int) -> None:
    """Of the speeds one is new, between those that bounded its level; the others are those from before."""
    x = np.full(SPACE.size, 0.5)
    x[3 * K : 3 * K + levels - 1] = np.arange(1, levels) / levels
    x = SPACE.ordered(x, levels)
    before, found = speeds(x, levels), []
    for point in splits(SPACE, x, levels):
        after = speeds(point, levels + 1)
        new = [speed for speed in after if np.abs(before - speed).min() > 1e-9]
        assert len(new) == 1
        assert np.isin(before.round(9), after.round(9)).all()
        found.append(int(np.searchsorted(before, new[0])))
    assert set(found) == set(range(levels))


def test_one_level_becomes_a_dearer_slow_and_a_coarser_fast_one() -> None:
    x = SPACE.ordered(np.full(SPACE.size, 0.5), 1)
    for point in splits(SPACE, x, 1):
        slow, fast = SPACE.config(point, 2).levels
        assert slow.triangles == SPACE.config(x, 1).levels[0].triangles
        assert fast.triangles < slow.triangles
        assert fast.balls < SPACE.config(x, 1).levels[0].balls < slow.balls
        assert point[2 * K] == point[2 * K + 1] == x[2 * K]


def test_what_is_given_stays_as_it_was() -> None:
    x = some_point(2)
    kept = x.copy()
    splits(SPACE, x, 2)
    np.testing.assert_array_equal(x, kept)
