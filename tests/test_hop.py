"""Hops on functions whose least value is known."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from tuning.hop import MOST_BATCHES, PATIENCE, SHAKES, hop

DIMENSIONS = 6


@dataclass(frozen=True)
class Point:
    x: np.ndarray
    rank: tuple[bool, float]


def waves(x: np.ndarray) -> float:
    """Rastrigin's function on [0, 1]^n: 1 at 0.4, in basins 0.1 apart."""
    y = 10.0 * (np.asarray(x) - 0.4)
    return 1.0 + float(np.sum(y**2 + 3.0 * (1.0 - np.cos(2.0 * np.pi * y))))


def bowl(x: np.ndarray) -> float:
    return 1.0 + float(np.sum((np.asarray(x) - 0.4) ** 2))


class Hopping:
    """Searches downhill, as the caller of `hop` does, and counts."""

    def __init__(self, function, start: np.ndarray) -> None:
        self.function, self.batches, self.asked = function, 0, []
        self.ends: dict[int, Point] = {}
        self.search([(1, start), (2, start)])
        self.batches, self.asked = 0, []

    def search(self, hops) -> None:
        self.batches += 1
        for levels, x in hops:
            self.asked.append((levels, x))
            found = minimize(self.function, x, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(x))
            end = Point(found.x, (False, float(found.fun)))
            if levels not in self.ends or end.rank < self.ends[levels].rank:
                self.ends[levels] = end

    @property
    def best(self) -> float:
        return min(end.rank[1] for end in self.ends.values())


def test_finds_better_basins_than_as_many_more_starts() -> None:
    """Six seeds: hops end lower than the best of as many starts drawn anew, and far below where they began."""
    hopped, drawn, begun = [], [], []
    for seed in range(6):
        random = np.random.default_rng(seed)
        hopping = Hopping(waves, random.random(DIMENSIONS))
        begun.append(hopping.best)
        again = Hopping(waves, hopping.ends[1].x)
        hop(hopping.ends, hopping.search, seed)
        again.search([(1, x) for x in random.random((len(hopping.asked), DIMENSIONS))])
        hopped.append(hopping.best)
        drawn.append(again.best)
    assert np.mean(hopped) < 0.7 * np.mean(begun)
    assert np.mean(hopped) < np.mean(drawn)


def test_ends_soon_where_there_is_one_basin() -> None:
    hopping = Hopping(bowl, np.full(DIMENSIONS, 0.9))
    hop(hopping.ends, hopping.search, 0)
    assert hopping.batches == PATIENCE < MOST_BATCHES
    assert all(len(x) == DIMENSIONS and (x >= 0.0).all() and (x <= 1.0).all() for _, x in hopping.asked)
    assert len(hopping.asked) == PATIENCE * len(SHAKES)


def test_the_same_seed_hops_alike_and_never_loses() -> None:
    start = np.full(DIMENSIONS, 0.9)
    one, two = Hopping(waves, start), Hopping(waves, start)
    before = one.best
    hop(one.ends, one.search, 5)
    hop(two.ends, two.search, 5)
    assert one.best == two.best <= before
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(one.asked, two.asked, strict=True))


def test_one_level_count_alone_is_enough() -> None:
    hopping = Hopping(waves, np.full(DIMENSIONS, 0.9))
    del hopping.ends[2]
    hop(hopping.ends, hopping.search, 0)
    assert set(hopping.ends) == {1}
