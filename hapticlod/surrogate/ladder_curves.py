"""Per-rung quantities as smooth functions of log N (and of the number of tool balls).

The ladder is measured at R rungs and B nested subsets of the tool's balls. In between, per-tick quantities follow
monotone cubic Hermite curves (PCHIP: Fritsch & Butland 1984, as scipy's PchipInterpolator) in coarseness
c = ln(N_0 / N), and straight lines in ln P. Slopes are computed once; what depends on a configuration is then a small
matrix of weights, the same for every quantity, and a look-up is one matrix product: quick to compile and to
differentiate.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray


def pchip_slopes(knots: NDArray, values: NDArray) -> NDArray:
    """Slopes of the monotone cubic through (knots, values) along axis 0. Host side, once per ladder.

    **Arguments:**

    - `knots`: (R,), increasing.
    - `values`: (R, ...).

    **Returns:** (R, ...); all zero for one rung.
    """
    if len(knots) == 1:
        return np.zeros_like(values)
    shape = (-1,) + (1,) * (values.ndim - 1)
    width = np.diff(knots).reshape(shape)
    secant = np.diff(values, axis=0) / width
    if len(knots) == 2:
        return np.concatenate([secant, secant])
    before, after = width[:-1], width[1:]
    weight = (before + 2 * after) / (3 * (before + after))
    left, right = secant[:-1], secant[1:]
    blend = weight * right + (1 - weight) * left
    inner = np.where(left * right > 0, left * right / np.where(blend == 0, 1, blend), 0.0)

    def end(near_width, far_width, near, far):
        slope = ((2 * near_width + far_width) * near - near_width * far) / (near_width + far_width)
        slope = np.where(slope * near <= 0, 0.0, slope)
        return np.where((near * far <= 0) & (np.abs(slope) > 3 * np.abs(near)), 3 * near, slope)

    first = end(width[0], width[1], secant[0], secant[1])
    last = end(width[-1], width[-2], secant[-1], secant[-2])
    return np.concatenate([first[None], inner, last[None]])


def _interval(knots: Float[Array, " n"], x: Float[Array, " K"]):
    """One-hot interval (K, n - 1), place in it (K, 1) and width (K, 1); outside the knots the nearest end."""
    # On an end knot the slope is that inside: of two equal values a `clip` would pass on half of it to either.
    x = jnp.where(x < knots[0], knots[0], jnp.where(x > knots[-1], knots[-1], x))[:, None]
    index = jnp.sum(x >= knots[None, 1:-1], axis=1, keepdims=True)
    chosen = jnp.where(jnp.arange(knots.shape[0] - 1) == index, 1.0, 0.0).astype(knots.dtype)
    width = chosen @ jnp.diff(knots)[:, None]
    return chosen, (x - chosen @ knots[:-1, None]) / width, width


def _spread(chosen: Float[Array, "K m"], left: Float[Array, "K 1"], right: Float[Array, "K 1"]) -> Float[Array, "K n"]:
    """Weights of an interval's two ends as weights of all knots."""
    return jnp.pad(chosen * left, ((0, 0), (0, 1))) + jnp.pad(chosen * right, ((0, 0), (1, 0)))


def ends_weights(knots: Float[Array, " n"], x: Float[Array, " K"]) -> Float[Array, "K 2 n"]:
    """One-hot weights of the knots left and right of x, times how near x is to each: they sum to 1."""
    if knots.shape[0] == 1:
        return jnp.ones((x.shape[0], 2, 1), knots.dtype) * jnp.array([1.0, 0.0])[None, :, None]
    chosen, place, _ = _interval(knots, x)
    zero = jnp.zeros_like(place)
    return jnp.stack([_spread(chosen, 1 - place, zero), _spread(chosen, zero, place)], axis=1)


def linear_weights(knots: Float[Array, " n"], x: Float[Array, " K"]) -> Float[Array, "K n"]:
    """Weights of straight-line interpolation."""
    return jnp.sum(ends_weights(knots, x), axis=1)


def cubic_weights(knots: Float[Array, " n"], x: Float[Array, " K"]) -> Float[Array, "K 2 n"]:
    """Weights of cubic Hermite interpolation, of values [:, 0] and of slopes [:, 1]."""
    if knots.shape[0] == 1:
        ones = jnp.ones((x.shape[0], 1), knots.dtype)
        return jnp.stack([ones, 0 * ones], axis=1)
    chosen, t, width = _interval(knots, x)
    square, cube = t * t, t * t * t
    rise = 3 * square - 2 * cube
    values = _spread(chosen, 1 - rise, rise)
    slopes = _spread(chosen, width * (cube - 2 * square + t), width * (cube - square))
    return jnp.stack([values, slopes], axis=1)


class LadderCurves(eqx.Module):
    """A quantity measured on R rungs x B ball subsets, with any trailing shape: values [0] and slopes [1]."""

    nodes: Float[Array, "2 R B *trailing"]

    def levels(self, places: Places) -> Float[Array, "K *trailing"]:
        """The quantity at each level's place."""
        return jnp.tensordot(places.cubic, self.nodes, axes=3)


class Places(eqx.Module):
    """Where K levels lie on the measured ladder, as weights.

    - `cubic`: (K, 2, R, B) for `LadderCurves`.
    - `ends`: (K, 2, R, B): the measured rung on either side, times its share; balls interpolated.
    - `linear`: (K, R, B).
    - `shares`: (K, 2) of the two rungs.
    """

    cubic: Float[Array, "K 2 R B"]
    ends: Float[Array, "K 2 R B"]
    linear: Float[Array, "K R B"]
    shares: Float[Array, "K 2"]


def places(
    coarseness: Float[Array, " R"],
    thinness: Float[Array, " B"],
    level_coarseness: Float[Array, " K"],
    level_thinness: Float[Array, " K"],
) -> Places:
    """Weights of levels on a ladder with knots `coarseness` = ln(N_0 / N) and `thinness` = ln(P_0 / P)."""
    balls = linear_weights(thinness, level_thinness)
    ends = ends_weights(coarseness, level_coarseness)
    cubic = cubic_weights(coarseness, level_coarseness)
    spread = lambda weights: weights[..., None] * balls[:, None, None, :]
    return Places(
        cubic=spread(cubic),
        ends=spread(ends),
        linear=jnp.sum(spread(ends), axis=1),
        shares=jnp.sum(ends, axis=2),
    )


def ladder_curves(coarseness: NDArray, values: NDArray) -> LadderCurves:
    """Curves through measured values of shape (R, B, ...)."""
    return LadderCurves(jnp.asarray(np.stack([values, pchip_slopes(coarseness, values)])))
