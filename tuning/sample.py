"""Samples a ladder in the runtime: replays, tours and cell sizes, and the cost coefficients that follow from them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.errors import InputError
from hapticlod.motion import Motion
from hapticlod.perception import Perception
from hapticlod.station import CostCoefficients, Station
from hapticlod.surrogate.cost import SWITCH_SHARES
from tuning.assemble import LadderData, cell_rungs, dearest_mean, entry_costs
from tuning.calibrate import (
    NO_CURVE,
    PriceCurve,
    calibrate,
    counted_cost_ns,
    price_curve,
    without_interrupts,
)
from tuning.grid import Clock
from tuning.level_fields import level_fields, make_reference
from tuning.relay import leaps, mean_step, relay_ladder
from tuning.replays import Bench, replay_fixed, tour_ladder

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

# Mapping lengths that switches are priced with, in the tour's.
_REACHES = (0.5, 4.0)
# Every so many rungs are timed with repeats, on so many ticks per motion: what tells counted cost from other programs.
_TIMED_RUNGS, _TIMED_TICKS, _TIMED_REPEATS = 4, 480, 3
# Ticks per motion on which other cell sizes are tried: usual ones, from its middle, and as many about its dearest ones,
# which make the tail. And those before them that put the tool in its place.
_CELL_TICKS, _SETTLING_TICKS = 240, 32


# Rows of one level, and its bytes and balls.
_Timed = tuple[NDArray, int, int]


def threads() -> int:
    """Replays that run at once."""
    return max(1, len(os.sched_getaffinity(0)))


@dataclass(frozen=True)
class Costing:
    """How this machine's time becomes the station's.

    `here` are this machine's coefficients, `curve` what they get wrong by the size of a tick, and `entering` the same
    of ticks that enter a level. A station with coefficients of its own is taken to do the same counted work at its own
    prices; what nobody counts is taken to cost in proportion. `slowdown` multiplies everything.
    """

    here: CostCoefficients
    station: Station
    curve: PriceCurve = NO_CURVE
    entering: PriceCurve = NO_CURVE

    def counted_ns(
        self, rows: NDArray, level_bytes: int | Array, level_balls: int | Array,
        enters: NDArray[np.bool_] | None = None,
    ) -> Array:  # fmt: skip
        """(T,) cost on the station by counters alone: the same whenever it is asked for.

        `enters`: (T,) which ticks enter a level; None: none does.
        """
        here = counted_cost_ns(rows, level_bytes, self.here, level_balls)
        cost = self.station.cost
        there = here if cost is None else counted_cost_ns(rows, level_bytes, cost, level_balls)
        return there * self._factor(here, enters) * self.station.slowdown

    def cost_ns(
        self, rows: NDArray, level_bytes: int | Array, level_balls: int | Array,
        enters: NDArray[np.bool_] | None = None,
    ) -> Array:  # fmt: skip
        """(T,) cost on the station by the clock, interrupts taken out. `enters`: as in `counted_ns`."""
        counted = counted_cost_ns(rows, level_bytes, self.here, level_balls)
        cost = without_interrupts(rows, counted * self._factor(counted, enters)) * self.station.slowdown
        if self.station.cost is None:
            return cost
        there = counted_cost_ns(rows, level_bytes, self.station.cost, level_balls)
        return cost * there / np.maximum(counted, 1.0)

    def _factor(self, counted_ns: Array, enters: NDArray[np.bool_] | None) -> Array:
        staying = self.curve.factor(counted_ns)
        return staying if enters is None else np.where(enters, self.entering.factor(counted_ns), staying)


def entered(rows: NDArray) -> NDArray[np.bool_]:
    """(T,) the ticks of one record that enter a level: those whose level is not that of the tick before."""
    return np.diff(rows["level"].astype(np.int64), prepend=rows["level"][:1]) != 0


def sample_ladder(
    bench: Bench,
    motions: Sequence[Motion],
    clock: Clock,
    felt_clock: Clock,
    relay_clock: Clock,
    perception: Perception,
    l_mm: float,
    progress: Progress,
) -> tuple[LadderData, Costing]:
    """Replays everything. Motions are at the clock's rate and at least as long.

    A tick that decides the cost's tail is rare: time goes into ticks, each replayed once and priced by its counters.
    The feel is read from all ticks too: a motion has few contacts, and a part of it is another hand. What is dear is to
    ask what a switch would do there, so `felt_clock` may have fewer instants. What the loop pays for a switch is read
    from the first part of each motion, `relay_clock`.

    Raises:
        InputError: the motions never touch.
    """
    grid, station = bench.grid, bench.station
    rungs, subsets = grid.shape
    whole = [clock.cut(motion, i) for i, motion in enumerate(motions)]
    cut = [felt_clock.cut(motion, i) for i, motion in enumerate(motions)]
    part = [relay_clock.cut(motion, i) for i, motion in enumerate(motions)]

    def felt(rows: Sequence[NDArray]) -> list[NDArray]:
        return [its[:ticks] for its, ticks in zip(rows, felt_clock.motion_ticks, strict=True)]

    with ThreadPoolExecutor(threads()) as pool:
        levels = list(pool.map(bench.level, range(rungs)))
    level_bytes = np.array([level.bytes for level in levels], dtype=np.float64)

    progress("replay the ladder", 0.0)
    first = replay_fixed(bench, levels[0], 0, grid.balls[0], whole, 1)
    reference = make_reference(felt(first), clock.loop_hz, perception)
    if not reference.contact.any():  # before minutes are spent
        raise InputError("motions", "never touch the scan", "give motions that do, or none to have some made")

    def one(place: tuple[int, int]) -> tuple[dict[str, Array], NDArray]:
        r, b = place
        rows = first if place == (0, 0) else replay_fixed(bench, levels[r], r, grid.balls[b], whole, 1)
        return level_fields(felt(rows), reference, felt_clock), np.concatenate(rows)

    places = [(r, b) for b in range(subsets) for r in range(rungs)]
    fields: dict[str, Array] = {}
    kept: dict[tuple[int, int], NDArray] = {}
    with ThreadPoolExecutor(threads()) as pool:
        for count, (place, (made, rows)) in enumerate(zip(places, pool.map(one, places), strict=True), 1):
            for name, values in made.items():
                fields.setdefault(name, np.zeros((*grid.shape, *values.shape)))[place] = values
            kept[place] = _counters_only(rows)
            progress("replay the ladder", count / len(places))

    progress("switch between levels", 0.0)
    tour = tour_ladder(
        bench, levels, cut, felt(first), felt_clock, l_mm, threads(),
        lambda done: progress("switch between levels", 0.5 * done),
    )  # fmt: skip
    reach_mm = (_REACHES[0] * l_mm, _REACHES[1] * l_mm)
    kinds = ((reach_mm[0], False), (reach_mm[1], False), (reach_mm[1], True))
    relays = [
        relay_ladder(
            bench, levels, part, relay_clock, reach, threads(),
            lambda done, i=i: progress("switch between levels", 0.5 + (i + done) / (2 * len(kinds))), leaping,
        )
        for i, (reach, leaping) in enumerate(kinds)
    ]  # fmt: skip
    entered = [(place, rows) for entries, _ in relays for place, rows in entries.items() if len(rows)]
    chosen = tuple(cell_rungs(grid))
    usual = [_middle(motion, _SETTLING_TICKS + _CELL_TICKS) for motion in part]
    dear = [_dearest(motion, rows, _SETTLING_TICKS + _CELL_TICKS) for motion, rows in zip(part, first, strict=True)]
    swept, cell_bytes = _sweep_cells(bench, levels, chosen, usual, dear, progress)

    # Prices of cells and triangles show where cell sizes differ, those of mappings where levels are entered.
    timed = _timed(bench, levels, part)
    staying = [(rows, int(level_bytes[r]), grid.balls[b]) for (r, b), rows in kept.items()]
    once = [(rows, int(cell_bytes[s, h]), grid.balls[b]) for (s, b, h), both in swept.items() for rows in both]
    entering = [(_counters_only(rows), int(level_bytes[r]), grid.balls[b]) for (r, b), rows in entered]
    every = [*timed, *staying, *once, *entering]
    here = calibrate(
        [rows for rows, _, _ in every], [size for _, size, _ in every], [count for _, _, count in every],
        repeated=len(timed),
    )  # fmt: skip
    curve = _curve(staying, here)
    costing = Costing(here, station, curve, _curve(entering, here) if entering else curve)
    cost = np.zeros((*grid.shape, clock.ticks))
    for (r, b), rows in kept.items():
        cost[r, b] = costing.counted_ns(rows, int(level_bytes[r]), grid.balls[b])
    switch = np.zeros((2, *grid.shape, len(SWITCH_SHARES), len(kinds)))
    for i, (entries, touched) in enumerate(relays):
        for place, rows in entries.items():
            enters = np.ones(len(rows), dtype=bool)
            size, carried = int(level_bytes[place[0]]), grid.balls[place[1]]
            priced = costing.counted_ns(rows, size, carried, enters) if len(rows) else np.zeros(0)
            switch[:, *place, :, i] = np.stack(entry_costs(priced, touched[place], cost[place]))

    data = LadderData(
        grid=grid, clock=clock, felt_clock=felt_clock, fields=fields, velocity_mm_s=_velocity_mm_s(whole),
        contact=np.concatenate([rows["contact"] == 1 for rows in first]), cost_ns=cost,
        reference=reference, tour=tour,
        switch_ns=switch[0], free_switch_ns=switch[1], reach_mm=reach_mm,
        steps=(mean_step(range(rungs), grid.triangles), mean_step(leaps(rungs), grid.triangles)), cell_rungs=chosen,
        cell_cost=_cell_cost(bench, swept, cell_bytes, costing), level_bytes=level_bytes, cell_bytes=cell_bytes,
    )  # fmt: skip
    return data, costing


def _counters_only(rows: NDArray) -> NDArray:
    names = ["cost_ns", "cells", "triangles", "tests", "iterations", "balls", "mapping_cells"]
    out = np.zeros(len(rows), dtype=[(name, rows.dtype[name]) for name in names])
    for name in names:
        out[name] = rows[name]
    return out


def _curve(records: Sequence[_Timed], here: CostCoefficients) -> PriceCurve:
    counted = [counted_cost_ns(rows, size, here, balls) for rows, size, balls in records]
    return price_curve(np.concatenate([rows["cost_ns"] for rows, _, _ in records]), np.concatenate(counted))


def _velocity_mm_s(motions: Sequence[Motion]) -> Array:
    places = [motion.position_mm for motion in motions]
    return np.concatenate([np.diff(at, axis=0, prepend=at[:1]) for at in places]) * motions[0].loop_hz


def _timed(bench: Bench, levels: Sequence, motions: Sequence[Motion]) -> list[_Timed]:
    """A few replays, one after the other: a tick's time is its least of several runs."""
    parts = [_middle(motion, _SETTLING_TICKS + _TIMED_TICKS) for motion in motions]
    made = []
    for r in range(0, len(levels), _TIMED_RUNGS):
        for b in sorted({0, len(bench.grid.balls) - 1}):
            replays = replay_fixed(bench, levels[r], r, bench.grid.balls[b], parts, _TIMED_REPEATS)
            rows = _counters_only(np.concatenate([rows[_SETTLING_TICKS:] for rows in replays]))
            made.append((rows, levels[r].bytes, bench.grid.balls[b]))
    return made


# Rows of one cell size: of the usual ticks, and of the dearest.
_Swept = dict[tuple[int, int, int], tuple[NDArray, NDArray]]


def _sweep_cells(
    bench: Bench, levels: Sequence, chosen: Sequence[int], usual: Sequence[Motion], dear: Sequence[Motion],
    progress: Progress,
) -> tuple[_Swept, Array]:  # fmt: skip
    """Rows by (place in `chosen`, subset, cell size), and bytes (S, H)."""
    grid = bench.grid
    size = np.zeros((len(chosen), len(grid.cell_edges)))
    swept: _Swept = {}

    def one(task: tuple[int, int]) -> None:
        s, h = task
        rung = chosen[s]
        level = levels[rung] if h == grid.base_cell else bench.level(rung, h)
        size[s, h] = level.bytes
        for b, balls in enumerate(grid.balls):
            made = [
                _counters_only(np.concatenate([row[_SETTLING_TICKS:] for row in replayed]))
                for replayed in (replay_fixed(bench, level, rung, balls, m, 1, h) for m in (usual, dear))
            ]
            swept[s, b, h] = made[0], made[1]

    tasks = [(s, h) for s in range(len(chosen)) for h in range(len(grid.cell_edges))]
    progress("try cell sizes", 0.0)
    with ThreadPoolExecutor(threads()) as pool:
        for count, _ in enumerate(pool.map(one, tasks), 1):
            progress("try cell sizes", count / len(tasks))
    return {place: swept[place] for place in sorted(swept)}, size


def _cell_cost(bench: Bench, swept: _Swept, cell_bytes: Array, costing: Costing) -> Array:
    """(S, B, H, 2) mean cost of the usual ticks and that of the dearest, by what they counted.

    Cell sizes differ by tenths; a short part timed once shows what else the machine did meanwhile.
    """
    balls = bench.grid.balls
    cost = np.zeros((cell_bytes.shape[0], len(balls), cell_bytes.shape[1], 2))
    for (s, b, h), both in swept.items():
        usual, dear = (costing.counted_ns(rows, int(cell_bytes[s, h]), balls[b]) for rows in both)
        cost[s, b, h] = usual.mean(), dearest_mean(dear)
    return cost


def _middle(motion: Motion, ticks: int) -> Motion:
    """So many ticks of a motion, or all where it is shorter."""
    return _stretch(motion, (motion.ticks - ticks) // 2, ticks)


def _dearest(motion: Motion, rows: NDArray, ticks: int) -> Motion:
    """So many ticks of a motion about those that ask most, by what was counted over its first so many."""
    asked = np.sum(
        [rows[name][: motion.ticks] / max(rows[name].mean(), 1e-9) for name in ("triangles", "tests")], axis=0
    )
    # Where the window's tail is largest, not its sum: p99.9 rests on single ticks.
    at = int(np.argmax(np.convolve(np.square(asked), np.ones(ticks - _SETTLING_TICKS), mode="same")))
    return _stretch(motion, at - ticks // 2, ticks)


def _stretch(motion: Motion, first: int, ticks: int) -> Motion:
    """So many ticks from about the first on, moved to where the motion has them."""
    first = min(max(first, 0), max(motion.ticks - ticks, 0))
    return motion.part(first / motion.loop_hz, min(first + ticks, motion.ticks) / motion.loop_hz)
