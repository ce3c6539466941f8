"""Where the ladder is measured: which rungs, which subsets of the tool's balls, which cell sizes, which ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hapticlod.ladder import Rung
from hapticlod.motion import Motion
from hapticlod.tool import Tool

# Cell sizes in mean edges: the ladder is replayed at one of them, the others are sampled.
CELL_EDGES = (1.5, 2.5, 4.0, 6.5, 10.0)
BASE_CELL = 2
# Subsets of a shaped tool's balls: each a quarter of the one before.
THINNING = 4.0
FEWEST_BALLS = 4
BIN_S = 0.008
BINS_PER_WINDOW = 4
BINS_PER_INSTANT = 4


@dataclass(frozen=True)
class Grid:
    """The points at which the ladder is replayed.

    Attributes:
        triangles: (R,) of the rungs, finest first.
        edge_mm: (R,) their mean edges.
        balls: (B,) sizes of the tool's subsets, all balls first.
        cell_edges: (H,) cell sizes in mean edges, increasing; `base_cell` is the one of the replays.
    """

    triangles: tuple[int, ...]
    edge_mm: tuple[float, ...]
    balls: tuple[int, ...]
    cell_edges: tuple[float, ...] = CELL_EDGES
    base_cell: int = BASE_CELL

    @property
    def shape(self) -> tuple[int, int]:
        """(R, B)."""
        return len(self.triangles), len(self.balls)

    def cell_mm(self, rung: int, cell: int | None = None) -> float:
        """Cell size of a rung; the replays' where no index into `cell_edges` is given."""
        return self.cell_edges[self.base_cell if cell is None else cell] * self.edge_mm[rung]


def make_grid(rungs: Sequence[Rung], tool: Tool) -> Grid:
    """All rungs that differ, and quarters of the tool's balls down to a few."""
    kept: list[Rung] = []
    for rung in rungs:
        if not kept or rung.triangles < kept[-1].triangles:
            kept.append(rung)
    balls, count = [tool.balls], tool.balls / THINNING
    while count >= FEWEST_BALLS:
        balls.append(round(count))
        count /= THINNING
    return Grid(
        triangles=tuple(rung.triangles for rung in kept),
        edge_mm=tuple(float(rung.mean_edge_mm) for rung in kept),
        balls=tuple(balls),
    )


@dataclass(frozen=True)
class Clock:
    """How ticks fall into bins, windows and instants. Motions are cut to whole windows and laid end to end."""

    loop_hz: float
    motion_ticks: tuple[int, ...]
    ticks_per_bin: int
    bins_per_window: int = BINS_PER_WINDOW
    bins_per_instant: int = BINS_PER_INSTANT
    starts_tick: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        starts = np.concatenate([[0], np.cumsum(self.motion_ticks)])[:-1]
        object.__setattr__(self, "starts_tick", tuple(int(start) for start in starts))

    @property
    def ticks(self) -> int:
        """All ticks."""
        return sum(self.motion_ticks)

    @property
    def bins(self) -> int:
        """All bins."""
        return self.ticks // self.ticks_per_bin

    @property
    def ticks_per_instant(self) -> int:
        """An instant stands for so many ticks; it lies at the last of them."""
        return self.ticks_per_bin * self.bins_per_instant

    def marks(self, per: int) -> NDArray[np.bool_]:
        """True at the first of the groups of `per` ticks that begin a motion."""
        out = np.zeros(self.ticks // per, dtype=bool)
        out[np.array(self.starts_tick) // per] = True
        return out

    def binned(self, values: NDArray) -> NDArray:
        """(..., T) -> (..., bins, ticks per bin)."""
        return values.reshape(*values.shape[:-1], -1, self.ticks_per_bin)

    def cut(self, motion: Motion, index: int) -> Motion:
        """Motion number `index` without the ticks that fill no window."""
        return motion.part(0.0, self.motion_ticks[index] / self.loop_hz)


def make_clock(motions: Sequence[Motion], most_s: float = math.inf, thinning: int = 1) -> Clock:
    """Bins of about 8 ms, at least one tick; of every motion at most so many seconds; every so-manieth instant only."""
    loop_hz = motions[0].loop_hz
    per_bin = max(1, round(BIN_S * loop_hz))
    instant = thinning * BINS_PER_INSTANT
    whole = per_bin * math.lcm(BINS_PER_WINDOW, instant)
    ticks = tuple(int(min(motion.ticks, most_s * loop_hz)) // whole * whole for motion in motions)
    return Clock(loop_hz=loop_hz, motion_ticks=ticks, ticks_per_bin=per_bin, bins_per_instant=instant)
