"""Errors that a level owes to its past, and how many ticks at that level share this past.

An SCP remembers: on one rung it is caught behind a thin wall, say, and stays so until the hand lets go; on that rung
alone, replayed from the beginning, the error lasts for hundreds of ticks. A station that came to the level later, from
another, was never caught. So what a rung's error exceeds that of a fresh arrival by counts only for the share of ticks
that have been at the level since it began.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hapticlod.surrogate.ladder_curves import Places
from hapticlod.surrogate.switching import affine_scan


class Traps(eqx.Module):
    """Of R rungs and B ball subsets at I instants.

    - `felt`, `force_sq`: (R, B, I) by how much the rung's own error exceeds a fresh arrival's; 0 where it does not.
      Means over the instant's ticks, units as in `Feel`.
    - `begins`: (R, B, I) instants at which such an excess begins.
    """

    felt: Float[Array, "R B I"]
    force_sq: Float[Array, "R B I"]
    begins: Bool[Array, "R B I"]


def trapped(
    traps: Traps,
    places: Places,
    weights: Float[Array, "K I"],
    up: Float[Array, "J I"],
    down: Float[Array, "J I"],
    starts: Bool[Array, " I"],
) -> tuple[Float[Array, " I"], Float[Array, " I"]]:
    """What traps add to `felt` and `force_sq`, means over each instant's ticks.

    **Arguments:**

    - `weights`: of the levels, mean over the instant.
    - `up`, `down`: flow i -> i + 1 and back, summed over the instant.
    - `starts`: instants that begin a motion.
    """
    none = jnp.zeros_like(up[:1])
    leaving = jnp.concatenate([up, none]) + jnp.concatenate([none, down])
    here = jnp.clip(weights, 0.0, None)
    before = jnp.concatenate([here[:, :1], here[:, :-1]], axis=1)
    stays = jnp.exp(-leaving / (before + 1e-6))
    # Once at the level, and since then: restarted with everyone who is there when an excess begins.
    begins = jnp.moveaxis(traps.begins | starts, 2, 0)[:, None]  # (I, 1, R, B)
    keep = jnp.where(begins, 0.0, stays.T[:, :, None, None])
    came = jnp.where(begins, here.T[:, :, None, None], 0.0)
    still = jnp.minimum(affine_scan(keep, came), here.T[:, :, None, None])  # (I, K, R, B)
    shares = jnp.einsum("krb,ikrb->rbi", places.linear, still)
    return jnp.sum(shares * traps.felt, axis=(0, 1)), jnp.sum(shares * traps.force_sq, axis=(0, 1))
