"""Starts with a level more: a level of a good end is split in two at some speed of the hand.

Of points drawn all over the box hardly any has a switch that pays: its levels, speeds and blend must fit each other;
most end as one level. From the best with a level less it is a short way: the half for the slower hand becomes dearer,
the one for the faster hand coarser, and where that pays the search goes on downhill.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tuning.space import Space

# Speeds to split at: of one level; of more, over all levels, and of each at least so many. The first split decides the
# most, and what a split promises says little of where a search from it ends: all of them are searched from.
FIRST, LATER, FEWEST = 24, 8, 2
# In coordinates: how many more balls the slower half gets; how much coarser the faster one is, and how many balls less.
_APART = ((0.1, 0.1, 0.05), (0.15, 0.3, 0.1))
# One level has no switch: hysteresis, filter, blend, L in and out of its end mean nothing, and switching begins here.
_SWITCHING = (0.5, 0.3, 0.3, 0.5, 0.5)


def splits(space: Space, x: NDArray[np.float64], levels: int) -> list[NDArray[np.float64]]:
    """Points with one level more than x, of `levels` levels.

    Of one level both of `_APART` at each speed, of more levels in turn one and the other.
    """
    k = space.most_levels
    speeds = x[3 * k : 3 * k + levels - 1]
    each = FIRST if levels == 1 else max(LATER // levels, FEWEST)
    points = []
    for level, (slow, fast) in enumerate(pairwise([0.0, *speeds, 1.0])):
        for i in range(each):
            speed = slow + (fast - slow) * (i + 1) / (each + 1)
            for way in range(len(_APART)) if levels == 1 else [(i + level) % len(_APART)]:
                points.append(_split(space, x, levels, level, speed, way))
    return points


def _split(
    space: Space, x: NDArray[np.float64], levels: int, level: int, speed: float, way: int
) -> NDArray[np.float64]:
    k, point = space.most_levels, np.array(x, dtype=np.float64)
    more_balls, coarser, fewer_balls = _APART[way]
    for start, slow, fast in ((0, 0.0, -coarser), (k, more_balls, -fewer_balls), (2 * k, 0.0, 0.0)):
        own = np.insert(x[start : start + levels], level + 1, x[start + level])
        own[level : level + 2] += slow, fast
        point[start : start + levels + 1] = own
    point[3 * k : 3 * k + levels] = np.sort(np.append(x[3 * k : 3 * k + levels - 1], speed))
    if levels == 1:
        point[4 * k - 1 :] = _SWITCHING
    return space.ordered(point, levels + 1)
