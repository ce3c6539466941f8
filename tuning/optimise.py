"""A minimiser with real constraints for optimistix: sequential l1 quadratic programming in a trust region.

Source: Fletcher, Practical Methods of Optimization (1987), section 14.4 (Sl1QP); damped BFGS: Powell 1978.
optimistix 0.1.0 has no bounds in `minimise`; a sigmoid reparametrisation sticks at saturated bounds. Here bounds and
linear inequalities hold at every iterate; nonlinear inequalities are driven to zero by an exact penalty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from tuning.quadratic import solve_quadratic


class _State(eqx.Module):
    value: Float[Array, ""]
    excess: Float[Array, " m"]
    gradient: Float[Array, " n"]
    jacobian: Float[Array, "m n"]
    hessian: Float[Array, "n n"]
    multipliers: Float[Array, " m"]
    penalty: Float[Array, ""]
    radius: Float[Array, ""]
    step: Float[Array, " n"]
    predicted: Float[Array, ""]
    best_y: Float[Array, " n"]
    best_merit: Float[Array, ""]
    first: Bool[Array, ""]
    steps: Int[Array, ""]
    done: Bool[Array, ""]
    result: optx.RESULTS


def _violation(excess: Float[Array, " m"]) -> Float[Array, ""]:
    return jnp.sum(jnp.maximum(excess, 0.0))


class SequentialQuadratic(optx.AbstractMinimiser):
    """Minimise fn(y) subject to g(y) <= 0, A y <= b and lower <= y <= upper.

    `fn(y, args)` returns `(f, g)` (use `has_aux=True`): f a scalar, g of shape (m,). `options` holds `lower` and
    `upper`, shape (n,), and optionally `linear = (A, b)`, shapes (p, n) and (p,), and `most_steps`, which ends the
    search as a success: unlike `max_steps` it may be traced, so that short and long searches share compiled code. y0
    must satisfy bounds and linear rows. Scale y so that bounds are about one apart, and f and g so that 1 is a large
    change. `options["cheap"] = (h, k)` adds constraints h(y, args) <= 0, shape (k,), that share nothing with fn: they
    follow those of fn in every array, and are differentiated apart, so that they cost no pass backwards through fn.

    The value returned is the best point met by exact-penalty merit; `aux` of the solution belongs to the last point
    tried, so evaluate g again where it matters. A step whose f or g is not finite is rejected and the region shrinks.
    """

    rtol: float = 1e-5
    atol: float = 1e-6
    norm: Callable[[PyTree], Array] = optx.max_norm
    radius: float = 0.25
    penalty: float = 10.0
    most_penalty: float = 1e5

    def init(self, fn, y, args, options: dict[str, Any], f_struct, aux_struct, tags) -> _State:
        n, m = y.shape[0], aux_struct.shape[0] + options.get("cheap", (None, 0))[1]
        zero = jnp.zeros((), y.dtype)
        return _State(
            value=zero,
            excess=jnp.zeros(m, y.dtype),
            gradient=jnp.zeros(n, y.dtype),
            jacobian=jnp.zeros((m, n), y.dtype),
            hessian=jnp.eye(n, dtype=y.dtype),
            multipliers=jnp.zeros(m, y.dtype),
            penalty=zero + self.penalty,
            radius=zero + self.radius,
            step=jnp.zeros(n, y.dtype),
            predicted=zero + 1.0,
            best_y=y,
            best_merit=zero + jnp.inf,
            first=jnp.array(True),
            steps=jnp.array(0),
            done=jnp.array(False),
            result=optx.RESULTS.successful,
        )

    def _subproblem(self, y, state: _State, options):
        """The step within the trust region, its multipliers and the decrease of the merit it promises."""
        n, m = y.shape[0], state.excess.shape[0]
        eye, none = jnp.eye(n, dtype=y.dtype), jnp.zeros((n, m), y.dtype)
        upper = jnp.minimum(options["upper"] - y, state.radius)
        lower = jnp.minimum(y - options["lower"], state.radius)
        elastic = jnp.eye(m, dtype=y.dtype)
        rows = [
            jnp.hstack([eye, none]),
            jnp.hstack([-eye, none]),
            jnp.hstack([state.jacobian, -elastic]),
            jnp.hstack([jnp.zeros((m, n), y.dtype), -elastic]),
        ]
        # A hair of room keeps the interior method interior where a bound is active.
        room = 10 * jnp.finfo(y.dtype).eps
        limits = [upper + room, lower + room, -state.excess, jnp.zeros(m, y.dtype)]
        if "linear" in options:
            matrix, bound = options["linear"]
            rows.append(jnp.hstack([matrix, jnp.zeros((matrix.shape[0], m), y.dtype)]))
            limits.append(bound - matrix @ y + room)
        hessian = jnp.zeros((n + m, n + m), y.dtype).at[:n, :n].set(state.hessian)
        gradient = jnp.concatenate([state.gradient, jnp.full(m, state.penalty)])
        solution = solve_quadratic(hessian, gradient, jnp.vstack(rows), jnp.concatenate(limits))
        step = jnp.clip(solution.x[:n], -lower, upper)
        multipliers = solution.multipliers[2 * n : 2 * n + m]
        model = state.gradient @ step + 0.5 * step @ state.hessian @ step
        promised = _violation(state.excess) - _violation(state.excess + state.jacobian @ step)
        return step, multipliers, state.penalty * promised - model, promised

    def step(self, fn, y, args, options: dict[str, Any], state: _State, tags):
        trial = jnp.clip(y + state.step, options["lower"], options["upper"])

        def both(point):
            value, excess = fn(point, args)
            return jnp.concatenate([value[None], excess])

        # Once forward, for value and slopes: what is compiled is half as large, and few steps are rejected.
        outcome, pull = jax.vjp(both, trial)
        cheap, _ = options.get("cheap", (lambda y, args: jnp.zeros(0, y.dtype), 0))
        value, excess = outcome[0], jnp.concatenate([outcome[1:], cheap(trial, args)])
        finite = jnp.isfinite(value) & jnp.all(jnp.isfinite(excess))
        merit = state.value + state.penalty * _violation(state.excess)
        trial_merit = value + state.penalty * _violation(excess)
        ratio = (merit - trial_merit) / jnp.maximum(state.predicted, jnp.finfo(y.dtype).tiny)
        accept = finite & (state.first | (ratio > 1e-4))
        size = self.norm(state.step)
        radius = jnp.where(ratio > 0.75, jnp.maximum(state.radius, 2.0 * size), state.radius)
        radius = jnp.where(ratio < 0.25, 0.4 * jnp.minimum(state.radius, size), radius)
        radius = jnp.where(finite, radius, 0.25 * state.radius)
        radius = jnp.where(state.first, state.radius, jnp.minimum(radius, 1.0))

        def moved(state: _State) -> _State:
            # One row after the other: batching the rows of a memory-bound backward pass made it slower, measured.
            slopes = jax.lax.map(lambda row: pull(row)[0], jnp.eye(outcome.shape[0], dtype=trial.dtype))
            gradient, jacobian = slopes[0], jnp.concatenate([slopes[1:], jax.jacrev(cheap)(trial, args)])
            # Curvature of the Lagrangian along the step, damped to stay positive definite.
            change = gradient - state.gradient + state.multipliers @ (jacobian - state.jacobian)
            along = trial - y
            pushed = state.hessian @ along
            bend = along @ pushed
            damp = jnp.where(along @ change >= 0.2 * bend, 1.0, 0.8 * bend / (bend - along @ change))
            change = damp * change + (1.0 - damp) * pushed
            update = jnp.outer(change, change) / (along @ change) - jnp.outer(pushed, pushed) / bend
            usable = ~state.first & (bend > 1e-14)
            hessian = state.hessian + jnp.where(usable, update, 0.0)
            hessian = jnp.where(jnp.all(jnp.isfinite(hessian)), hessian, jnp.eye(y.shape[0], dtype=y.dtype))
            fields = lambda s: (s.value, s.excess, s.gradient, s.jacobian, s.hessian)
            return eqx.tree_at(fields, state, (value, excess, gradient, jacobian, hessian))

        dynamic, static = eqx.partition(state, eqx.is_array)
        updated = jax.lax.cond(
            accept,
            lambda s: eqx.partition(moved(eqx.combine(s, static)), eqx.is_array)[0],
            lambda s: s,
            dynamic,
        )
        state = eqx.combine(updated, static)
        new_y = jnp.where(accept, trial, y)
        state = eqx.tree_at(lambda s: s.radius, state, radius)
        step, multipliers, predicted, promised = self._subproblem(new_y, state, options)
        # The penalty must exceed the multipliers, or the merit's minimum is not the problem's.
        violated = _violation(state.excess)
        stuck = (violated > self.atol) & (promised < 0.1 * violated)
        needed = jnp.where(stuck, 4.0 * state.penalty, 2.0 * jnp.max(multipliers, initial=0.0))
        penalty = jnp.clip(jnp.maximum(state.penalty, needed), self.penalty, self.most_penalty)
        grown = penalty > state.penalty
        best_merit = jnp.where(state.first | ~jnp.isfinite(state.best_merit), jnp.inf, state.best_merit)
        # A limit that holds to `atol` holds: at the largest penalty what is left of a converged step would outweigh all
        # that the step gained, and a search that begins near its end would return its beginning.
        merit_now = state.value + self.most_penalty * _violation(state.excess - self.atol)
        better = merit_now < best_merit
        decrease = predicted <= self.atol + self.rtol * jnp.abs(state.value)
        small = (self.norm(step) <= self.atol) | (radius <= self.atol)
        done = ~state.first & (decrease | small) & ~(grown & stuck)
        done |= state.steps + 1 >= options.get("most_steps", jnp.inf)
        broken = state.first & ~accept
        result = optx.RESULTS.where(broken, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        state = _State(
            state.value, state.excess, state.gradient, state.jacobian, state.hessian, multipliers, penalty, radius,
            step, predicted, jnp.where(better, new_y, state.best_y), jnp.minimum(merit_now, best_merit),
            jnp.array(False), state.steps + 1, done, result,
        )  # fmt: skip
        return new_y, state, excess[: outcome.shape[0] - 1]

    def terminate(self, fn, y, args, options, state: _State, tags):
        return state.done, state.result

    def postprocess(self, fn, y, aux, args, options, state: _State, tags, result):
        return state.best_y, aux, {"penalty": state.penalty, "multipliers": state.multipliers}
