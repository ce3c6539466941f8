"""The best configuration that the surrogate can see, for a given number of levels: many starts, real constraints."""

from __future__ import annotations

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
from hapticlod.surrogate.surrogate import predict
from tuning.optimise import SequentialQuadratic
from tuning.sample import threads
from tuning.space import Space

# One noticed jump per second weighs as much as one JND of felt error. Needs people; a preset of the preference.
DISCONTINUITY_WEIGHT = 1.0
# Ties go to less work: a hundredth of a JND for a budget's worth of mean cost.
COST_WEIGHT = 0.01
STARTS = 4
MOST_STEPS = 40
MARGIN = 0.98  # of the budget that the surrogate may use


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


def objective(metrics: Any, budget_us: Any) -> Any:
    """What is minimised: felt error plus noticed jumps, and a trace of cost to settle ties."""
    return (
        metrics["felt_error_jnd"]
        + DISCONTINUITY_WEIGHT * metrics["discontinuity_per_s"]
        + COST_WEIGHT * metrics["loop_cost_mean_us"] / budget_us
    )


class Search:
    """Optimises on one surrogate. Compiled once; level counts, limits and starts are arguments."""

    def __init__(self, measured: LadderMeasurement, space: Space, budget_us: float) -> None:
        self._space, self._budget_us = space, budget_us
        self._dynamic, static = eqx.partition(measured, eqx.is_array)

        def metrics(x: Float[Array, " n"], args: Any) -> Any:
            arrays, levels, _ = args
            return predict(eqx.combine(arrays, static), space.parameters(x, levels), budget_us)

        def problem(x: Float[Array, " n"], args: Any) -> tuple[Array, Array]:
            found, limits = metrics(x, args), args[2]
            excess = [jnp.log(found["loop_cost_p999_us"] / limits[0]), jnp.log(found["memory_mb"] / limits[1])]
            return objective(found, budget_us), jnp.stack(excess)

        def run(x0: Array, args: Any, linear: tuple[Array, Array]) -> Array:
            options = {"lower": jnp.zeros_like(x0), "upper": jnp.ones_like(x0), "linear": linear}
            return optx.minimise(
                problem, SequentialQuadratic(), x0, args, options, has_aux=True, max_steps=MOST_STEPS, throw=False
            ).value

        self._run, self._metrics = eqx.filter_jit(run), eqx.filter_jit(metrics)

    def best(self, levels: int, limits: Limits, seed: int, extra: list[NDArray[np.float64]] | None = None) -> Found:
        """The best of several starts; one that keeps the limits beats any that does not."""
        matrix, bound = self._space.order_rows(levels)

        def one(start: NDArray[np.float64]) -> Found:
            with jax.enable_x64(True):  # of this thread
                linear = (jnp.asarray(matrix), jnp.asarray(bound))
                bounds = jnp.array([MARGIN * limits.budget_us, limits.memory_mb])
                x0 = jnp.asarray(self._space.ordered(start, levels))
                x = np.asarray(self._run(x0, (self._dynamic, jnp.asarray(levels), bounds), linear))
            return self.look(self._space.ordered(x, levels), levels, limits)

        starts = list(self._space.sample(STARTS, levels, seed)) + list(extra or [])
        head = one(starts[0])  # compiles
        with ThreadPoolExecutor(threads()) as pool:
            found = [head, *pool.map(one, starts[1:])]
        finite = [f for f in found if np.isfinite(f.objective)]
        if not finite:
            raise ArithmeticError(f"{levels} levels: the surrogate's objective is not finite from any start")
        return min(finite, key=lambda f: (max(f.excess, 0.0) > 1e-3, f.excess if f.excess > 1e-3 else 0.0, f.objective))

    def look(self, x: NDArray[np.float64], levels: int, limits: Limits) -> Found:
        """What the surrogate says of x."""
        with jax.enable_x64(True):
            bounds = jnp.array([limits.budget_us, limits.memory_mb])
            raw = self._metrics(jnp.asarray(x), (self._dynamic, jnp.asarray(levels), bounds))
            predicted = {name: float(value) for name, value in raw.items()}
        excess = max(
            np.log(predicted["loop_cost_p999_us"] / limits.budget_us),
            np.log(predicted["memory_mb"] / limits.memory_mb),
        )
        return Found(x, float(objective(predicted, self._budget_us)), float(excess), predicted)
