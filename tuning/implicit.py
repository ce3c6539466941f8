"""How an optimum answers when a limit moves: the conditions of optimality, differentiated implicitly.

Source: Fiacco, Introduction to Sensitivity and Stability Analysis in Nonlinear Programming (1983), chapter 3. At a
minimum of f with multipliers l of the constraints c that bind, grad f + C' l = 0 and c = 0; differentiated in p,

    [ H  C' ] [ dx ]     [ 0     ]
    [ C  0  ] [ dl ] = - [ dc/dp ],    df/dp = l' dc/dp,

where H is the Hessian of the Lagrangian. Levers that change nothing make the system singular: it is solved for the
shortest dx.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]
# (f's gradient (n,), excess (m,), its Jacobian (m, n)) at a point (n,).
Slopes = Callable[[Array], tuple[Array, Array, Array]]

# A linear row or bound with less room than this is taken to bind if its multiplier is positive.
_ROOM = 1e-4
# Of the step for differences of gradients: wide enough to see past the grain of a function that counts events.
_STEP = 3e-3
# A curvature below this part of the largest is taken for none: the optimum does not say how far to go along it.
_FLAT = 1e-3


@dataclass(frozen=True)
class Response:
    """How the optimum answers to q parameters.

    Attributes:
        x: (n, q) dx/dp.
        objective: (q,) df/dp.
        multipliers: (m,) of the excesses, at least 0; 0 where one does not bind.
        residual: largest entry of grad f + C' l over that of grad f: 0 at a minimum. Where it is not small, x was none;
            infinite where slopes at x or near it are not finite.
        violation: the largest excess; above 0 where x breaks a limit.
    """

    x: Array
    objective: Array
    multipliers: Array
    residual: float
    violation: float


def differentiate_optimum(
    slopes: Slopes,
    x: Array,
    shift: Array,
    *,
    linear: tuple[Array, Array] | None = None,
    moving: NDArray[np.bool_] | None = None,
    near: float = 1e-2,
    step: float = _STEP,
    many: Callable = map,
) -> Response:
    """Differentiates a minimum of f(x) subject to g(x, p) <= 0, A x <= b, 0 <= x <= 1.

    Args:
        slopes: gradients of f and g; second derivatives are differences of these.
        x: (n,) the minimum.
        shift: (m, q) dg/dp.
        linear: (A, b), shapes (r, n) and (r,).
        moving: (n,) coordinates that f and g depend on; the others stay.
        near: an excess above -near may bind.
        step: of central differences.
        many: maps a function over points, in order; may do so in parallel.
    """
    n, moves = len(x), np.ones(len(x), bool) if moving is None else moving
    gradient, excess, jacobian = slopes(x)
    nothing = Response(np.zeros((n, shift.shape[1])), np.zeros(shift.shape[1]), np.zeros(len(excess)), np.inf, np.inf)
    if not all(np.isfinite(part).all() for part in (gradient, excess, jacobian)):
        return nothing
    rows, room = _all_rows(x, linear)
    rows = rows[:, moves]
    candidates = np.flatnonzero((room <= _ROOM) & (np.abs(rows).sum(axis=1) > 0))
    tight = np.flatnonzero(excess >= -near)
    binding = np.concatenate([jacobian[np.ix_(tight, moves)], rows[candidates]])
    multipliers, _ = nnls(binding.T, -gradient[moves], maxiter=100 * n) if len(binding) else (np.zeros(0), 0.0)
    residual = np.abs(gradient[moves] + binding.T @ multipliers).max(initial=0.0)
    largest = np.abs(gradient[moves]).max(initial=0.0)
    weights = np.zeros(len(excess))
    weights[tight] = multipliers[: len(tight)]
    holds = multipliers > 1e-6 * max(largest, 1e-12)
    active = binding[holds]
    moved = np.zeros((len(tight) + len(candidates), shift.shape[1]))
    moved[: len(tight)] = shift[tight]

    dx = np.zeros((n, shift.shape[1]))
    if moved[holds].any():  # else no parameter reaches the optimum
        hessian = _hessian(slopes, x, weights, moves, active, step, many)
        if not np.isfinite(hessian).all():
            return nothing
        dx[moves] = _shortest(hessian, active, -moved[holds])
    return Response(dx, weights @ shift, weights, float(residual / max(largest, 1e-12)), float(excess.max()))


def _all_rows(x: Array, linear: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """Linear rows and bounds as one, and the room that each leaves."""
    eye = np.eye(len(x))
    rows, room = [eye, -eye], [1.0 - x, x]
    if linear is not None:
        rows.append(linear[0])
        room.append(linear[1] - linear[0] @ x)
    return np.concatenate(rows), np.concatenate(room)


def _hessian(
    slopes: Slopes, x: Array, weights: Array, moves: NDArray[np.bool_], active: Array, step: float, many: Callable
) -> Array:
    """Of the Lagrangian in the moving coordinates. Those that a bound holds are left out: nothing moves along them."""
    held = np.zeros(int(moves.sum()), bool)
    for row in active[np.count_nonzero(active, axis=1) == 1]:
        held |= row != 0
    indices = np.flatnonzero(moves)[~held]

    def column(i: int) -> Array:
        ends, places = [], (min(x[i] + step, 1.0), max(x[i] - step, 0.0))
        for place in places:
            point = x.copy()
            point[i] = place
            gradient, _, jacobian = slopes(point)
            ends.append(gradient + jacobian.T @ weights)
        return (ends[0] - ends[1]) / (places[0] - places[1])

    out = np.zeros((len(x), len(x)))
    for i, values in zip(indices, many(column, indices), strict=True):
        out[:, i] = values
    keep = np.ix_(indices, indices)
    even = np.zeros_like(out)
    even[keep] = 0.5 * (out[keep] + out[keep].T)
    return even[np.ix_(moves, moves)]


def _shortest(hessian: Array, active: Array, right: Array) -> Array:
    """(n, q) of H x + C' l = 0, C x = right: least squares, shortest; where curvature is not positive, x stays."""
    n, count = len(hessian), len(active)
    if n == 0 or right.shape[1] == 0:
        return np.zeros((n, right.shape[1]))
    # Along the constraints, curvature that is not positive is noise or a lever without effect.
    normal = np.linalg.pinv(active) @ active if count else np.zeros((n, n))
    along = np.eye(n) - normal
    values, vectors = np.linalg.eigh(along @ hessian @ along)
    solid = values > _FLAT * max(values.max(initial=0.0), 1e-12)
    curved = vectors * np.where(solid, values, 0.0) @ vectors.T
    cross = along @ hessian @ normal
    # A direction that was dropped must not be pushed along either: project the coupling on what is left.
    cross = (vectors[:, solid] @ vectors[:, solid].T) @ cross
    whole = np.block([[curved + cross, active.T], [active, np.zeros((count, count))]])
    with jax.enable_x64(True):
        operator = lx.MatrixLinearOperator(jnp.asarray(whole))
        solver = lx.AutoLinearSolver(well_posed=False)
        columns = [
            lx.linear_solve(operator, jnp.asarray(np.concatenate([np.zeros(n), column])), solver, throw=False).value
            for column in right.T
        ]
    return np.stack([np.asarray(column)[:n] for column in columns], axis=1)
