"""Per-rung quantities as smooth functions of log N (and of the number of tool balls).

The ladder is measured at R rungs and B nested subsets of the tool's balls. In between, per-tick quantities follow
monotone cubic Hermite curves (PCHIP: Fritsch & Butland 1984, as scipy's PchipInterpolator) in coarseness
c = ln(N_0 / N), and straight lines in ln P. Slopes are computed once, so that a look-up gathers two rungs and the
derivative with respect to c needs no scatter.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
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


class Position(eqx.Module):
    """Where between two knots a coordinate lies.

    - `index`: left knot.
    - `fraction`: 0 at the left knot, 1 at the right one.
    - `width`: distance between the two (1 where there is only one knot).
    """

    index: Int[Array, "*shape"]
    fraction: Float[Array, "*shape"]
    width: Float[Array, "*shape"]


def locate(knots: Float[Array, " n"], x: Float[Array, "*shape"]) -> Position:
    """Finds x among increasing knots; outside them the nearest end is used."""
    count = knots.shape[0]
    if count == 1:
        return Position(jnp.zeros(jnp.shape(x), int), jnp.zeros_like(x), jnp.ones_like(x))
    x = jnp.clip(x, knots[0], knots[-1])
    index = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, count - 2)
    width = knots[index + 1] - knots[index]
    return Position(index, (x - knots[index]) / width, width)


def right_of(position: Position, count: int) -> Int[Array, "*shape"]:
    """Index of the right knot (the same one where there is only one)."""
    return jnp.minimum(position.index + 1, count - 1)


def hermite(
    left: Float[Array, " *s"], right: Float[Array, " *s"], left_slope: Float[Array, " *s"],
    right_slope: Float[Array, " *s"], fraction: Float[Array, ""], width: Float[Array, ""],
) -> Float[Array, " *s"]:  # fmt: skip
    """The cubic with these ends and slopes."""
    t = fraction
    square, cube = t * t, t * t * t
    rise = 3 * square - 2 * cube
    return (
        (1 - rise) * left
        + rise * right
        + width * ((cube - 2 * square + t) * left_slope + (cube - square) * right_slope)
    )


class LadderCurves(eqx.Module):
    """Quantities measured on R rungs x B ball subsets, any trailing shape.

    - `coarseness`: (R,) ln(N_0 / N), increasing from 0.
    - `thinness`: (B,) ln(P_0 / P), increasing from 0.
    - `values`, `slopes`: (R, B, ...).
    """

    coarseness: Float[Array, " R"]
    thinness: Float[Array, " B"]
    values: Float[Array, "R B *trailing"]
    slopes: Float[Array, "R B *trailing"]

    def at(self, rung: Position, subset: Position) -> Float[Array, "*trailing"]:
        """The quantity at one level's place on the ladder (scalar positions)."""
        low, high = rung.index, right_of(rung, self.values.shape[0])
        thin, thinner = subset.index, right_of(subset, self.values.shape[1])

        def curve(column):
            ends = self.values[low, column], self.values[high, column]
            slopes = self.slopes[low, column], self.slopes[high, column]
            return hermite(*ends, *slopes, rung.fraction, rung.width)

        if self.values.shape[1] == 1:
            return curve(thin)
        return (1 - subset.fraction) * curve(thin) + subset.fraction * curve(thinner)

    def levels(self, rungs: Position, subsets: Position) -> Float[Array, "K *trailing"]:
        """`at` for K levels."""
        return jax.vmap(self.at)(rungs, subsets)


def ladder_curves(coarseness: NDArray, thinness: NDArray, values: NDArray) -> LadderCurves:
    """Curves through measured values of shape (R, B, ...)."""
    slopes = pchip_slopes(coarseness, values)
    return LadderCurves(jnp.asarray(coarseness), jnp.asarray(thinness), jnp.asarray(values), jnp.asarray(slopes))
