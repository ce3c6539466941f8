"""Replays of the ladder in the runtime: every rung with every subset of balls, and tours that switch between them.

A replay of one fixed level says what the level costs and feels like. It does not say what a switch does: two levels
that were replayed apart may hold the tool in different valleys, because an SCP remembers its history. So at every
instant a tour visits all levels from the same place, by the mapping that the station will use; its switch ticks also
say what a switch costs. Replays run in threads: the runtime releases the interpreter's lock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod import _runtime
from hapticlod.config import Level, LodConfig
from hapticlod.ladder import Rung
from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import Motion
from hapticlod.replay import runtime_level
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.grid import Clock, Grid

Array = NDArray[np.float64]
MOST_RUNTIME_LEVELS = 8


@dataclass(frozen=True)
class Bench:
    """What every replay of one tuning run shares."""

    rungs: Sequence[Rung]
    origin_mm: Array
    tool: Tool
    station: Station
    grid: Grid

    def level(self, rung: int, cell: int | None = None) -> Any:
        """A rung as a level of the runtime."""
        return runtime_level(self.rungs[rung], self.origin_mm, self.grid.cell_mm(rung, cell))

    def fixed(self, rung: int, balls: int, cell: int | None = None) -> LodConfig:
        """The configuration that stays on one rung."""
        level = Level(triangles=self.grid.triangles[rung], cell_mm=self.grid.cell_mm(rung, cell), balls=balls)
        return LodConfig(levels=(level,))

    def renderer(self, levels: list[Any], scalar: Any) -> Any:
        """A renderer of these levels; `scalar` is a CONFIG_DTYPE scalar."""
        return _runtime.Renderer(levels, scalar.tobytes(), self.tool.rows)


def run(renderer: Any, motion: Motion, repeats: int, floors: NDArray[np.uint32] | None = None) -> NDArray:
    """(T,) rows of RECORD_DTYPE."""
    orientation = None if motion.orientation is None else np.ascontiguousarray(motion.orientation)
    position = np.ascontiguousarray(motion.position_mm)
    raw = renderer.replay(np.ascontiguousarray(motion.time_s), position, orientation, repeats, floors)
    return np.frombuffer(raw, dtype=RECORD_DTYPE)


def replay_fixed(
    bench: Bench, level: Any, rung: int, balls: int, motions: Sequence[Motion], repeats: int, cell: int | None = None
) -> list[NDArray]:
    """Rows of one rung with one subset, one array per motion."""
    scalar = bench.fixed(rung, balls, cell).to_runtime(bench.station, bench.tool, bench.origin_mm)
    renderer = bench.renderer([level], scalar)
    return [run(renderer, motion, repeats) for motion in motions]


@dataclass(frozen=True)
class Tour:
    """What switching at every instant gave.

    Attributes:
        offset_n: (R, B, I, 3) stiffness times (SCP there - SCP of the finest level with all balls).
        rows: (R, B, I) of the tick that entered the level. Rung 0 with all balls: of the return to it.
        touching: (I,) whether the finest level was in contact.
    """

    offset_n: Array
    rows: NDArray
    touching: NDArray[np.bool_]


def tour_ladder(
    bench: Bench, levels: Sequence[Any], motions: Sequence[Motion], clock: Clock, l_mm: float, threads: int,
    done: Callable[[float], None],
) -> Tour:  # fmt: skip
    """Visits every rung and subset at every instant of the motions."""
    rungs, subsets = bench.grid.shape
    stops = [(r, b) for b in range(subsets) for r in range(rungs) if (r, b) != (0, 0)]
    size = MOST_RUNTIME_LEVELS - 1
    legs = [[(0, 0), *stops[i : i + size]] for i in range(0, len(stops), size)] or [[(0, 0)]]
    instants = clock.ticks // clock.ticks_per_instant
    offset = np.zeros((rungs, subsets, instants, 3))
    entered = np.zeros((rungs, subsets, instants), dtype=RECORD_DTYPE)
    touching = np.zeros(instants, dtype=bool)

    def go(leg: list[tuple[int, int]]) -> None:
        scalar = _tour_config(bench, leg, l_mm)
        renderer = bench.renderer([levels[r] for r, _ in leg], scalar)
        rows = np.concatenate([_tour(renderer, clock.cut(m, i), clock, len(leg)) for i, m in enumerate(motions)])
        base = rows["scp_mm"][:, 0]
        for stop, (r, b) in enumerate(leg):
            at = stop if stop else len(leg)  # the return closes the tour
            entered[r, b] = rows[:, at]
            if stop:
                offset[r, b] = bench.station.stiffness_n_mm * (rows["scp_mm"][:, stop] - base)
        if leg is legs[0]:
            touching[:] = rows["contact"][:, 0] == 1

    with ThreadPoolExecutor(threads) as pool:
        for count, _ in enumerate(pool.map(go, legs), 1):
            done(count / len(legs))
    return Tour(offset, entered, touching)


def _tour_config(bench: Bench, leg: list[tuple[int, int]], l_mm: float) -> Any:
    """Levels in the leg's order; only the floor moves between them."""
    plain = bench.station.adjusted(damping_n_s_mm=0.0, friction_static=0.0, friction_dynamic=0.0, max_slew_n_s=0.0)
    first = bench.fixed(0, bench.grid.balls[0]).changed(l_in_mm=l_mm, l_out_mm=l_mm)
    scalar = np.array(first.to_runtime(plain, bench.tool, bench.origin_mm))
    scalar["level_count"] = len(leg)
    for i, (r, b) in enumerate(leg):
        scalar["triangles"][i], scalar["cell_mm"][i] = bench.grid.triangles[r], bench.grid.cell_mm(r)
        scalar["balls"][i] = bench.grid.balls[b]
        if i:
            scalar["speeds_mm_s"][i - 1] = 1e9  # out of reach
    return scalar[()]


def _tour(renderer: Any, motion: Motion, clock: Clock, stops: int) -> NDArray:
    """(I, stops + 1) rows: at every instant all levels, then the first again. Between instants, one tick per bin."""
    per_bin, bins = clock.ticks_per_bin, clock.bins_per_instant
    ends = np.arange(per_bin - 1, motion.ticks, per_bin)
    visits = np.ones(len(ends), dtype=int)
    visits[bins - 1 :: bins] = stops + 1
    at = np.repeat(ends, visits)
    route = np.concatenate([np.arange(stops), [0]]).astype(np.uint32)
    approach = np.zeros(bins - 1, dtype=np.uint32)
    floors = np.tile(np.concatenate([approach, route]), len(ends) // bins)
    orientation = None if motion.orientation is None else motion.orientation[at]
    time_s = np.arange(len(at)) / motion.loop_hz
    crowded = Motion(time_s, motion.position_mm[at], orientation, motion.loop_hz, motion.name, {})
    rows = run(renderer, crowded, 1, floors)
    return rows.reshape(-1, bins + stops)[:, bins - 1 :]
