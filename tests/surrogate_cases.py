"""A made-up ladder measurement: small, smooth in nothing, every branch of the surrogate in use."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from hapticlod.perception import load_perception
from hapticlod.surrogate.cost import SWITCH_SHARES, CostModel, SpeedFactors, cell_factors, group_samples
from hapticlod.surrogate.ladder_curves import ladder_curves
from hapticlod.surrogate.measurement import Feel, Instants, LadderMeasurement
from hapticlod.surrogate.traps import Traps
from tuning import search
from tuning.space import Space

RUNGS, SUBSETS, CELLS = 4, 2, 3
TICKS_PER_BIN, BINS_PER_WINDOW, BINS_PER_INSTANT = 4, 4, 4
BINS, GROUPS = 160, 20
TICKS, INSTANTS = BINS * TICKS_PER_BIN, BINS // BINS_PER_INSTANT


def few_starts(patch: pytest.MonkeyPatch) -> None:
    """Searches begin from fewer points than for users: enough on so small a ladder."""
    patch.setattr(search, "SCREENED", 8)
    patch.setattr(search, "STARTS", 3)


def made_measurement(seed: int = 0, *, perfect: bool = False) -> LadderMeasurement:
    """Numbers without a scan, in the shapes and of the sizes that real ones have. Needs float64 to be on.

    `perfect`: nothing is felt of the finest rung with all balls, as nothing is of a scan.
    """
    random = np.random.default_rng(seed)
    coarseness = np.log(np.array([1.0, 3.0, 10.0, 40.0]))
    coarse = (np.arange(RUNGS) + 0.1)[:, None, None]

    def bins(scale: float, power: float = 1.0) -> np.ndarray:
        return scale * coarse**power * random.uniform(0.5, 1.5, (RUNGS, SUBSETS, BINS))

    def share(low: float = 0.6) -> np.ndarray:
        return random.uniform(low, 1.0, (RUNGS, SUBSETS, BINS))

    curves = lambda values: ladder_curves(coarseness, values)
    force_sq = bins(0.02, 2.0)
    if perfect:
        force_sq[0, 0] = 0.0
    feel = Feel(
        felt=curves(force_sq * 20), force_sq=curves(force_sq), peak_n=curves(np.sqrt(2 * force_sq)),
        band_sq=curves(0.1 * force_sq), either=curves(share()), both=curves(share(0.4)), contact=curves(share()),
        depth_mm=curves(bins(0.4, 0.1)), release=curves(bins(1e-4)), pop=curves(bins(1e-5)),
        work_mj=curves(random.normal(size=(RUNGS, SUBSETS, BINS)) * 0.05),
    )  # fmt: skip
    heading = np.cumsum(random.normal(size=TICKS) * 0.02)
    speed = 40 * np.exp(np.convolve(random.normal(size=TICKS), np.ones(40) / 15, mode="same"))
    starts = np.zeros(TICKS, bool)
    starts[[0, TICKS // 2]] = True
    force = random.normal(size=(INSTANTS, 3))
    rough = np.sort(bins(0.01)[..., None, :INSTANTS] * random.uniform(0, 2, (RUNGS, SUBSETS, 3, INSTANTS)), axis=2)
    perception = load_perception()
    cost_ns = np.exp(random.normal(size=(RUNGS, SUBSETS, TICKS)) * 0.7) * 3e4 / coarse**0.5
    group = np.arange(BINS // BINS_PER_WINDOW) % GROUPS
    samples, sizes = group_samples(cost_ns, group)
    samples = np.log(samples)
    entries = np.log(np.sort(cost_ns[..., : len(SWITCH_SHARES)] * 2, axis=-1))[..., None] + np.array([0.0, 0.7, 1.0])
    cell_edges = np.array([1.5, 4.0, 10.0])
    instants = Instants(
        offset_n=jnp.asarray(random.normal(size=(RUNGS, SUBSETS, INSTANTS, 3)) * 0.1 * coarse[..., None]),
        gap_mm=jnp.asarray(random.normal(size=(RUNGS, SUBSETS, INSTANTS)) * 0.1 * coarse),
        held=jnp.asarray((random.uniform(size=(RUNGS, SUBSETS, INSTANTS)) > 0.2).astype(float)),
        rough_n=jnp.asarray(rough),
        rough_noticed=jnp.asarray(perception.noticed(rough / 0.1)),
        windows=jnp.array([0.0, 10.0, 100.0]),
        force_n=jnp.asarray(force),
        step_n=jnp.asarray(force * 0.02),
        contact=jnp.asarray(random.uniform(0.3, 1.0, INSTANTS)),
        starts=jnp.asarray(starts.reshape(INSTANTS, -1).any(axis=1)),
        lost_felt=jnp.asarray(random.uniform(5, 20, INSTANTS)),
        lost_force_sq=jnp.asarray(random.uniform(0.5, 2, INSTANTS)),
        felt_per_n2=jnp.asarray(random.uniform(20, 60, INSTANTS)),
        ticks=jnp.asarray(float(TICKS_PER_BIN * BINS_PER_INSTANT)),
    )
    cost = CostModel(
        samples=curves(samples),
        depth=curves(np.clip(samples - 10, 0, 2)),
        switch=curves(entries),
        free_switch=curves(entries - 1.0),
        by_speed=SpeedFactors(
            jnp.log(jnp.array([4.0, 20.0, 90.0])),
            jnp.asarray(np.outer([-0.3, 0.05, 0.6], np.linspace(0.4, 1.0, len(SWITCH_SHARES)))),
        ),
        log_reach=jnp.log(jnp.array([0.2, 2.0])),
        steps=jnp.array([1.2, 3.0]),
        contact=jnp.asarray(random.uniform(0.3, 1.0, BINS)),
        cells=cell_factors(cell_edges, random.uniform(0, 0.6, (RUNGS, SUBSETS, CELLS, 3))),
        sizes=jnp.asarray(sizes),
        group=jnp.asarray(group),
        spread=jnp.asarray(0.02),
    )
    return LadderMeasurement(
        coarseness=jnp.asarray(coarseness),
        thinness=jnp.asarray(np.log([1.0, 4.0])),
        log_finest=jnp.asarray(np.log(1e5)),
        log_all_balls=jnp.asarray(np.log(16.0)),
        log_edge_mm=jnp.asarray(0.5 * coarseness - 1),
        velocity_mm_s=jnp.asarray(np.stack([speed * np.cos(heading), speed * np.sin(heading), 0 * speed], axis=1)),
        starts=jnp.asarray(starts),
        felt_bins=jnp.arange(BINS),
        cycle=jnp.asarray(np.repeat(np.arange(BINS // 20) % 4, 20)),
        feel=feel,
        traps=_made_traps(seed, coarse, perfect),
        instants=instants,
        cost=cost,
        log_bytes=curves(np.log(1e7 / np.exp(coarseness))[:, None, None] * np.ones((RUNGS, SUBSETS, CELLS))),
        log_cell_edges=jnp.asarray(np.log(cell_edges)),
        stiffness_n_mm=jnp.asarray(1.0),
        cycles=4,
        tick_s=1e-3,
        dwell_ticks=0,
        perception=perception,
    )


def _made_traps(seed: int, coarse: np.ndarray, perfect: bool) -> Traps:
    random, shape = np.random.default_rng(seed + 1000), (RUNGS, SUBSETS, INSTANTS)
    caught = random.uniform(0, 0.3, shape) * coarse
    caught[0, 0] *= not perfect
    return Traps(jnp.asarray(caught), jnp.asarray(0.03 * caught), jnp.asarray(random.uniform(size=shape) < 0.2))


def made_space() -> Space:
    """The box to search on it."""
    coarseness = np.log([1.0, 3.0, 10.0, 40.0])
    return Space(
        triangles=(2500.0, 1e5), balls=(4.0, 16.0), edge_log_triangles=np.log(1e5) - coarseness[::-1],
        edge_log_mm=0.5 * coarseness[::-1] - 1, speeds_mm_s=(5.0, 200.0), l_mm=(0.05, 1.0),
    )  # fmt: skip
