"""Small convex quadratic programmes, solved by a primal-dual interior point method inside jit.

Source: Mehrotra's predictor-corrector (1992) as in Nocedal & Wright, Numerical Optimization (2006), algorithm 16.4.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class QuadraticSolution(eqx.Module):
    """What the programme gave.

    - `x`: the minimiser.
    - `multipliers`: one per row of `A x <= b`, at least 0.
    - `gap`: mean complementarity left; about 0 when solved.
    """

    x: Float[Array, " n"]
    multipliers: Float[Array, " rows"]
    gap: Float[Array, ""]


def _longest_step(value: Float[Array, " rows"], direction: Float[Array, " rows"]) -> Float[Array, ""]:
    blocking = direction < 0
    ratio = jnp.where(blocking, -value / jnp.where(blocking, direction, -1.0), jnp.inf)
    return jnp.minimum(1.0, jnp.min(ratio))


def solve_quadratic(
    hessian: Float[Array, "n n"],
    gradient: Float[Array, " n"],
    rows: Float[Array, "rows n"],
    limits: Float[Array, " rows"],
    steps: int = 24,
) -> QuadraticSolution:
    """Minimise 1/2 x'Hx + g'x subject to A x <= b.

    **Arguments:**

    - `hessian`: H, symmetric, positive semi-definite.
    - `gradient`: g.
    - `rows`, `limits`: A and b. The start x = 0 need not be feasible, but a feasible point must exist.
    - `steps`: interior point iterations; the loop has a fixed length so that it batches.
    """
    n, m = gradient.shape[0], limits.shape[0]
    dtype = gradient.dtype
    tiny = jnp.finfo(dtype).eps
    scale = jnp.maximum(1.0, jnp.max(jnp.abs(gradient)))
    slack = jnp.maximum(limits, 1e-2)
    state = (jnp.zeros(n, dtype), slack, scale * jnp.ones(m, dtype))

    def newton(_, state):
        x, slack, dual = state
        dual_residual = hessian @ x + gradient + rows.T @ dual
        primal_residual = rows @ x + slack - limits
        mean = slack @ dual / m
        weight = dual / slack
        matrix = hessian + rows.T @ (weight[:, None] * rows) + tiny * scale * jnp.eye(n, dtype=dtype)
        factor = jax.scipy.linalg.cho_factor(matrix)

        def direction(complementarity):
            right = -dual_residual + rows.T @ (complementarity / slack - weight * primal_residual)
            dx = jax.scipy.linalg.cho_solve(factor, right)
            ds = -primal_residual - rows @ dx
            return dx, ds, -(complementarity + dual * ds) / slack

        _, ds, dl = direction(slack * dual)
        reach = jnp.minimum(_longest_step(slack, ds), _longest_step(dual, dl))
        ahead = (slack + reach * ds) @ (dual + reach * dl) / m
        centre = (ahead / mean) ** 3 * mean
        dx, ds, dl = direction(slack * dual + ds * dl - centre)
        step = 0.995 * jnp.minimum(_longest_step(slack, ds), _longest_step(dual, dl))
        new = (x + step * dx, slack + step * ds, dual + step * dl)
        # At machine precision the factorisation breaks down: keep what we have.
        good = jnp.all(jnp.isfinite(dx)) & jnp.all(jnp.isfinite(dl)) & (mean > tiny * scale)
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), new, state)

    x, slack, dual = jax.lax.fori_loop(0, steps, newton, state)
    return QuadraticSolution(x, dual, slack @ dual / m)
