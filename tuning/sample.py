"""Samples a ladder in the runtime: replays, tours and cell sizes, and the cost coefficients that follow from them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hapticlod.errors import InputError
from hapticlod.motion import Motion
from hapticlod.perception import Perception
from hapticlod.surrogate.cost import SWITCH_SHARES
from tuning.assemble import LadderData, cell_rungs, stages_of_cost
from tuning.calibrate import calibrate
from tuning.costing import Costing
from tuning.entries import entry_costs, entry_speeds
from tuning.grid import Clock
from tuning.level_fields import level_fields, make_reference
from tuning.relay import leaps, mean_step, relay_ladder
from tuning.replays import Bench, replay_fixed, tour_ladder
from tuning.timing import counters_only, curve_of, prices_of_levels, time_ticks

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

# Mapping lengths that switches are priced with, in the tour's.
_REACHES = (0.5, 4.0)
# Every so-manieth rung is replayed with other cells, with all subsets of a shaped tool, and is timed with them.
_SWEPT, _SWEPT_SHAPED, _TIMED = 2, 3, 4


def threads() -> int:
    """Replays that run at once."""
    return max(1, len(os.sched_getaffinity(0)))


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
            kept[place] = counters_only(rows)
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
    entered = [(place, its.rows) for entries in relays for place, its in entries.items() if len(its.rows)]
    chosen = tuple(cell_rungs(grid, _SWEPT if subsets == 1 else _SWEPT_SHAPED))
    swept, cell_bytes = _sweep_cells(bench, levels, chosen, whole, progress)

    # Prices of cells and triangles show where cell sizes differ, those of mappings where levels are entered.
    progress("time ticks", 0.0)
    timed_levels, timed = time_ticks(bench, levels, cell_rungs(grid, _TIMED), whole, first)
    staying = [(rows, int(level_bytes[r]), grid.balls[b]) for (r, b), rows in kept.items()]
    once = [(rows, int(cell_bytes[s, h]), grid.balls[b]) for (s, b, h), rows in swept.items()]
    entering = [(counters_only(rows), int(level_bytes[r]), grid.balls[b]) for (r, b), rows in entered]
    every = [*timed, *staying, *once, *entering]
    here = calibrate(
        [rows for rows, _, _ in every], [size for _, size, _ in every], [count for _, _, count in every],
        repeated=len(timed),
    )  # fmt: skip
    # Dearest paired with dearest: what a tick takes beside its counts spreads costs, and a quantile is wanted.
    curve = curve_of(timed, here)
    costing = Costing(here, station, curve, curve_of(entering, here) if entering else curve)
    costing = replace(costing, levels=prices_of_levels(grid, timed_levels, timed, costing))
    rung_factor = [costing.levels.factor(grid.triangles[r], grid.cell_mm(r)) for r in range(rungs)]
    cost = np.zeros((*grid.shape, clock.ticks))
    for (r, b), rows in kept.items():
        cost[r, b] = costing.counted_ns(rows, int(level_bytes[r]), grid.balls[b], None, rung_factor[r])
    switch = np.zeros((2, *grid.shape, len(SWITCH_SHARES), len(kinds)))
    in_contact: list[tuple[Array, Array]] = []
    for i, entries in enumerate(relays):
        for place, its in entries.items():
            enters = np.ones(len(its.rows), dtype=bool)
            size, carried = int(level_bytes[place[0]]), grid.balls[place[1]]
            factor = rung_factor[place[0]]
            priced = costing.counted_ns(its.rows, size, carried, enters, factor) if len(its.rows) else np.zeros(0)
            switch[:, *place, :, i] = np.stack(entry_costs(priced, its.touched, cost[place]))
            in_contact.append((priced[its.touched], its.speed_mm_s[its.touched]))
    by_speed = entry_speeds(in_contact)

    data = LadderData(
        grid=grid, clock=clock, felt_clock=felt_clock, fields=fields, velocity_mm_s=_velocity_mm_s(whole),
        contact=np.concatenate([rows["contact"] == 1 for rows in first]), cost_ns=cost,
        reference=reference, tour=tour,
        switch_ns=switch[0], free_switch_ns=switch[1], switch_speed_mm_s=by_speed[0], switch_by_speed=by_speed[1],
        reach_mm=reach_mm,
        steps=(mean_step(range(rungs), grid.triangles), mean_step(leaps(rungs), grid.triangles)), cell_rungs=chosen,
        cell_cost=_cell_cost(bench, chosen, kept, swept, cell_bytes, costing), level_bytes=level_bytes,
        cell_bytes=cell_bytes,
    )  # fmt: skip
    return data, costing


def _velocity_mm_s(motions: Sequence[Motion]) -> Array:
    places = [motion.position_mm for motion in motions]
    return np.concatenate([np.diff(at, axis=0, prepend=at[:1]) for at in places]) * motions[0].loop_hz


# Rows by (place in `chosen`, subset, cell size).
_Swept = dict[tuple[int, int, int], NDArray]


def _sweep_cells(
    bench: Bench, levels: Sequence, chosen: Sequence[int], motions: Sequence[Motion], progress: Progress
) -> tuple[_Swept, Array]:
    """Rows of all other cell sizes than the replays', and bytes (S, H).

    Over whole motions: what is dear with one cell size is not with another, and the tail rests on single ticks.
    """
    grid = bench.grid
    size = np.zeros((len(chosen), len(grid.cell_edges)))
    size[:, grid.base_cell] = [levels[rung].bytes for rung in chosen]
    swept: _Swept = {}

    def one(task: tuple[int, int]) -> None:
        s, h = task
        level = bench.level(chosen[s], h)
        size[s, h] = level.bytes
        for b, balls in enumerate(grid.balls):
            replayed = replay_fixed(bench, level, chosen[s], balls, motions, 1, h)
            swept[s, b, h] = counters_only(np.concatenate(replayed))

    tasks = [(s, h) for s in range(len(chosen)) for h in range(len(grid.cell_edges)) if h != grid.base_cell]
    progress("try cell sizes", 0.0)
    with ThreadPoolExecutor(threads()) as pool:
        for count, _ in enumerate(pool.map(one, tasks), 1):
            progress("try cell sizes", count / len(tasks))
    return {place: swept[place] for place in sorted(swept)}, size


def _cell_cost(
    bench: Bench, chosen: Sequence[int], kept: dict[tuple[int, int], NDArray], swept: _Swept, cell_bytes: Array,
    costing: Costing,
) -> Array:  # fmt: skip
    """(S, B, H, 3) by what was counted: cell sizes differ by tenths, and times show what else the machine did."""
    grid = bench.grid
    cost = np.zeros((len(chosen), len(grid.balls), len(grid.cell_edges), 3))
    for s, b, h in np.ndindex(cost.shape[:3]):
        rows = kept[chosen[s], b] if h == grid.base_cell else swept[s, b, h]
        factor = costing.levels.factor(grid.triangles[chosen[s]], grid.cell_mm(chosen[s], h))
        cost[s, b, h] = stages_of_cost(costing.counted_ns(rows, int(cell_bytes[s, h]), grid.balls[b], None, factor))
    return cost
