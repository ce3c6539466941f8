"""The best configuration that the surrogate can see, for a given number of levels: many starts, real constraints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float
from numpy.typing import NDArray

from hapticlod.surrogate.measurement import LadderMeasurement
from hapticlod.surrogate.surrogate import predict_members
from tuning.compile_cache import compiled
from tuning.objective import COST_WEIGHT, disturbance, objective
from tuning.optimise import SequentialQuadratic
from tuning.population import POOLED, over_motions
from tuning.sample import threads
from tuning.space import Space, decode

SCREENED, STARTS = 24, 4  # points looked at per level count, and those of them that are searched from
MARGIN = 0.98  # of the budget that the surrogate may use
# Switching is sharpened in stages: a soft trigger sees further, a sharp one counts right (PERCEPTION.md section 2).
SOFT, SHARP = 6.0, 20.0
SOFT_STEPS, MOST_STEPS = 8, 40
_FEASIBLE = 1e-3
_PROMISE = 2.0  # what a start's excess, in ln of its limit, weighs against its objective


@dataclass(frozen=True)
class Limits:
    """What must hold: p99.9 cost by the surrogate (corrected where a measurement said so), and memory."""

    budget_us: float
    memory_mb: float


@dataclass(frozen=True)
class Found:
    """x in the space, its objective, and how far the limits are exceeded (ln; at most 0 where they hold)."""

    x: NDArray[np.float64]
    objective: float
    excess: float
    predicted: dict[str, float]

    @property
    def rank(self) -> tuple[bool, float]:
        """Smaller is better: one that keeps the limits beats any that does not."""
        broken = self.excess > _FEASIBLE
        return broken, self.excess if broken else self.objective

    @property
    def promise(self) -> float:
        """Smaller is a better start; not finite comes last."""
        value = self.objective + _PROMISE * max(self.excess, 0.0)
        return value if np.isfinite(value) else np.inf


class Problem(eqx.Module):
    """Everything that the compiled code takes as an argument: one compilation serves all scans of a shape.

    - `log_low`, `log_span`: (n,) the space's bounds.
    - `levels`: how many are used.
    - `budget_us`, `memory_mb`: limits. `station_us`: the station's own budget, for miss rates and the cost's weight.
    - `rows`, `row_limits`: order of levels.
    - `over`, `motions`: what the objective is taken over (`tuning.population`), and how many motions there are.
    """

    log_low: Float[Array, " n"]
    log_span: Float[Array, " n"]
    levels: Array
    budget_us: Array
    memory_mb: Array
    station_us: Array
    rows: Float[Array, "p n"]
    row_limits: Float[Array, " p"]
    over: str = eqx.field(static=True)
    motions: int = eqx.field(static=True)


def _metrics(
    x: Float[Array, " n"], measured: LadderMeasurement, problem: Problem, sharpness: Array
) -> tuple[Any, Array]:
    """The metrics, and the objective over the motions."""
    parameters = decode(problem.log_low + x * problem.log_span, problem.levels)
    station_us = problem.station_us
    found, members = predict_members(measured, parameters, station_us, sharpness, problem.motions)
    if problem.over == POOLED:
        return found, objective(found, station_us)
    each = disturbance(members.felt_error_jnd, members.discontinuity_per_s)
    return found, over_motions(each, problem.over) + COST_WEIGHT * found["loop_cost_mean_us"] / station_us


def value_and_excess(x: Float[Array, " n"], args: Any) -> tuple[Array, Array]:
    """Objective, and ln of p99.9 cost and memory over their limits. `args`: measured, problem, sharpness."""
    measured, problem, sharpness = args
    found, value = _metrics(x, measured, problem, sharpness)
    over = [found["loop_cost_p999_us"] / problem.budget_us, found["memory_mb"] / problem.memory_mb]
    return value, jnp.log(jnp.stack(over))


@compiled
def _solve(
    x0: Array, measured: LadderMeasurement, problem: Problem, sharpness: Array, most_steps: Array
) -> tuple[Array, tuple[Array, Array, Array]]:
    """The best point met, and gradient, excess and Jacobian at the last: after one step that is x0."""
    options = {"lower": jnp.zeros_like(x0), "upper": jnp.ones_like(x0), "linear": (problem.rows, problem.row_limits)}
    options["most_steps"] = most_steps
    solver = SequentialQuadratic()
    args = (measured, problem, sharpness)
    found = optx.minimise(value_and_excess, solver, x0, args, options, has_aux=True, max_steps=MOST_STEPS, throw=False)
    return found.value, (found.state.gradient, found.state.excess, found.state.jacobian)


_look = compiled(_metrics)


class Search:
    """Optimises on one surrogate; level counts, limits and starts are arguments."""

    def __init__(
        self, measured: LadderMeasurement, space: Space, budget_us: float, over: str = POOLED, motions: int = 1
    ) -> None:
        self._measured, self._space, self._budget_us = measured, space, budget_us
        self._over, self._motions = over, motions
        self._compiled = False

    def _problem(self, levels: int, limits: Limits) -> Problem:
        low, high = self._space.log_bounds
        rows, row_limits = self._space.order_rows(levels)
        scalars = (levels, limits.budget_us, limits.memory_mb, self._budget_us)
        levels_, budget, memory, station = (jnp.asarray(value) for value in scalars)
        return Problem(
            jnp.asarray(low), jnp.asarray(high - low), levels_, budget, memory, station,
            jnp.asarray(rows), jnp.asarray(row_limits), self._over, 1 if self._over == POOLED else self._motions,
        )  # fmt: skip

    def best(self, levels: int, limits: Limits, seed: int, near: NDArray[np.float64] | None = None) -> Found:
        """The best of several starts; of the one near by, where it is given."""
        return self.best_of_each([levels], limits, seed, {} if near is None else {levels: near})[levels]

    def best_of_each(
        self, counts: Sequence[int], limits: Limits, seed: int, near: Mapping[int, NDArray[np.float64]] | None = None
    ) -> dict[int, Found]:
        """The best configuration of every level count: soft from many starts, then sharp from the best of them.

        Args:
            counts: level counts.
            limits: what must hold.
            seed: of the starts.
            near: by level count, a point to start from instead.

        Raises:
            ArithmeticError: the objective is finite from no start; it names the terms that are not.
        """
        near = near or {}
        held = Limits(MARGIN * limits.budget_us, limits.memory_mb)

        def solved(task: tuple[int, NDArray[np.float64], float]) -> Found:
            levels, start, sharpness = task
            with jax.enable_x64(True):  # of this thread
                x0 = jnp.asarray(self._space.ordered(start, levels))
                steps = jnp.asarray(SOFT_STEPS if sharpness < SHARP else MOST_STEPS)
                best, _ = _solve(x0, self._measured, self._problem(levels, held), jnp.asarray(sharpness), steps)
                x = np.asarray(best)
            return self.look(self._space.ordered(x, levels), levels, limits)

        heads = dict(near)
        with ThreadPoolExecutor(threads()) as pool:
            self._compile(pool, counts[0], held)
            soft = [(k, x, SOFT) for k in counts if k not in near for x in self._starts(pool, k, held, seed)]
            found = list(zip((k for k, _, _ in soft), pool.map(solved, soft), strict=True))
            for levels in counts:
                if levels not in heads:
                    heads[levels] = _first([f for k, f in found if k == levels], levels).x
            sharp = [(k, heads[k], SHARP) for k in counts]
            return dict(zip(counts, pool.map(solved, sharp), strict=True))

    def _compile(self, pool: ThreadPoolExecutor, levels: int, limits: Limits) -> None:
        """Both compiled functions at the same time; a thread each, since concurrent first calls would compile twice."""
        if self._compiled:
            return
        x = self._space.sample(1, levels, 0)[0]

        def build() -> None:
            with jax.enable_x64(True):
                one = jnp.asarray(1)
                _solve(jnp.asarray(x), self._measured, self._problem(levels, limits), jnp.asarray(SOFT), one)

        wait = pool.submit(build)
        self.look(x, levels, limits)
        wait.result()
        self._compiled = True

    def _starts(self, pool: ThreadPoolExecutor, levels: int, limits: Limits, seed: int) -> list[NDArray[np.float64]]:
        """The most promising of many points: a look costs less than a step, and most points are far from the best."""
        points = list(self._space.sample(SCREENED, levels, seed))
        looks = list(pool.map(lambda x: self.look(x, levels, limits), points))
        return [points[i] for i in sorted(range(SCREENED), key=lambda i: looks[i].promise)[:STARTS]]

    def slopes(
        self, x: NDArray[np.float64], levels: int, limits: Limits
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Gradient (n,) of the objective; excess (2,) over budget and memory as the search allows them, ln, and its
        Jacobian (2, n). By the code that was compiled for searching."""
        held = Limits(MARGIN * limits.budget_us, limits.memory_mb)
        with jax.enable_x64(True):
            asked = jnp.asarray(x), self._measured, self._problem(levels, held), jnp.asarray(SHARP), jnp.asarray(1)
            gradient, excess, jacobian = map(np.asarray, _solve(*asked)[1])
        return gradient, excess, jacobian

    def look(self, x: NDArray[np.float64], levels: int, limits: Limits) -> Found:
        """What the surrogate says of x."""
        with jax.enable_x64(True):
            sharpness = jnp.asarray(SHARP)
            raw, value = _look(jnp.asarray(x), self._measured, self._problem(levels, limits), sharpness)
            predicted = {name: float(value) for name, value in raw.items()}
        excess = max(
            np.log(predicted["loop_cost_p999_us"] / limits.budget_us),
            np.log(predicted["memory_mb"] / limits.memory_mb),
        )
        return Found(np.asarray(x), float(value), float(excess), predicted)


def _first(found: Sequence[Found], levels: int) -> Found:
    """The best that is finite."""
    finite = [f for f in found if np.isfinite(f.objective)]
    if not finite:
        broken = sorted(name for name, value in found[0].predicted.items() if not np.isfinite(value))
        raise ArithmeticError(f"{levels} levels: not finite from any start: {', '.join(broken)}")
    return min(finite, key=lambda f: f.rank)
