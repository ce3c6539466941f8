"""Hops from basin to basin: the best ends are shaken and searched on from, and kept where that is better.

Monotonic basin hopping (Wales and Doye 1997; Leary 2000). Where an objective has many basins, a few hops from a good
one find better ones than as many more starts from afar; where it has one, hops soon show that and end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# The hops of a batch, searched at once: what share of the coordinates is shaken, and how far (normal, of [0, 1]).
SHAKES = ((0.3, 0.3), (0.3, 0.3), (0.5, 0.1), (0.5, 0.3))
_OTHER = 1  # the hop that also changes the number of levels
PATIENCE, MOST_BATCHES = 3, 12
GAIN = 3e-3  # of the objective: less is no reason to go on


class End(Protocol):
    """What a search ended at: a point of [0, 1]^n, and its rank: smaller is better, False (limits hold) first."""

    @property
    def x(self) -> NDArray[np.float64]: ...
    @property
    def rank(self) -> tuple[bool, float]: ...


Hops = Sequence[tuple[int, NDArray[np.float64]]]


def hop(ends: Mapping[int, End], search: Callable[[Hops], None], seed: int) -> None:
    """Hops until some batches in a row gained nothing.

    Args:
        ends: the best end of every level count. `search` puts better ones in their place.
        search: is given level counts and points to search from.
        seed: of the hops.
    """
    random = np.random.default_rng([seed, len(ends)])
    idle = 0
    for _ in range(MOST_BATCHES):
        order = sorted(ends, key=lambda levels: ends[levels].rank)
        before = ends[order[0]]
        hops = []
        for i, (share, width) in enumerate(SHAKES):
            levels = order[min(1, len(order) - 1)] if i + 1 == len(SHAKES) else order[0]
            x = ends[levels].x
            shaken = x + (random.random(len(x)) < share) * width * random.normal(size=len(x))
            hops.append((int(random.choice(order)) if i == _OTHER else levels, np.clip(shaken, 0.0, 1.0)))
        search(hops)
        best = min(end.rank for end in ends.values())
        idle = idle + 1 if best[0] == before.rank[0] and best[1] > (1.0 - GAIN) * before.rank[1] else 0
        if idle == PATIENCE:
            return
