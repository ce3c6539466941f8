"""Smooth quantiles of weighted samples.

`jnp.quantile` depends on two samples, so its gradient says little; here every sample counts through a sigmoid, and the
derivative is that of the implicit equation (one Newton step at the solution), whatever found the root.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def smooth_quantile(
    values: Float[Array, " n"],
    weights: Float[Array, " n"],
    probability: Float[Array, ""] | float,
    width: Float[Array, ""] | float,
) -> Float[Array, ""]:
    """q with sum w sigmoid((q - x) / width) = probability * sum w; also the quantile of x plus logistic noise.

    **Arguments:**

    - `values`: samples x, finite.
    - `weights`: at least 0; where all are 0 the result is the smallest sample.
    - `probability`: between 0 and 1.
    - `width`: scale of the sigmoid, in the unit of x. Not differentiated.
    """
    width = jax.lax.stop_gradient(jnp.asarray(width, values.dtype))
    total = jnp.sum(weights)

    def excess(q, x, w):
        """Weight above q, less what the quantile leaves there."""
        return jnp.sum(w * jax.nn.sigmoid((x - q) / width)) - (1 - probability) * jnp.sum(w)

    fixed, fixed_weights = jax.lax.stop_gradient((values, weights))
    start = jnp.min(fixed) - 40 * width, jnp.max(fixed) + 40 * width

    def halve_hard(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        above = jnp.sum(jnp.where(fixed > middle, fixed_weights, 0.0)) > (1 - probability) * jnp.sum(fixed_weights)
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    low, high = jax.lax.fori_loop(0, 14, halve_hard, start)

    def newton(_, state):
        q, low, high = state
        share = jax.nn.sigmoid((fixed - q) / width)
        over = jnp.sum(fixed_weights * share) - (1 - probability) * jnp.sum(fixed_weights)
        slope = -jnp.sum(fixed_weights * share * (1 - share)) / width
        low, high = jnp.where(over > 0, q, low), jnp.where(over > 0, high, q)
        step = q - over / jnp.where(slope == 0, -1.0, slope)
        inside = (step >= low) & (step <= high) & (slope != 0)
        return jnp.where(inside, step, 0.5 * (low + high)), low, high

    # Smoothing moves the root by some widths: reopen the bracket before polishing.
    span = (jnp.minimum(low, high) - 12 * width, jnp.maximum(low, high) + 12 * width)
    root, _, _ = jax.lax.fori_loop(0, 8, newton, (0.5 * (low + high), *span))
    root = jax.lax.stop_gradient(root)
    share = jax.nn.sigmoid((fixed - root) / width)
    slope = jnp.sum(fixed_weights * share * (1 - share)) / width
    usable = (total > 0) & (slope > 0)
    # First order in the samples and weights; zero in value.
    change = excess(root, values, weights)
    moved = root + (change - jax.lax.stop_gradient(change)) / jnp.where(usable, slope, 1.0)
    return jnp.where(usable, moved, jnp.min(fixed))


def smooth_quantiles(
    values: Float[Array, " n"],
    weights: Float[Array, " n"],
    probabilities: Sequence[Float[Array, ""] | float],
    width: Float[Array, ""] | float,
) -> Float[Array, " q"]:
    """Several of them at once: one piece of compiled code for all."""
    wanted = jnp.stack([jnp.asarray(p, values.dtype) for p in probabilities])
    return jax.vmap(lambda p: smooth_quantile(values, weights, p, width))(wanted)


def smooth_max(values: Float[Array, " n"], width: Float[Array, ""] | float) -> Float[Array, ""]:
    """Largest value, softened over `width`: between max and max + width ln n."""
    return width * jax.nn.logsumexp(values / width)
