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

# Softness of yes-or-no questions about lengths, as a share of the length.
_SOFT_SHARE = 0.05


class Switches(eqx.Module):
    """Every kind of switch at every instant, as a weighted set of events.

    - `flow`: (E, I) expected switches in contact; E runs over direction, pair of levels, and measured rung pair.
    - `jump_n`: (E, I) the metric's jump: how much more the force changes in one tick than the reference's.
    - `distance_sq`: (E, I) |k d|^2, N^2; 0 where contact is lost.
    - `cross`: (E, I) e_j . (e_i - e_j), N^2: what the fading offset adds to the new level's own error.
    - `lost`: (E, I) probability that contact is lost.
    - `entered_edge_mm`: (E, 1) mean edge of the level entered.
    """

    flow: Float[Array, "E I"]
    jump_n: Float[Array, "E I"]
    distance_sq: Float[Array, "E I"]
    cross: Float[Array, "E I"]
    lost: Float[Array, "E I"]
    entered_edge_mm: Float[Array, "E 1"]


def _norm(vector: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    return jnp.sqrt(jnp.sum(vector**2, axis=-1) + 1e-16)


def switch_events(
    instants: Instants,
    parameters: Parameters,
    places: Places,
    edge_mm: Float[Array, " K"],
    up: Float[Array, "J I"],
    down: Float[Array, "J I"],
    tick_s: float,
) -> Switches:
    """Events of all pairs of neighbouring levels.

    Between two measured rungs a level is one or the other, with probability: what a switch does is not linear in the
    offset, and the mean of two unlike surfaces would be smoother than either. So E runs over (direction, pair of
    levels, rung of the finer level, rung of the coarser).

    **Arguments:**

    - `up`, `down`: flow i -> i + 1 and back, summed over each instant's bins.
    """
    l_in, l_out = jnp.exp(parameters.log_l_in), jnp.exp(parameters.log_l_out)
    blend_ticks = parameters.blend_s / tick_s
    ramp_ticks = jnp.sqrt(1.0 + blend_ticks**2)
    window = linear_weights(instants.log_windows, jnp.log1p(blend_ticks)[None])[0]
    whole = places.ends / jnp.maximum(places.shares, 1e-12)[:, :, None, None]
    offset = jnp.tensordot(whole, instants.offset_n, axes=2)  # (K, 2, I, 3)
    gap = jnp.tensordot(whole, instants.gap_mm, axes=2)  # (K, 2, I)
    rough = jnp.tensordot(whole, jnp.tensordot(window, instants.rough_n, axes=(0, 2)), axes=2)  # (K, 2, I)

    finer, coarser = (slice(None, -1), slice(None), None), (slice(1, None), None, slice(None))
    fine, coarse = jnp.broadcast_arrays(offset[finer], offset[coarser])  # (J, 2, 2, I, 3)
    fine_rough, coarse_rough = jnp.broadcast_arrays(rough[finer], rough[coarser])
    outward_mm = (gap[coarser] - gap[finer]) * jnp.array([1.0, -1.0]).reshape(2, 1, 1, 1, 1)
    old, new = jnp.stack([fine, coarse]), jnp.stack([coarse, fine])
    rough = jnp.stack([coarse_rough, fine_rough])
    edge = jnp.stack([edge_mm[1:], edge_mm[:-1]])
    share = places.shares[finer] * places.shares[coarser]  # (J, 2, 2)
    flow = jnp.stack([up, down])[:, :, None, None] * share[..., None] * instants.contact

    def inside(length, limit):
        return jax.nn.sigmoid((limit - length) / (_SOFT_SHARE * limit))

    moved, force = new - old, instants.force_n + old
    size, reference = _norm(force), _norm(instants.step_n)
    found = inside(outward_mm, l_out) * inside(-outward_mm, l_in)
    lost = (1 - found) * (1 - inside(jnp.abs(outward_mm), jnp.maximum(l_in, l_out)))
    ramp = jnp.maximum(_norm(moved / ramp_ticks + instants.step_n) - reference, 0.0)
    # The jump is the largest change until the blend ends: its own ramp, or the new level's facets.
    ramp = jnp.sqrt(ramp**2 + rough**2 + 1e-16)
    jump = (1 - lost) * ramp + lost * jnp.maximum(size - reference, 0.0)
    distance_sq = jnp.sum(moved**2, axis=-1) * (1 - lost)
    cross = -jnp.sum(new * moved, axis=-1) * (1 - lost)
    events = [x.reshape(-1, x.shape[-1]) for x in (flow, jump, distance_sq, cross, lost)]
    entered = jnp.broadcast_to(edge[:, :, None, None], flow.shape[:-1]).reshape(-1, 1)
    return Switches(*events, entered)


def noticed_switches(switches: Switches, instants: Instants, perception: Perception) -> Float[Array, ""]:
    """Expected number of switches whose jump is noticed."""
    jnd = perception.jnd_n(_norm(instants.force_n))
    return jnp.sum(switches.flow * perception.noticed(switches.jump_n / jnd))


def blend_square(
    switches: Switches,
    weight: Float[Array, " I"] | float,
    speed_mm_s: Float[Array, " I"],
    blend_s: Float[Array, ""],
    tick_s: float,
) -> Float[Array, ""]:
    """What fading offsets add to the sum over ticks of weight |F - R|^2.

    The offset fades linearly: its square sums to a third of the blend's ticks, its product with the new level's error
    to the blend's ticks (half, twice) while that error stays what it was, which it does for about one edge of travel.
    """
    ticks = blend_s / tick_s
    kept = 1 / (1 + speed_mm_s * blend_s / switches.entered_edge_mm)
    added = switches.distance_sq * ticks / 3 + switches.cross * kept * ticks
    return jnp.sum(switches.flow * weight * added)


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
    return per_step * jnp.sum(switches.flow * switches.distance_sq)
