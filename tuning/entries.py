"""What it costs to enter a level: by the level, and by how fast the hand is meanwhile.

A tick that enters a level is among the dearest of a station, and the faster the hand, the dearer it is: the tool has
further to go on a surface that it does not know. Relays (`tuning.relay`) switch at all speeds of the hand, a
configuration at its switching speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.surrogate.cost import SWITCH_SHARES

Array = NDArray[np.float64]

_FEWEST_ENTRIES = 8
# Classes of speed, slowest first: shares of all entries, and how many entries make a class worth a price of its own.
_CLASSES = (0.2, 0.2, 0.2, 0.15, 0.15, 0.1)
_FEWEST_OF_CLASS = 30


@dataclass(frozen=True)
class Entered:
    """Ticks that entered a level.

    Attributes:
        rows: (n,) of RECORD_DTYPE.
        touched: (n,) whether they, or the ticks before, were in contact.
        speed_mm_s: (n,) of the hand.
    """

    rows: NDArray
    touched: NDArray[np.bool_]
    speed_mm_s: Array


def middles() -> Array:
    """(M,) ranks of what stands for each of `SWITCH_SHARES`."""
    edges = np.concatenate([[0.0], np.cumsum(SWITCH_SHARES)])
    return 0.5 * (edges[1:] + edges[:-1])


def entry_costs(cost: Array, touched: NDArray[np.bool_], ordinary: Array) -> tuple[Array, Array]:
    """Cost of ticks that enter a level, (M,) in contact and (M,) out of it, cheapest share first.

    Args:
        cost: (n,) of the ticks that entered it. touched: (n,) whether in contact.
        ordinary: of all its ticks: what stands in where nothing ever entered it.
    """
    every = cost if len(cost) else ordinary
    kinds = (cost[chosen] if chosen.sum() >= _FEWEST_ENTRIES else every for chosen in (touched, ~touched))
    in_contact, free = (np.quantile(kind, middles()) for kind in kinds)
    return in_contact, free


def entry_speeds(priced: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Speeds (C,) of the hand, mm/s, and ln factors (C, M) on what each share of entries in contact costs at them.

    Levels differ in what an entry costs; how much dearer a faster hand makes it is read from all of them together.

    Args:
        priced: costs (n,) and speeds (n,) of the entries in contact, level by level.
    """
    enough = [(np.log(cost / np.median(cost)), speed) for cost, speed in priced if len(cost) >= _FEWEST_ENTRIES]
    none = np.geomspace(1.0, 1e3, len(_CLASSES)), np.zeros((len(_CLASSES), len(SWITCH_SHARES)))
    if not enough:
        return none
    log_cost, speed = (np.concatenate(parts) for parts in zip(*enough, strict=True))
    speed = np.maximum(speed, 1e-3)
    order = np.argsort(speed, kind="stable")
    classes = np.split(order, np.round(np.cumsum(_CLASSES)[:-1] * len(order)).astype(int))
    if min(map(len, classes)) < _FEWEST_OF_CLASS:
        return none
    middle = np.array([np.median(speed[its]) for its in classes])
    if np.diff(np.log(middle)).min() < 1e-3:
        return none
    every = np.quantile(log_cost, middles())
    return middle, np.stack([np.quantile(log_cost[its], middles()) - every for its in classes])
