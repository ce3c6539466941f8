"""Replays -> the arrays that the surrogate is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from hapticlod.surrogate.cost import CostModel, SpeedFactors, cell_factors, group_samples
from hapticlod.surrogate.ladder_curves import LadderCurves, ladder_curves
from hapticlod.surrogate.measurement import Feel, Instants, LadderMeasurement
from hapticlod.surrogate.traps import Traps
from tuning.common_shape import in_common_shape
from tuning.grid import Clock, Grid
from tuning.level_fields import WINDOWS_S, Reference
from tuning.replays import Tour
from tuning.split_traps import split_traps

Array = NDArray[np.float64]

# Shares of a level's ticks, dearest first: where the body of its costs begins, and what stands for two percentiles.
_BODY_FROM, _P99_SPAN, _P999_SPAN = 0.1, (0.005, 0.02), (0.0004, 0.0025)
# Costs are counted and have no noise: quantiles are smoothed only as far as slopes need it, in ln cost.
_SPREAD = 0.03
# Of a group of windows that share a distribution of costs: its size, and the cut-off of the speed they share.
_GROUP_TICKS, _GROUP_HZ = 512, 13.0


@dataclass(frozen=True)
class LadderData:
    """Everything that replays gave, in numpy; what is cached between runs.

    Attributes:
        grid, clock: where and when. `felt_clock`: of the feel, which is read from all of each motion but what fills no
            instant; its instants may be further apart.
        fields: by name (R, B, ...), of `tuning.level_fields.level_fields`.
        velocity_mm_s, contact: (T, 3) and (T,) of the hand, and whether the finest level touches.
        cost_ns: (R, B, T) of a tick, on the station, by its counters.
        reference: of the finest level, over the feel's part.
        tour: of switches, over the feel's part.
        switch_ns, free_switch_ns: (R, B, M, 3) cost of ticks that enter a level, on the station, in contact and out of
            it: one value for each of the shares `hapticlod.surrogate.cost.SWITCH_SHARES`, cheapest first; from the next
            rung with a short mapping length and with a long one, and with the long one from a rung far away.
        switch_speed_mm_s, switch_by_speed: of `tuning.entries.entry_speeds`.
        reach_mm: the two mapping lengths. steps: |ln N - ln N'| of a next rung and of one far away.
        cell_rungs: rungs whose other cell sizes were sampled.
        cell_cost: (S, B, H, 3) costs by cell size at these rungs: `stages_of_cost`.
        level_bytes: (R,) with the replays' cells; cell_bytes: (S, H).
    """

    grid: Grid
    clock: Clock
    felt_clock: Clock
    fields: dict[str, Array]
    velocity_mm_s: Array
    contact: NDArray[np.bool_]
    cost_ns: Array
    reference: Reference
    tour: Tour
    switch_ns: Array
    free_switch_ns: Array
    switch_speed_mm_s: Array
    switch_by_speed: Array
    reach_mm: tuple[float, float]
    steps: tuple[float, float]
    cell_rungs: tuple[int, ...]
    cell_cost: Array
    level_bytes: Array
    cell_bytes: Array


def stages_of_cost(cost: Array) -> Array:
    """(3,) of the costs (T,) of ticks: their body, about their 99th and about their 99.9th percentile.

    The body is a mean, the others geometric means of a few ranks, where a quantile is one chance tick.
    """
    ticks = len(cost)
    dearest = -np.sort(-cost)
    body = dearest[round(_BODY_FROM * ticks) :].mean()
    spans = [(int(first * ticks), int(last * ticks)) for first, last in (_P99_SPAN, _P999_SPAN)]
    tail = [np.exp(np.log(np.maximum(dearest[a : max(b, a + 1)], 1.0)).mean()) for a, b in spans]
    return np.array([body, *tail])


def assemble(data: LadderData, stiffness_n_mm: float, dwell_s: float) -> LadderMeasurement:
    """The surrogate's arrays. Lays no file, starts no replay."""
    grid, clock, felt, reference = data.grid, data.clock, data.felt_clock, data.reference
    coarseness = np.log(grid.triangles[0] / np.array(grid.triangles, dtype=np.float64))
    thinness = np.log(grid.balls[0] / np.array(grid.balls, dtype=np.float64))

    def curves(values: Array) -> LadderCurves:
        return ladder_curves(coarseness, values)

    fields, traps = _without_traps(data)
    feel = Feel(**{name: curves(fields[name]) for name in Feel.__dataclass_fields__})
    cycle = _numbered(felt.binned(reference.cycle)[:, -1])
    tick_s = 1.0 / clock.loop_hz
    log_bytes = np.log(data.level_bytes)[:, None, None] + _cell_bytes(data)[:, None, :]
    measured = LadderMeasurement(
        coarseness=jnp.asarray(coarseness),
        thinness=jnp.asarray(thinness),
        log_finest=jnp.asarray(np.log(float(grid.triangles[0]))),
        log_all_balls=jnp.asarray(np.log(float(grid.balls[0]))),
        log_edge_mm=jnp.asarray(np.log(np.array(grid.edge_mm))),
        velocity_mm_s=jnp.asarray(data.velocity_mm_s),
        starts=jnp.asarray(clock.marks(1)),
        felt_bins=jnp.asarray(felt_bins(clock, felt)),
        cycle=jnp.asarray(cycle),
        feel=feel,
        traps=traps,
        instants=_instants(data, stiffness_n_mm),
        cost=_cost_model(data, curves),
        log_bytes=curves(log_bytes),
        log_cell_edges=jnp.asarray(np.log(np.array(grid.cell_edges))),
        stiffness_n_mm=jnp.asarray(stiffness_n_mm),
        cycles=len(cycle) + 1,  # as many as there may be, since it is a shape: compiled code fits other motions
        tick_s=tick_s,
        dwell_ticks=round(dwell_s / tick_s),
        perception=reference.perception,
    )
    return in_common_shape(measured)


def _numbered(cycle: NDArray[np.intp]) -> NDArray[np.intp]:
    """Cycles of bins, numbered anew without those in which no bin ends; 0 stays 0."""
    return np.unique(np.append(0, cycle), return_inverse=True)[1][1:]


def _instants(data: LadderData, stiffness_n_mm: float) -> Instants:
    clock, reference = data.felt_clock, data.reference
    per = clock.ticks_per_instant
    at = np.arange(per - 1, clock.ticks, per)

    def mean(values: Array) -> Array:
        return values.reshape(-1, per).mean(axis=1)

    jnd = reference.perception.jnd_n(np.linalg.norm(reference.force_n[at], axis=1))
    force_sq = np.einsum("ij,ij->i", reference.force_n, reference.force_n) * reference.contact
    return Instants(
        offset_n=jnp.asarray(data.tour.offset_n),
        gap_mm=jnp.asarray(_without_strays(data.tour.gap_mm, data.tour.touching)),
        held=jnp.asarray(data.tour.held.astype(np.float64)),
        rough_n=jnp.asarray(data.fields["rough_n"]),
        rough_noticed=jnp.asarray(reference.perception.noticed(data.fields["rough_n"] / jnd)),
        windows=jnp.asarray(np.round(np.array(WINDOWS_S) * clock.loop_hz)),
        force_n=jnp.asarray(reference.force_n[at]),
        step_n=jnp.asarray(reference.step_n[at]),
        contact=jnp.asarray(mean(reference.contact.astype(np.float64))),
        starts=jnp.asarray(clock.marks(per)),
        lost_felt=jnp.asarray(mean(force_sq * reference.felt_per_n2)),
        lost_force_sq=jnp.asarray(mean(force_sq)),
        felt_per_n2=jnp.asarray(mean(reference.felt_per_n2)),
        ticks=jnp.asarray(float(per)),
    )


def _without_traps(data: LadderData) -> tuple[dict[str, Array], Traps]:
    """The fields without what rungs owe to their past, and that."""
    clock, reference = data.felt_clock, data.reference
    bins, per = clock.bins_per_instant, clock.ticks_per_instant
    at = np.arange(per - 1, clock.ticks, per)

    def instants(values: Array) -> Array:
        return values.reshape(*values.shape[:-1], -1, bins).mean(axis=-1)

    felt, force_sq = instants(data.fields["felt"]), instants(data.fields["force_sq"])
    fresh = np.einsum("rbik,rbik->rbi", data.tour.offset_n, data.tour.offset_n) * reference.felt_per_n2[at]
    excess, begins = split_traps(felt, fresh, clock.marks(per))
    share = excess / np.maximum(felt, 1e-12)
    left = 1.0 - np.repeat(share, bins, axis=-1)
    cleared = {name: data.fields[name] * left for name in ("felt", "force_sq")}
    traps = Traps(jnp.asarray(excess), jnp.asarray(force_sq * share), jnp.asarray(begins))
    return {**data.fields, **cleared}, traps


def felt_bins(clock: Clock, felt: Clock) -> NDArray[np.intp]:
    """(n,) bins of the feel's part among all: the first of every motion."""
    per = clock.ticks_per_bin
    first = np.array(clock.starts_tick) // per
    return np.concatenate([at + np.arange(ticks // per) for at, ticks in zip(first, felt.motion_ticks, strict=True)])


def _without_strays(gap_mm: Array, touching: NDArray[np.bool_]) -> Array:
    """Gaps clipped to three times a rung's 98th percentile: a tour that lost its way says nothing of surfaces."""
    if not touching.any():
        return gap_mm
    most = 3.0 * np.quantile(np.abs(gap_mm[:, :, touching]), 0.98, axis=2)[:, :, None]
    return np.clip(gap_mm, -most, most)


def _cost_model(data: LadderData, curves) -> CostModel:
    clock = data.clock
    group = cost_groups(data.velocity_mm_s, clock)
    counted, sizes = group_samples(data.cost_ns, group)
    samples = np.log(np.maximum(counted, 1.0))
    # How deep in its level's tail a sample lies: by where it is among all of the level's ticks.
    knots = np.log(np.maximum(np.quantile(data.cost_ns, (1.0 - _BODY_FROM, 0.99, 0.999), axis=2), 1.0))[..., None, None]
    passed = np.clip((samples - knots[:-1]) / np.maximum(np.diff(knots, axis=0), 1e-3), 0.0, 1.0)
    depth = passed[0] + passed[1]
    cost = np.maximum(data.cell_cost, 1.0)
    factors = np.log(cost / cost[:, :, data.grid.base_cell : data.grid.base_cell + 1])
    return CostModel(
        samples=curves(samples),
        depth=curves(depth),
        switch=curves(np.log(np.maximum(data.switch_ns, 1.0))),
        free_switch=curves(np.log(np.maximum(data.free_switch_ns, 1.0))),
        by_speed=SpeedFactors(jnp.log(jnp.asarray(data.switch_speed_mm_s)), jnp.asarray(data.switch_by_speed)),
        log_reach=jnp.log(jnp.array(data.reach_mm)),
        steps=jnp.array(data.steps),
        cells=cell_factors(np.array(data.grid.cell_edges), _along_rungs(data, factors)),
        contact=jnp.asarray(clock.binned(data.contact.astype(np.float64)).mean(axis=1)),
        sizes=jnp.asarray(sizes),
        group=jnp.asarray(group),
        spread=jnp.asarray(_SPREAD),
    )


def cost_groups(velocity_mm_s: Array, clock: Clock) -> NDArray[np.intp]:
    """(windows,) group of each window: about `_GROUP_TICKS` ticks of one motion at about one speed of the hand."""
    from scipy.signal import lfilter  # takes a second to import, and what is assembled here is kept between runs

    window = clock.ticks_per_bin * clock.bins_per_window
    gain = np.exp(-2 * np.pi * _GROUP_HZ / clock.loop_hz)
    number, speed, at = [], [], 0
    for motion, ticks in enumerate(clock.motion_ticks):
        smooth = lfilter([1 - gain], [1, -gain], velocity_mm_s[at : at + ticks], axis=0)
        speed.append(np.linalg.norm(smooth, axis=1).reshape(-1, window).mean(axis=1))
        number.append(np.full(ticks // window, motion))
        at += ticks
    order = np.lexsort((np.concatenate(speed), np.concatenate(number)))
    group = np.empty(len(order), dtype=np.intp)
    parts = max(1, round(len(order) * window / _GROUP_TICKS))
    group[order] = np.arange(len(order)) * parts // len(order)
    return group


def _along_rungs(data: LadderData, values: Array) -> Array:
    """(S, ...) at the sampled rungs -> (R, ...) at all, linear in coarseness."""
    coarseness = -np.log(np.array(data.grid.triangles, dtype=np.float64))
    known = coarseness[list(data.cell_rungs)]
    flat = values.reshape(len(known), -1)
    out = np.stack([np.interp(coarseness, known, column) for column in flat.T], axis=1)
    return out.reshape(len(coarseness), *values.shape[1:])


def _cell_bytes(data: LadderData) -> Array:
    """(R, H) ln of bytes relative to the replays' cells."""
    base = data.cell_bytes[:, data.grid.base_cell : data.grid.base_cell + 1]
    return _along_rungs(data, np.log(data.cell_bytes / base))


def cell_rungs(grid: Grid, every: int, most_triangles: int = 300_000) -> Sequence[int]:
    """Rungs whose other cell sizes are sampled: every so-manieth that is not too large to build five times."""
    small = [r for r, count in enumerate(grid.triangles) if count <= most_triangles] or [len(grid.triangles) - 1]
    return small[::every]
