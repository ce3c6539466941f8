"""Replays of the ladder in the runtime: every rung with every subset of balls, and tours that switch between them.

A replay of one fixed level says what the level costs and feels like. It does not say what a switch does: two levels
that were replayed apart may hold the tool in different valleys, because an SCP remembers its history. So at every
instant a tour visits all levels from the same place, by the mapping that the station will use. What a switch costs is
another matter: `tuning.relay`. Replays run in threads: the runtime releases the interpreter's lock.
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
COUNTERS = ("cells", "triangles", "tests", "iterations", "balls", "mapping_cells")
# How far below the contact the HIP is at most when a tour enters a level, as a share of the tour's mapping length: a
# surface that lies deeper than this is not seen.
_PRESSED_SHARE = 0.5


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

    def renderer(self, levels: list[Any], scalar: Any, material_friction: bool = True) -> Any:
        """A renderer of these levels; `scalar` is a CONFIG_DTYPE scalar. The friction of materials can be left out."""
        return _runtime.Renderer(levels, scalar.tobytes(), self.tool.rows, material_friction)

    @property
    def has_materials(self) -> bool:
        """Whether the scan has any."""
        return self.rungs[0].materials is not None


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
    scalar = bench.fixed(rung, balls, cell).to_runtime(bench.station, bench.tool, bench.origin_mm, cut_short=False)
    renderer = bench.renderer([level], scalar)
    return [run(renderer, motion, repeats) for motion in motions]


@dataclass(frozen=True)
class Tour:
    """What switching at every instant gave.

    Attributes:
        offset_n: (R, B, I, 3) stiffness times (SCP there - SCP of the finest level with all balls); where the scan has
            materials, the difference of the forces.
        gap_mm: (R, B, I) how far the level's surface lies outward of the finest level's where that is touched, along
            the force: what a mapping has to bridge. The SCP may slide much further once it has arrived.
        held: (R, B, I) whether the level was in contact, the hand being where it was.
    """

    offset_n: Array
    gap_mm: Array
    held: NDArray[np.bool_]

    @property
    def touching(self) -> NDArray[np.bool_]:
        """(I,) whether the finest level was in contact."""
        return self.held[0, 0]


def tour_ladder(
    bench: Bench, levels: Sequence[Any], motions: Sequence[Motion], finest: Sequence[NDArray], clock: Clock,
    l_mm: float, threads: int, done: Callable[[float], None],
) -> Tour:  # fmt: skip
    """Visits every rung and subset at every instant of the motions.

    Args:
        levels: of all rungs.
        motions: cut to the clock.
        finest: rows of the finest level with all balls over these motions.
        l_mm: mapping length of the tour.
        threads: replays at once.
        done: told the share that is done.
    """
    rungs, subsets = bench.grid.shape
    stops = [(r, b) for b in range(subsets) for r in range(rungs) if (r, b) != (0, 0)]
    size = MOST_RUNTIME_LEVELS - 1
    legs = [[(0, 0), *stops[i : i + size]] for i in range(0, len(stops), size)] or [[(0, 0)]]
    instants = clock.ticks // clock.ticks_per_instant
    offset = np.zeros((rungs, subsets, instants, 3))
    gap = np.zeros((rungs, subsets, instants))
    held = np.zeros((rungs, subsets, instants), dtype=bool)
    plain = bench.station.adjusted(damping_n_s_mm=0.0, friction_static=0.0, friction_dynamic=0.0, max_slew_n_s=0.0)
    routes = [_Route(m, rows, clock, _PRESSED_SHARE * l_mm) for m, rows in zip(motions, finest, strict=True)]

    def go(leg: list[tuple[int, int]]) -> None:
        scalar = np.array(unreached_levels(bench, plain, leg, l_mm))
        if bench.has_materials:
            scalar["max_force_n"] = scalar["engage_s"] = 0.0  # forces are compared: none may be limited
        renderer = bench.renderer([levels[r] for r, _ in leg], scalar, material_friction=False)
        rows = np.concatenate([route.replayed(renderer, len(leg)) for route in routes])
        base, contact = rows["scp_mm"][:, 0], rows["contact"][:, 0] == 1
        out = base - rows["hip_mm"][:, 0]
        normal = out / np.maximum(np.linalg.norm(out, axis=1), 1e-12)[:, None]
        for stop, (r, b) in enumerate(leg):
            at = 2 * stop - 1 if stop else 2 * len(leg) - 1  # the return closes the tour
            pressed, slid = rows[:, at], rows[:, at + 1]
            held[r, b] = slid["contact"] == 1 if stop else contact
            if stop:
                offset[r, b] = (
                    slid["force_n"] - rows["force_n"][:, 0]
                    if bench.has_materials
                    else bench.station.stiffness_n_mm * (slid["scp_mm"] - base)
                )
                gap[r, b] = np.einsum("ij,ij->i", pressed["scp_mm"] - base, normal) * contact

    with ThreadPoolExecutor(threads) as pool:
        for count, _ in enumerate(pool.map(go, legs), 1):
            done(count / len(legs))
    return Tour(offset, gap, held)


def unreached_levels(
    bench: Bench, station: Station, leg: Sequence[tuple[int, int]], l_mm: float, blend_ms: float = 0.0
) -> Any:
    """CONFIG_DTYPE scalar of levels in the leg's order; no speed reaches a threshold: only the floor moves."""
    first = bench.fixed(0, bench.grid.balls[0]).changed(l_in_mm=l_mm, l_out_mm=l_mm, blend_ms=blend_ms)
    scalar = np.array(first.to_runtime(station, bench.tool, bench.origin_mm, cut_short=False))
    scalar["level_count"] = len(leg)
    for i, (r, b) in enumerate(leg):
        scalar["triangles"][i], scalar["cell_mm"][i] = bench.grid.triangles[r], bench.grid.cell_mm(r)
        scalar["balls"][i] = bench.grid.balls[b]
        if i:
            scalar["speeds_mm_s"][i - 1] = 1e9
    return scalar[()]


class _Route:
    """One motion with a tour at every instant; between instants, one tick per bin.

    A level is entered with the HIP drawn back to just below the finest level's contact, so that the SCP stays where
    the mapping puts it; one tick later the HIP is where the hand has it, and the SCP slides.
    """

    def __init__(self, motion: Motion, finest: NDArray, clock: Clock, pressed_mm: float) -> None:
        self._motion, self._clock = motion, clock
        depth = finest["scp_mm"] - finest["hip_mm"]
        length = np.linalg.norm(depth, axis=1, keepdims=True)
        back = np.maximum(length - pressed_mm, 0.0) / np.maximum(length, 1e-12)
        self._pressed = motion.position_mm + back * depth

    def replayed(self, renderer: Any, stops: int) -> NDArray:
        """(I, 1 + 2 stops) rows: the first level; pressed and slid for every other; pressed and slid for the first."""
        per_bin, bins = self._clock.ticks_per_bin, self._clock.bins_per_instant
        ends = np.arange(per_bin - 1, self._motion.ticks, per_bin)
        visits = np.ones(len(ends), dtype=int)
        visits[bins - 1 :: bins] = 1 + 2 * stops
        at = np.repeat(ends, visits)
        route = np.concatenate([[0], np.repeat(np.arange(1, stops), 2), [0, 0]])
        floors = np.tile(np.concatenate([np.zeros(bins - 1), route]), len(ends) // bins).astype(np.uint32)
        drawn = np.tile(np.concatenate([np.zeros(bins), np.tile([1, 0], stops)]), len(ends) // bins).astype(bool)
        position = np.where(drawn[:, None], self._pressed[at], self._motion.position_mm[at])
        orientation = None if self._motion.orientation is None else self._motion.orientation[at]
        time_s = np.arange(len(at)) / self._motion.loop_hz
        crowded = Motion(time_s, position, orientation, self._motion.loop_hz, self._motion.name, {})
        return run(renderer, crowded, 1, floors).reshape(-1, bins + 2 * stops)[:, bins - 1 :]
