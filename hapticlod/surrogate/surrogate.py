"""The surrogate: configuration parameters -> the metrics of PERCEPTION.md section 1, differentiable.

`predict` is a pure function of arrays. Names and units of its results are those of `hapticlod.metrics.measure`.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapticlod.surrogate.cost import longest_run, tick_costs
from hapticlod.surrogate.feel import blend_band_square, blend_square, blended_share, switch_events
from hapticlod.surrogate.ladder_curves import LadderCurves, Places, linear_weights, places
from hapticlod.surrogate.measurement import LadderMeasurement
from hapticlod.surrogate.parameters import Parameters
from hapticlod.surrogate.quantile import smooth_max, smooth_quantile, smooth_quantiles
from hapticlod.surrogate.switching import Switching, affine_scan, filtered_speed_mm_s, soft_switching
from hapticlod.surrogate.traps import trapped

# Sigmoids are eta / SHARPNESS wide in ln speed: sharp enough to count switches to a per cent.
SHARPNESS = 20.0

Metrics = dict[str, Float[Array, ""]]


def level_places(measured: LadderMeasurement, parameters: Parameters) -> Places:
    """Where each level lies on the ladder and among the tool's subsets."""
    return places(
        measured.coarseness,
        measured.thinness,
        measured.log_finest - parameters.log_triangles,
        measured.log_all_balls - parameters.log_balls,
    )


def memory_mb(measured: LadderMeasurement, parameters: Parameters) -> Float[Array, ""]:
    """Resident bytes of the levels, MB."""
    rungs = jnp.sum(level_places(measured, parameters).cubic, axis=3)
    cells = linear_weights(measured.log_cell_edges, parameters.log_cell_edges)
    log_bytes = jnp.einsum("kvr,kh,vrh->k", rungs, cells, measured.log_bytes.nodes[:, :, 0])
    return jnp.sum(parameters.used * jnp.exp(log_bytes)) / 1e6


class Members(eqx.Module):
    """What each of M motions makes of a configuration, (M,) each: the metrics of these names, of that motion alone."""

    felt_error_jnd: Float[Array, " M"]
    discontinuity_per_s: Float[Array, " M"]


def predict(
    measured: LadderMeasurement,
    parameters: Parameters,
    budget_us: Float[Array, ""] | float,
    sharpness: Float[Array, ""] | float = SHARPNESS,
) -> Metrics:
    """All metrics of one configuration, over all motions together.

    **Arguments:** as `predict_members`.

    **Returns:** scalars by PERCEPTION's keys.
    """
    return predict_members(measured, parameters, budget_us, sharpness)[0]


def predict_members(
    measured: LadderMeasurement,
    parameters: Parameters,
    budget_us: Float[Array, ""] | float,
    sharpness: Float[Array, ""] | float = SHARPNESS,
    motions: int = 1,
) -> tuple[Metrics, Members]:
    """All metrics of one configuration, and what each motion makes of it.

    **Arguments:**

    - `measured`: of scan, tool, motions and station.
    - `parameters`: the configuration.
    - `budget_us`: what a tick may cost, for the miss rate.
    - `sharpness`: of the soft triggers; annealed upward by the optimiser.
    - `motions`: how many there are.

    **Returns:** scalars by PERCEPTION's keys; the motions in their order.
    """
    where = level_places(measured, parameters)
    edge_mm = jnp.exp(jnp.sum(where.linear, axis=2) @ measured.log_edge_mm)
    tick_s, blend_s, instants = measured.tick_s, parameters.blend_s, measured.instants
    speed = filtered_speed_mm_s(measured.velocity_mm_s, measured.starts, parameters.filter_hz, tick_s)
    switching = soft_switching(
        speed, measured.starts, parameters.reachable_log_speeds, parameters.hysteresis, sharpness, measured.dwell_ticks
    )
    ticks_per_bin = measured.ticks_per_bin
    bins_per_instant = measured.bins // instants.contact.shape[0]
    per_instant = ticks_per_bin * bins_per_instant

    def grouped(x: Float[Array, "*s n"], size: int) -> Float[Array, "*s m"]:
        return x.reshape(*x.shape[:-1], -1, size).sum(axis=-1)

    all_bins = Switching(
        grouped(switching.weights, ticks_per_bin) / ticks_per_bin,
        grouped(switching.up, ticks_per_bin),
        grouped(switching.down, ticks_per_bin),
    )
    weights, up, down = (x[:, measured.felt_bins] for x in (all_bins.weights, all_bins.up, all_bins.down))

    def levels(curves: LadderCurves) -> Float[Array, "K n"]:
        return curves.levels(where)

    def mixed(curves: LadderCurves) -> Float[Array, " n"]:
        return jnp.sum(weights * levels(curves), axis=0)

    def total(per_bin: Float[Array, " n"]) -> Float[Array, ""]:
        return jnp.sum(per_bin) * ticks_per_bin

    done = blended_share(up, down, blend_s / (tick_s * ticks_per_bin), bins_per_instant)
    events = switch_events(
        instants, parameters, where, edge_mm, grouped(up, bins_per_instant), grouped(down, bins_per_instant), done,
        measured.perception, tick_s,
    )  # fmt: skip
    flow, tried = jnp.sum(events.flow), jnp.sum(events.flow * events.mapped)
    # A lost contact stays lost until the reference, too, leaves the surface.
    losing = jnp.clip(jnp.sum(events.flow * events.lost, axis=0), 0.0, 1.0)
    stays = jnp.where(instants.starts, 0.0, jnp.minimum(2 * instants.contact, 1.0))
    lost = affine_scan(stays * (1 - losing), losing)

    feel = measured.feel
    hand_mm_s = grouped(grouped(speed, ticks_per_bin)[measured.felt_bins], bins_per_instant) / per_instant
    caught = trapped(
        measured.traps, where, grouped(weights, bins_per_instant) / bins_per_instant, grouped(up, bins_per_instant),
        grouped(down, bins_per_instant), instants.starts,
    )  # fmt: skip
    felt_mix, force_mix = (
        mixed(own) + jnp.repeat(past, bins_per_instant)
        for own, past in zip((feel.felt, feel.force_sq), caught, strict=True)
    )
    either_mix = mixed(feel.either)
    either = jnp.maximum(total(either_mix), 1.0)
    both = jnp.maximum(total(mixed(feel.both)), 1.0)
    level_felt = ticks_per_bin * grouped(felt_mix, bins_per_instant)
    felt_at = level_felt + blend_square(events, instants.felt_per_n2, hand_mm_s, blend_s, tick_s)
    felt_at += lost * (per_instant * instants.lost_felt - level_felt)
    felt = jnp.sum(felt_at)
    force = total(force_mix) + jnp.sum(blend_square(events, 1.0, hand_mm_s, blend_s, tick_s))
    force += per_instant * jnp.sum(
        lost * (instants.lost_force_sq - grouped(force_mix, bins_per_instant) / bins_per_instant)
    )
    band = total(mixed(feel.band_sq)) + blend_band_square(events, blend_s, measured.perception, tick_s)

    log_reach = jnp.maximum(parameters.log_l_in, parameters.log_l_out)
    costs, samples, windows = tick_costs(
        measured.cost, where, parameters.log_cell_edges, all_bins, log_reach, parameters.log_triangles,
        parameters.reachable_log_speeds,
    )  # fmt: skip
    spread = measured.cost.spread
    shares = jnp.clip(weights, 0.0, None)
    peaks, depths = levels(feel.peak_n).reshape(-1), levels(feel.depth_mm).reshape(-1)
    erring = (shares * jnp.clip(levels(feel.either), 0.0, 1.0)).reshape(-1)
    touching = (shares * jnp.clip(levels(feel.contact), 0.0, 1.0)).reshape(-1)
    jumps, flows = events.jump_n.reshape(-1), events.flow.reshape(-1)
    # Nothing to switch between: a jump of 0, and every mapping that was not tried found the surface.
    switched, some = jnp.maximum(flow, 1e-6), flow / (flow + 1e-3)
    work = jax.ops.segment_sum(mixed(feel.work_mj) * ticks_per_bin, measured.cycle, measured.cycles)[1:]
    cycles = jax.ops.segment_sum(jnp.ones_like(weights[0]), measured.cycle, measured.cycles)[1:]
    work = jnp.where(cycles > 0, work, -1e3)
    # Widths are the ladder's, not the configuration's: they are not differentiated.
    peak_width = 0.02 * jnp.max(feel.peak_n.nodes[0]) + 1e-4
    depth_width, jump_width = 0.01 * jnp.max(feel.depth_mm.nodes[0]) + 1e-6, 0.005
    last_jump = 1 - 0.5 / jnp.maximum(switched, 1.0)
    # p99.9 apart from the others: the optimiser asks for no other, and what nobody asks for is not computed.
    limit_us = costs.quantiles_us((0.999,), spread)[0]
    cost_us = costs.quantiles_us((0.5, 0.99, 1 - 0.5 / measured.ticks), spread)
    peak_n = smooth_quantiles(peaks, erring, (0.99, 1 - 0.5 / measured.bins), peak_width)
    jump_n = some * smooth_quantiles(jumps, flows, (0.5, 0.99, last_jump), jump_width)

    motion = jnp.clip(jnp.cumsum(instants.starts) - 1, 0, motions - 1)
    each = lambda at: jax.ops.segment_sum(at, motion, motions)
    either_each = jnp.maximum(each(ticks_per_bin * grouped(either_mix, bins_per_instant)), 1.0)
    members = Members(
        felt_error_jnd=jnp.sqrt(jnp.maximum(each(felt_at), 0.0) / either_each + 1e-14),
        discontinuity_per_s=each(jnp.sum(events.flow * events.noticed, axis=0)) / (either_each * tick_s),
    )

    metrics = {
        "loop_cost_mean_us": costs.mean_us(),
        "loop_cost_p50_us": cost_us[0],
        "loop_cost_p99_us": cost_us[1],
        "loop_cost_p999_us": limit_us,
        "loop_cost_max_us": cost_us[2],
        "deadline_miss_rate": costs.share_over(budget_us, spread),
        "longest_miss_run": longest_run(samples, windows, measured.cost, measured.ticks // windows.shape[1], budget_us),
        "force_error_rms_n": jnp.sqrt(jnp.maximum(force, 0.0) / either + 1e-14),
        "force_error_p99_n": peak_n[0],
        "force_error_max_n": peak_n[1],
        "felt_error_jnd": jnp.sqrt(jnp.maximum(felt, 0.0) / either + 1e-14),
        "switch_jump_p50_n": jump_n[0],
        "switch_jump_p99_n": jump_n[1],
        "switch_jump_max_n": jump_n[2],
        "discontinuity_per_s": jnp.sum(events.flow * events.noticed) / (either * tick_s),
        "facet_vibration_n": jnp.sqrt(jnp.maximum(band, 0.0) / both + 1e-14),
        "switches_per_s": switching.switches / measured.seconds,
        "mapping_hit_rate": 1 - jnp.sum(events.flow * events.lost) / jnp.maximum(tried, 1e-6),
        "false_release_per_min": (total(mixed(feel.release)) + jnp.sum(losing)) * 60 / measured.felt_seconds,
        "pop_through_per_min": total(mixed(feel.pop)) * 60 / measured.felt_seconds,
        "penetration_p99_mm": smooth_quantile(depths, touching, 0.99, depth_width),
        "energy_out_mj": jnp.where(jnp.any(cycles > 0), smooth_max(work, 0.02), 0.0),
        "memory_mb": memory_mb(measured, parameters),
    }
    return metrics, members
