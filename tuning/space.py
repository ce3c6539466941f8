"""The box that is searched: LodConfig <-> Parameters <-> x in [0, 1]^n, with the order of levels as linear rows.

Every coordinate is a logarithm scaled to its bounds, so that steps are relative and about equally large. Order is not
hidden in a transformation: triangles and balls must fall and speeds rise from level to level by linear inequalities
that the optimiser keeps exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from hapticlod.config import Level, LodConfig
from hapticlod.surrogate.parameters import Parameters

MOST_LEVELS = 5
Bounds = tuple[float, float]
# Of points about another: by what ln factor all levels and each level's cells change, and what share of all other
# coordinates by how much of [0, 1]; normal.
_RESIZED, _RECELLED, _SHAKEN, _SHAKE = 0.08, 0.25, 0.3, 0.03


def split(log, most_levels: int) -> dict[str, Any]:
    """Coordinates (n,) by name: triangles, balls, cells (K each), speeds (K - 1), and five scalars of shape (1,)."""
    sizes = {"triangles": most_levels, "balls": most_levels, "cells": most_levels, "speeds": most_levels - 1}
    sizes |= dict.fromkeys(("hysteresis", "filter", "blend", "l_in", "l_out"), 1)
    out, at = {}, 0
    for name, size in sizes.items():
        out[name] = log[at : at + size]
        at += size
    return out


def decode(log: Float[Array, " n"], levels, most_levels: int = MOST_LEVELS) -> Parameters:
    """Parameters from the logarithms of all coordinates. Differentiable; `levels` is an integer scalar."""
    part = split(log, most_levels)
    return Parameters(
        levels=jnp.asarray(levels),
        log_triangles=part["triangles"],
        log_balls=part["balls"],
        log_cell_edges=part["cells"],
        log_speeds=part["speeds"],
        hysteresis=jnp.exp(part["hysteresis"][0]),
        filter_hz=jnp.exp(part["filter"][0]),
        blend_s=jnp.exp(part["blend"][0]) * 1e-3,
        log_l_in=part["l_in"][0],
        log_l_out=part["l_out"][0],
    )


@dataclass(frozen=True)
class Space:
    """Bounds of every lever. Levels' order is finest first.

    Attributes:
        triangles: fewest and most triangles of a level.
        balls: fewest and most balls of the tool; equal where there is nothing to choose.
        edge_log_triangles, edge_log_mm: ln mean edge (mm) against ln triangles, increasing in the first: cells are
            bounded relative to the edge.
        cell_edges: cell size in mean edges.
        speeds_mm_s: switching speeds.
        l_mm: each side's mapping length.
        hysteresis, filter_hz, blend_ms: as in LodConfig.
        triangle_ratio, speed_ratio: least ratio between neighbours.
        dwell_ms: least time between switches; not searched. Hysteresis and filter keep levels from chattering.
    """

    triangles: Bounds
    balls: Bounds
    edge_log_triangles: NDArray[np.float64] = field(repr=False)
    edge_log_mm: NDArray[np.float64] = field(repr=False)
    speeds_mm_s: Bounds
    l_mm: Bounds
    cell_edges: Bounds = (1.5, 12.0)
    hysteresis: Bounds = (0.03, 0.4)
    filter_hz: Bounds = (3.0, 60.0)
    blend_ms: Bounds = (1.0, 120.0)
    triangle_ratio: float = 1.25
    speed_ratio: float = 1.25
    dwell_ms: float = 0.0
    most_levels: int = MOST_LEVELS

    @property
    def size(self) -> int:
        """Number of coordinates, n = 4 K + 4."""
        return 4 * self.most_levels + 4

    def _blocks(self) -> list[tuple[str, int, Bounds]]:
        k = self.most_levels
        return [
            ("triangles", k, self.triangles),
            ("balls", k, self.balls),
            ("cells", k, self.cell_edges),
            ("speeds", k - 1, self.speeds_mm_s),
            ("hysteresis", 1, self.hysteresis),
            ("filter", 1, self.filter_hz),
            ("blend", 1, self.blend_ms),
            ("l_in", 1, self.l_mm),
            ("l_out", 1, self.l_mm),
        ]

    @property
    def log_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) ln of the lower and of the upper bound of every coordinate."""
        low = np.concatenate([np.full(count, np.log(bounds[0])) for _, count, bounds in self._blocks()])
        high = np.concatenate([np.full(count, np.log(bounds[1])) for _, count, bounds in self._blocks()])
        return low, high

    def _split(self, x: NDArray) -> dict[str, NDArray]:
        """Logarithms of every block's physical values."""
        low, high = self.log_bounds
        return split(low + np.asarray(x, dtype=np.float64) * (high - low), self.most_levels)

    def log_levels(self, x: NDArray, levels: int) -> NDArray:
        """(3, levels) ln triangles, balls and cells of the levels that are used."""
        part = self._split(x)
        return np.array([part[name][:levels] for name in ("triangles", "balls", "cells")])

    def order_rows(self, levels: int) -> tuple[NDArray, NDArray]:
        """(A, b) of A x <= b: triangles and balls fall, speeds rise. Rows of unused levels are 0 <= 1."""
        k, rows, limits = self.most_levels, [], []

        def fall(start: int, first: int, second: int, gap: float, used: bool) -> None:
            row = np.zeros(self.size)
            if used:
                row[start + first], row[start + second] = -1.0, 1.0
            rows.append(row)
            limits.append(-gap if used else 1.0)

        for i in range(k - 1):
            fall(0, i, i + 1, self._gap(self.triangles, self.triangle_ratio), i + 1 < levels)
            fall(k, i, i + 1, 0.0, i + 1 < levels)
        for i in range(k - 2):
            fall(3 * k, i + 1, i, self._gap(self.speeds_mm_s, self.speed_ratio), i + 2 < levels)
        return np.array(rows), np.array(limits)

    @staticmethod
    def _gap(bounds: Bounds, ratio: float) -> float:
        span = np.log(bounds[1] / bounds[0])
        return float(np.log(ratio) / span) if span > 0 else 0.0

    def fits(self, levels: int) -> bool:
        """Whether so many levels can be told apart between the bounds."""
        return (levels - 1) * self._gap(self.triangles, self.triangle_ratio) <= 1.0 and self.triangles[1] > (
            self.triangles[0] if levels > 1 else 0
        )

    def ordered(self, x: NDArray, levels: int) -> NDArray:
        """The nearest-in-spirit point that keeps the order: sorted, then spread to the least gaps."""
        x, k = np.clip(np.array(x, dtype=np.float64), 0.0, 1.0), self.most_levels

        def spread(values: NDArray, gap: float) -> NDArray:
            """Increasing values at least `gap` apart inside [0, 1]."""
            if len(values) > 1:
                gap = min(gap, 1.0 / (len(values) - 1)) * (1 + 1e-9)
            out = np.sort(values)
            for i in range(1, len(out)):
                out[i] = max(out[i], out[i - 1] + gap)
            limit = 1.0
            for i in range(len(out) - 1, -1, -1):
                out[i] = min(out[i], limit)
                limit = out[i] - gap
            return np.clip(out, 0.0, 1.0)

        x[:levels] = spread(x[:levels], self._gap(self.triangles, self.triangle_ratio))[::-1]
        x[k : k + levels] = np.sort(x[k : k + levels])[::-1]
        x[3 * k : 3 * k + levels - 1] = spread(
            x[3 * k : 3 * k + levels - 1], self._gap(self.speeds_mm_s, self.speed_ratio)
        )
        # Unused levels repeat the last one, so that equal configurations are equal points.
        for start, used in ((0, levels), (k, levels), (2 * k, levels), (3 * k, max(levels - 1, 1))):
            end = start + k - (1 if start == 3 * k else 0)
            x[start + used : end] = x[start + used - 1]
        return x

    def config(self, x: NDArray, levels: int, name: str = "") -> LodConfig:
        """The configuration at x: counts rounded, levels that come out alike merged."""
        log = self._split(x)
        edge = np.exp(np.interp(log["triangles"], self.edge_log_triangles, self.edge_log_mm))
        made: list[Level] = []
        speeds: list[float] = []
        for i in range(levels):
            triangles = round(float(np.exp(log["triangles"][i])))
            if made and triangles >= made[-1].triangles:
                continue
            level = Level(
                triangles=triangles,
                cell_mm=float(np.exp(log["cells"][i]) * edge[i]),
                balls=round(float(np.exp(log["balls"][i]))),
            )
            if made:
                speeds.append(float(np.exp(log["speeds"][i - 1])))
            made.append(level)
        scalar = {key: float(np.exp(log[key][0])) for key in ("hysteresis", "filter", "blend", "l_in", "l_out")}
        return LodConfig(
            name=name,
            levels=tuple(made),
            speeds_mm_s=tuple(speeds),
            hysteresis=scalar["hysteresis"],
            filter_hz=scalar["filter"],
            blend_ms=scalar["blend"],
            l_in_mm=scalar["l_in"],
            l_out_mm=scalar["l_out"],
            dwell_ms=self.dwell_ms,
            mapping="two-sided",
        )

    def point(self, config: LodConfig) -> NDArray:
        """x of a configuration, clipped to the bounds: the inverse of `config` for those inside."""
        k, used = self.most_levels, len(config.levels)
        if used > k:
            raise ValueError(f"{used} levels, the space has {k}")
        last = config.levels[-1]
        levels = list(config.levels) + [last] * (k - used)
        speeds = list(config.speeds_mm_s) + [(config.speeds_mm_s or (self.speeds_mm_s[0],))[-1]] * (k - used)
        log_triangles = np.log([level.triangles for level in levels])
        edge = np.exp(np.interp(log_triangles, self.edge_log_triangles, self.edge_log_mm))
        values = {
            "triangles": np.exp(log_triangles),
            "balls": [min(level.balls, self.balls[1]) for level in levels],
            "cells": [level.cell_mm / e for level, e in zip(levels, edge, strict=True)],
            "speeds": speeds[: k - 1],
            "hysteresis": [max(config.hysteresis, 1e-12)],
            "filter": [max(config.filter_hz, 1e-12)],
            "blend": [max(config.blend_ms, 1e-12)],
            "l_in": [max(config.l_in_mm, 1e-12)],
            "l_out": [max(config.l_out_mm, 1e-12)],
        }
        parts = []
        for name, _, (low, high) in self._blocks():
            span = np.log(high / low)
            log = np.log(np.asarray(values[name], dtype=np.float64) / low)
            parts.append(log / span if span > 0 else np.zeros(len(log)))
        return np.clip(np.concatenate(parts), 0.0, 1.0)

    def anchors(self, levels: int) -> NDArray:
        """(4, n) points at the ends of the ladder: coarsest and finest levels and tools, small cells and large."""
        points = np.tile(np.array([0.3, 0.6, 0.3, 0.6])[:, None], self.size)
        points[:, : 2 * self.most_levels] = np.array([0.0, 0.0, 1.0, 1.0])[:, None]
        return np.stack([self.ordered(point, levels) for point in points])

    def widened(self, x: NDArray, levels: int) -> NDArray:
        """x of so many levels with one more below, which only the fastest hand reaches."""
        wider = np.array(x, dtype=np.float64)
        wider[3 * self.most_levels + levels - 1 :][: self.most_levels - levels] = 1.0
        return self.ordered(wider, levels + 1)

    def around(self, x: NDArray, levels: int, count: int, random: np.random.Generator) -> list[NDArray]:
        """Points about x that keep the order: all levels larger or smaller by one factor, other cells, all else shaken.

        Cells by tenths: cost trembles most over them, and nothing of them is felt. Triangles by what a budget's
        last tenths buy.
        """
        low, high = self.log_bounds
        span, k = np.maximum(high - low, 1e-12), self.most_levels
        points = []
        for _ in range(count):
            step = np.where(random.random(self.size) < _SHAKEN, _SHAKE * random.normal(size=self.size), 0.0)
            step[:k] += _RESIZED * random.normal() / span[:k]
            step[2 * k : 3 * k] += _RECELLED * random.normal(size=k) / span[2 * k : 3 * k]
            points.append(self.ordered(np.asarray(x, dtype=np.float64) + step, levels))
        return points

    def sample(self, count: int, levels: int, seed: int) -> NDArray:
        """(count, n) Latin hypercube points that keep the order."""
        # The points of scipy.stats.qmc.LatinHypercube, which takes more than a second to import.
        random = np.random.default_rng(seed).spawn(1)[0]
        within = random.uniform(size=(count, self.size))
        strata = np.tile(np.arange(1, count + 1), (self.size, 1))
        for row in strata:
            random.shuffle(row)
        points = (strata.T - within) / count
        return np.stack([self.ordered(point, levels) for point in points])
