"""What switches do to the feel: the force they jump by, the error they leave behind, the contact they lose.

Formulas: PERCEPTION.md sections 1 and 2. A switch from level i to j moves the contact by d = SCP_j - SCP_i (kept here
as a force, k d). If the mapping finds the new surface the force jumps by k d, or ramps over the blend time; if not,
contact is lost until the hand leaves the surface.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapticlod.perception import Perception
from hapticlod.surrogate.ladder_curves import Places, linear_weights
from hapticlod.surrogate.measurement import Instants
from hapticlod.surrogate.parameters import Parameters
from hapticlod.surrogate.switching import affine_scan

# Softness of yes-or-no questions about lengths, as a share of the length.
_SOFT_SHARE = 0.05


class Switches(eqx.Module):
    """Every kind of switch at every instant, as a weighted set of events.

    - `flow`: (E, I) expected switches with contact before or after; E runs over direction, pair of levels, and
      measured rung pair.
    - `mapped`: (E, I) share of them that had contact before: these are mapped.
    - `jump_n`: (E, I) the metric's jump: how much more the force changes in one tick than the reference's.
    - `noticed`: (E, I) probability that it is noticed.
    - `distance_sq`: (E, I) |k d|^2, N^2; 0 where contact ends or begins with the switch.
    - `cross`: (E, I) e_j . (e_i - e_j), N^2: what the fading offset adds to the new level's own error.
    - `lost`: (E, I) probability that a mapping finds nothing.
    - `entered_edge_mm`: (E, 1) mean edge of the level entered.
    - `done`: (E, I) share of a blend that is done when the next switch comes.
    """

    flow: Float[Array, "E I"]
    mapped: Float[Array, "E I"]
    jump_n: Float[Array, "E I"]
    noticed: Float[Array, "E I"]
    distance_sq: Float[Array, "E I"]
    cross: Float[Array, "E I"]
    lost: Float[Array, "E I"]
    entered_edge_mm: Float[Array, "E 1"]
    done: Float[Array, "E I"]


def _norm(vector: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    return jnp.sqrt(jnp.sum(vector**2, axis=-1) + 1e-16)


def switch_events(
    instants: Instants,
    parameters: Parameters,
    places: Places,
    edge_mm: Float[Array, " K"],
    up: Float[Array, "J I"],
    down: Float[Array, "J I"],
    done: Float[Array, "2 J I"],
    perception: Perception,
    tick_s: float,
) -> Switches:
    """Events of all pairs of neighbouring levels.

    Between two measured rungs a level is one or the other, with probability: what a switch does is not linear in the
    offset, and the mean of two unlike surfaces would be smoother than either. So E runs over (direction, pair of
    levels, rung of the finer level, rung of the coarser).

    **Arguments:**

    - `up`, `down`: flow i -> i + 1 and back, summed over each instant's bins.
    - `done`: of `blended_share`.
    """
    l_in, l_out = jnp.exp(parameters.log_l_in), jnp.exp(parameters.log_l_out)
    blend_ticks = parameters.blend_s / tick_s
    ramp_ticks = (1.0 + blend_ticks**4) ** 0.25
    left = 1 / (2 - done)
    # Along ticks, not their logarithm: the chance of a rare snap grows with the ticks that are watched.
    window = linear_weights(instants.windows, (blend_ticks * done).reshape(-1))
    window = window.reshape(*done.shape, -1)  # (2, J, I, W)
    whole = places.ends / jnp.maximum(places.shares, 1e-12)[:, :, None, None]
    offset = jnp.tensordot(whole, instants.offset_n, axes=2)  # (K, 2, I, 3)
    gap = jnp.tensordot(whole, instants.gap_mm, axes=2)  # (K, 2, I)
    held = jnp.tensordot(whole, instants.held, axes=2)
    rough, rough_noticed = (
        jnp.tensordot(whole, x, axes=2) for x in (instants.rough_n, instants.rough_noticed)
    )  # (K, 2, W, I)

    finer, coarser = (slice(None, -1), slice(None), None), (slice(1, None), None, slice(None))
    fine, coarse = jnp.broadcast_arrays(offset[finer], offset[coarser])  # (J, 2, 2, I, 3)
    entered = lambda x: jnp.stack(jnp.broadcast_arrays(x[coarser], x[finer]))
    outward_mm = (gap[coarser] - gap[finer]) * jnp.array([1.0, -1.0]).reshape(2, 1, 1, 1, 1)
    old, new = jnp.stack([fine, coarse]), jnp.stack([coarse, fine])
    rough, rough_noticed = (
        jnp.einsum("djiw,djabwi->djabi", window, jnp.stack(jnp.broadcast_arrays(x[coarser], x[finer])))
        for x in (rough, rough_noticed)
    )
    held_new = entered(held)
    held_old = jnp.flip(held_new, axis=0)
    either, both = held_old + held_new - held_old * held_new, held_old * held_new
    edge = jnp.stack([edge_mm[1:], edge_mm[:-1]])
    share = places.shares[finer] * places.shares[coarser]  # (J, 2, 2)
    flow = jnp.stack([up, down])[:, :, None, None] * share[..., None] * either

    def inside(length, limit):
        return jax.nn.sigmoid((limit - length) / (_SOFT_SHARE * limit))

    moved, force = new - old, instants.force_n + old
    size, reference = _norm(force), _norm(instants.step_n)
    found = inside(outward_mm, l_out) * inside(-outward_mm, l_in)
    mapped = held_old / jnp.maximum(either, 1e-9)
    lost = both * (1 - found) * (1 - inside(jnp.abs(outward_mm), jnp.maximum(l_in, l_out)))
    ramp = jnp.maximum(_norm(moved * (left[:, :, None, None, :, None] / ramp_ticks) + instants.step_n) - reference, 0.0)
    # The jump is the largest change until the blend ends: its own ramp, or the new level's facets. Whether either is
    # noticed is interpolated as a probability: facets snap seldom, and the mean of nothing and a snap is neither.
    # Where contact ends or begins with the switch nothing is blended.
    whole_step = jnp.maximum(_norm(moved + instants.step_n) - reference, 0.0)
    gone = lost * jnp.maximum(size - reference, 0.0) + (1 - lost) * whole_step
    blended = both * (1 - lost)
    jump = blended * jnp.sqrt(ramp**2 + rough**2 + 1e-16) + (1 - blended) * gone
    jnd = perception.jnd_n(_norm(instants.force_n))
    unnoticed = (1 - perception.noticed(ramp / jnd)) * (1 - rough_noticed)
    noticed = blended * (1 - unnoticed) + (1 - blended) * perception.noticed(gone / jnd)
    distance_sq = jnp.sum(moved**2, axis=-1) * blended
    cross = -jnp.sum(new * moved, axis=-1) * blended
    events = [x.reshape(-1, x.shape[-1]) for x in (flow, mapped, jump, noticed, distance_sq, cross, lost)]
    done_each = jnp.broadcast_to(done[:, :, None, None], flow.shape).reshape(-1, flow.shape[-1])
    entered_edge = jnp.broadcast_to(edge[:, :, None, None], flow.shape[:-1]).reshape(-1, 1)
    return Switches(*events, entered_edge, done_each)  # pyright: ignore[reportCallIssue] - seven, listed above


def blended_share(
    up: Float[Array, "J n"], down: Float[Array, "J n"], blend_bins: Float[Array, ""], bins_per_instant: int
) -> Float[Array, "2 J I"]:
    """How much of a blend is done when the next switch comes, in expectation: 1 where switches are rare.

    After a switch the next is one back, or one of another pair of levels; the flow of those ahead, fading over a
    blend, is how many come before the blend ends. Where they come quickly, back and forth, an offset o is left to its
    share s, and the next switch begins from there: o' = 1 - o (1 - s), of the distance between levels. In the mean
    o = 1 / (2 - s): half of the distance in a chatter.

    **Arguments:**

    - `up`, `down`: flow in each bin.
    - `blend_bins`: the blend's length.
    """
    own = jnp.stack([up, down])
    other = jnp.sum(own, axis=(0, 1)) - own
    keep = jnp.broadcast_to(jnp.exp(-1 / blend_bins), other.shape)
    ahead = affine_scan(jnp.moveaxis(keep, -1, 0), jnp.moveaxis(jnp.flip(keep * other, axis=-1), -1, 0))
    ahead = jnp.flip(jnp.moveaxis(ahead, 0, -1), axis=-1)
    load = jnp.concatenate([ahead[..., 1:], jnp.zeros_like(ahead[..., :1])], axis=-1) + 0.5 * other
    load = 2 * load  # of a chatter's switches every second is of the other kind, and the first of all counts
    share = -jnp.expm1(-load - 1e-6) / (load + 1e-6)
    grouped = lambda x: x.reshape(*x.shape[:-1], -1, bins_per_instant).sum(axis=-1)
    return (grouped(own * share) + 1e-9) / (grouped(own) + 1e-9)


def blend_square(
    switches: Switches,
    weight: Float[Array, " I"] | float,
    speed_mm_s: Float[Array, " I"],
    blend_s: Float[Array, ""],
    tick_s: float,
) -> Float[Array, " I"]:
    """What fading offsets add to the sum over ticks of weight |F - R|^2, at each instant.

    The offset fades linearly: its square sums to a third of the blend's ticks, its product with the new level's error
    to the blend's ticks (half, twice) while that error stays what it was, which it does for about one edge of travel.
    Both end early where the next switch does not wait.
    """
    ticks, done = blend_s / tick_s, switches.done
    left = 1 / (2 - done)
    kept = 1 / (1 + speed_mm_s * blend_s / switches.entered_edge_mm)
    own = switches.distance_sq * left**2 * (1 - (1 - done) ** 3) * ticks / 3
    added = own + switches.cross * left * (1 - (1 - done) ** 2) * kept * ticks
    return jnp.sum(switches.flow * weight * added, axis=0)


def blend_band_square(
    switches: Switches, blend_s: Float[Array, ""], perception: Perception, tick_s: float
) -> Float[Array, ""]:
    """What steps of k d (or ramps, when blended) add to the sum over ticks of the squared band-passed force.

    A unit step has the spectrum 1 / (2 pi f); a ramp of tau multiplies it by sinc(f tau).
    """
    high = min(perception.vibration_high_hz, 0.5 / tick_s)
    low = min(perception.vibration_low_hz, high)
    edges = jnp.geomspace(low, high, 65)
    middle, width = jnp.sqrt(edges[1:] * edges[:-1]), jnp.diff(edges)
    per_step = jnp.sum(2 * width * jnp.sinc(middle * blend_s) ** 2 / (2 * jnp.pi * middle) ** 2) / tick_s
    return per_step * jnp.sum(switches.flow * switches.distance_sq * (2 - switches.done) ** -2.0)
