"""What counters get wrong by the level: undisturbed times over counted costs, by a level's size and by its cells.

Counted things cost the same on every level only on average. What is looked at in small cells costs more than prices
fitted to all ticks say, what is looked at in large ones less: a fifth either way, more than other cells save. Where
sizes of cells and levels are searched, prices wrong in this way are what a search would find.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST = 0.7  # of |ln time / counted|: what is further off was not measured right


@dataclass(frozen=True)
class LevelPrices:
    """ln(time / counted) by ln triangles and ln cell size, linear in both and flat beyond their ends.

    Attributes:
        log_triangles: (S,) increasing. log_cells: (H,) ln of cell size in mean edges, increasing.
        error: (S, H).
        edge_log_triangles, edge_log_mm: ln mean edge, mm, against ln triangles, increasing in the first.
    """

    log_triangles: Array
    log_cells: Array
    error: Array
    edge_log_triangles: Array
    edge_log_mm: Array

    def factor(self, triangles: float, cell_mm: float) -> float:
        """What a cost counted on a level must be multiplied by."""
        size = np.log(triangles)
        cell = np.log(cell_mm) - np.interp(size, self.edge_log_triangles, self.edge_log_mm)
        of_size = [np.interp(size, self.log_triangles, column) for column in self.error.T]
        return float(np.exp(np.clip(np.interp(cell, self.log_cells, of_size), -_MOST, _MOST)))


_ONE = np.zeros(1)
NO_PRICES = LevelPrices(_ONE, _ONE, np.zeros((1, 1)), _ONE, _ONE)


@dataclass(frozen=True)
class TimedLevel:
    """One level of the ladder with one cell size: what its ticks took, undisturbed, and what was counted, ns."""

    triangles: int
    cell_edges: float
    time_ns: float
    counted_ns: float

    @property
    def error(self) -> float:
        """ln(time / counted)."""
        return float(np.log(max(self.time_ns, 1.0) / max(self.counted_ns, 1.0)))


def level_prices(timed: Sequence[TimedLevel], triangles: Sequence[int], edge_mm: Sequence[float]) -> LevelPrices:
    """From timed levels; a cell size that was not timed of one of them does to it what it does to the next coarser.

    Args:
        timed: at least one; of the coarsest, all cell sizes.
        triangles, edge_mm: of all rungs, finest first.
    """
    order = np.argsort(triangles)
    sizes = sorted({level.triangles for level in timed})
    cells = sorted({level.cell_edges for level in timed})
    known = {(level.triangles, level.cell_edges): level.error for level in timed}
    error = np.zeros((len(sizes), len(cells)))
    for s, size in enumerate(sizes):
        here = [h for h, cell in enumerate(cells) if (size, cell) in known]
        shift = np.mean([known[size, cells[h]] - error[s - 1, h] for h in here]) if s else 0.0
        error[s] = [known.get((size, cell), error[s - 1, h] + shift) for h, cell in enumerate(cells)]
    return LevelPrices(
        log_triangles=np.log(sizes),
        log_cells=np.log(cells),
        error=error,
        edge_log_triangles=np.log(np.array(triangles, dtype=np.float64))[order],
        edge_log_mm=np.log(np.array(edge_mm))[order],
    )
