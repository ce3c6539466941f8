"""The best configuration that the surrogate can see, for a given number of levels: many starts, real constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from hapticlod.surrogate.surrogate import memory_mb, predict_members
from tuning import kept
from tuning.compile_cache import compiled
from tuning.hop import hop
from tuning.known import Known, KnownPoints
from tuning.objective import COST_WEIGHT, disturbance, felt_of, rounded
from tuning.optimise import SequentialQuadratic
from tuning.population import POOLED, WORST, over_motions
from tuning.sample import threads
from tuning.space import Space, decode
from tuning.split import splits

# Points looked at for the fewest levels, those of them that are searched from, and the ends of these, or of the short
# searches from splits, that are gone on with: the best of them after a few steps is often not the one that ends best.
SCREENED, STARTS, HEADS = 24, 6, 3
TRIED_STEPS = 12  # of a short sharp search
MARGIN = 0.98  # of the budget that the surrogate may use
# Switching is sharpened in stages: a soft trigger sees further, a sharp one counts right (PERCEPTION.md section 2).
SOFT, SHARP = 6.0, 20.0
SOFT_STEPS, MOST_STEPS = 8, 40
RESTORING = 4  # steps at most towards keeping the limits, before a search that begins at a given point
FOLLOWED = 3  # level counts that are searched again where another budget was searched before
_FEASIBLE = 1e-3
GLANCED = ("loop_cost_mean_us", "loop_cost_p999_us", "memory_mb")
# What a start's excess, in ln of its limit, weighs against its objective, and what it weighs for a third of the starts:
# where budgets are tight, the best of points that break them are all alike and far from any that does not.
_PROMISE, _CAREFUL = 2.0, 10.0
# Ends are searched from again, with a curvature that begins anew, while that gains so much; also with a level more.
POLISHED, POLISH_ROUNDS, _GAIN = 2, 3, 3e-3


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
        return self.promising(_PROMISE)

    def promising(self, weight: float) -> float:
        """The promise, the excess weighed so."""
        value = self.objective + weight * max(self.excess, 0.0)
        return value if np.isfinite(value) else np.inf


Task = tuple[int, NDArray[np.float64], float, int]  # level count, start, sharpness, most steps
Solved = Callable[[Task], Found]


class Problem(eqx.Module):
    """Everything that the compiled code takes as an argument: one compilation serves all scans of a shape.

    - `log_low`, `log_span`: (n,) the space's bounds.
    - `levels`: how many are used.
    - `budget_us`, `memory_mb`: limits. `station_us`: the station's own budget, for miss rates and the cost's weight.
    - `rows`, `row_limits`: order of levels.
    - `worst`: of a population, whether the worst motion counts, else the mean (`tuning.population`).
    - `motions`: how many the population has; 0: all are pooled.
    """

    log_low: Float[Array, " n"]
    log_span: Float[Array, " n"]
    levels: Array
    budget_us: Array
    memory_mb: Array
    station_us: Array
    rows: Float[Array, "p n"]
    row_limits: Float[Array, " p"]
    worst: Array
    motions: int = eqx.field(static=True)


def _metrics(
    x: Float[Array, " n"], measured: LadderMeasurement, problem: Problem, sharpness: Array
) -> tuple[Any, Array]:
    """The metrics, and the objective over the motions."""
    parameters = decode(problem.log_low + x * problem.log_span, problem.levels)
    station_us = problem.station_us
    found, members = predict_members(measured, parameters, station_us, sharpness, max(problem.motions, 1))
    if problem.motions:
        felt = over_motions(disturbance(members.felt_error_jnd, members.discontinuity_per_s), problem.worst)
    else:
        felt = felt_of(found)
    return found, rounded(felt) + COST_WEIGHT * found["loop_cost_mean_us"] / station_us


def value_and_excess(x: Float[Array, " n"], args: Any) -> tuple[Array, Array]:
    """Objective, and ln of p99.9 cost over its limit, (1,). `args`: measured, problem, sharpness."""
    measured, problem, sharpness = args
    found, value = _metrics(x, measured, problem, sharpness)
    return value, jnp.log(found["loop_cost_p999_us"] / problem.budget_us)[None]


def glance(x: Float[Array, " n"], measured: LadderMeasurement, problem: Problem, sharpness: Array) -> Array:
    """(4,) objective, and `GLANCED` metrics: all that a search asks for, in half the time of all metrics."""
    found, value = _metrics(x, measured, problem, sharpness)
    return jnp.stack([value, *(found[name] for name in GLANCED)])


def memory_excess(x: Float[Array, " n"], args: Any) -> Array:
    """ln of memory over its limit, (1,). `args` as above."""
    measured, problem, _ = args
    parameters = decode(problem.log_low + x * problem.log_span, problem.levels)
    return jnp.log(memory_mb(measured, parameters) / problem.memory_mb)[None]


def solve(
    x0: Array, measured: LadderMeasurement, problem: Problem, sharpness: Array, most_steps: Array
) -> tuple[Array, tuple[Array, Array, Array]]:
    """The best point met, and gradient, excess and Jacobian at the last: after one step that is x0."""
    options = {"lower": jnp.zeros_like(x0), "upper": jnp.ones_like(x0), "linear": (problem.rows, problem.row_limits)}
    options |= {"most_steps": most_steps, "cheap": (memory_excess, 1)}
    solver = SequentialQuadratic()
    args = (measured, problem, sharpness)
    found = optx.minimise(value_and_excess, solver, x0, args, options, has_aux=True, max_steps=MOST_STEPS, throw=False)
    return found.value, (found.state.gradient, found.state.excess, found.state.jacobian)


# All metrics are looked at a few dozen times, and half of them are quantiles, which are long to compile.
_solve, _look, _glance = compiled(solve), compiled(_metrics, seldom=True), compiled(glance)


class Search:
    """Optimises on one surrogate; level counts, limits and starts are arguments.

    Args:
        measured, space: the surrogate and its box. budget_us: the station's.
        over, motions: what the objective is taken over (`tuning.population`), and how many motions there are.
        key: of measured and space. With it, what was looked at and found is kept between runs, and a search for
            another budget begins there; without, nothing is.
    """

    def __init__(
        self, measured: LadderMeasurement, space: Space, budget_us: float, over: str = POOLED, motions: int = 1,
        key: str = "",
    ) -> None:  # fmt: skip
        self._measured, self._space, self._budget_us = measured, space, budget_us
        self._over, self._motions = over, motions
        self._compiled = False
        self._known = KnownPoints(kept.key_of(key, over) if key else "")

    def problem(self, levels: int, limits: Limits) -> Problem:
        """What compiled code is told of a search for so many levels under these limits."""
        low, high = self._space.log_bounds
        rows, row_limits = self._space.order_rows(levels)
        scalars = (levels, float(limits.budget_us), float(limits.memory_mb), float(self._budget_us))
        levels_, budget, memory, station = (jnp.asarray(value) for value in scalars)
        return Problem(
            jnp.asarray(low), jnp.asarray(high - low), levels_, budget, memory, station,
            jnp.asarray(rows), jnp.asarray(row_limits), jnp.asarray(self._over == WORST),
            0 if self._over == POOLED else self._motions,
        )  # fmt: skip

    def best(self, levels: int, limits: Limits, seed: int, near: NDArray[np.float64] | None = None) -> Found:
        """The best of several starts; of the one near by, where it is given."""
        return self.best_of_each([levels], limits, seed, {} if near is None else {levels: near})[levels]

    def best_of_each(
        self, counts: Sequence[int], limits: Limits, seed: int, near: Mapping[int, NDArray[np.float64]] | None = None
    ) -> dict[int, Found]:
        """The best configuration of every level count: of the fewest levels from many starts, of each further from the
        best with one less, a level of which is split; all from the best that earlier runs know to fit, where they do.

        Args:
            counts: level counts.
            limits: what must hold.
            seed: of the starts.
            near: by level count, a point to start from instead.

        Raises:
            ArithmeticError: the objective is finite from no start; it names the terms that are not.
        """
        near = near or {}
        asked = tuple(counts), limits, seed, self._budget_us, sorted((k, x.tobytes()) for k, x in near.items())
        return self._known.answer(asked, lambda: self._best_of_each(counts, limits, seed, near))

    def _best_of_each(
        self, counts: Sequence[int], limits: Limits, seed: int, near: Mapping[int, NDArray[np.float64]]
    ) -> dict[int, Found]:
        held = Limits(MARGIN * limits.budget_us, limits.memory_mb)

        def solved(task: Task) -> Found:
            levels, start, sharpness, steps = task
            with jax.enable_x64(True):  # of this thread
                asked = self._measured, self.problem(levels, held), jnp.asarray(sharpness), jnp.asarray(steps)
                best, _ = _solve(jnp.asarray(self._space.ordered(start, levels)), *asked)
                x = np.asarray(best)
            return self._glanced(self._space.ordered(x, levels), levels, limits)

        with ThreadPoolExecutor(threads()) as pool:
            self._compile(pool, counts[0], held)
            before = self._known.best([k for k in counts if k not in near], lambda known: self._promise(known, held))
            anew = [k for k in counts if k not in near and k not in before]
            drawn = [k for k in anew if k - 1 not in counts]
            soft = [(k, x, SOFT, SOFT_STEPS) for k in drawn for x in self.starts(pool, k, held, seed)]
            found = list(zip((task[0] for task in soft), pool.map(solved, soft), strict=True))
            begun = [*near.items(), *list(before.items())[:FOLLOWED]]
            sharp = [(k, self._restored(x, k, limits), SHARP, MOST_STEPS) for k, x in begun]
            for levels in drawn:
                try:
                    heads = heads_of([f for k, f in found if k == levels], levels)
                except ArithmeticError:
                    heads_of([self.look(f.x, k, limits) for k, f in found if k == levels], levels)  # names the terms
                    raise
                sharp += [(levels, f.x, SHARP, MOST_STEPS) for f in heads]
            ends: dict[int, Found] = {}
            _better(ends, sharp, pool, solved)
            for levels in sorted(set(anew) - set(drawn)):
                fewer = ends[levels - 1].x if levels - 1 in ends else before[levels - 1]
                _better(ends, self._split(fewer, levels, pool, solved), pool, solved)
            if not near:
                hop(ends, lambda hops: _better(ends, [(k, x, SHARP, TRIED_STEPS) for k, x in hops], pool, solved), seed)
                self._polish(ends, pool, solved)
                self._widen(ends, limits)
        ends |= {k: self._glanced(self._space.ordered(x, k), k, limits) for k, x in before.items() if k not in ends}
        for levels, end in [*found, *ends.items()]:
            self._know(levels, end)
        return {levels: self.look(ends[levels].x, levels, limits) for levels in counts}

    def _restored(self, x: NDArray[np.float64], levels: int, limits: Limits) -> NDArray[np.float64]:
        """A point near x that about keeps the limits: where x is the full scan, slopes are those of a root at nothing,
        and a search that begins there learns a curvature which it does not forget."""
        for _ in range(RESTORING):
            _, excess, jacobian = self.slopes(x, levels, limits)
            most = int(np.argmax(excess))
            row = jacobian[most]
            if not (excess[most] > 0.0 and 0.0 < row @ row < np.inf):
                break
            x = self._space.ordered(np.clip(x - excess[most] * row / (row @ row), 0.0, 1.0), levels)
        return x

    def _split(self, fewer: NDArray[np.float64], levels: int, pool: ThreadPoolExecutor, solved: Solved) -> list[Task]:
        """Searches from the most promising ends of short ones, which begin where one level of `fewer` is two."""
        short = [(levels, x, SHARP, TRIED_STEPS) for x in splits(self._space, fewer, levels - 1)]
        tried = sorted(pool.map(solved, short), key=lambda found: found.rank)
        return [(levels, found.x, SHARP, MOST_STEPS) for found in tried[:HEADS]]

    def _polish(self, ends: dict[int, Found], pool: ThreadPoolExecutor, solved: Solved) -> None:
        """Searches on from the best ends, in place, and from the best of all with a level more that is hardly used."""
        asked: set[tuple[int, bytes]] = set()
        for _ in range(POLISH_ROUNDS):
            first = sorted(ends, key=lambda k: ends[k].rank)[:POLISHED]
            before = ends[first[0]]
            again = [(k, ends[k].x) for k in first]
            if first[0] + 1 in ends:
                again.append((first[0] + 1, self._space.widened(before.x, first[0])))
            again = [(k, x) for k, x in again if (k, x.tobytes()) not in asked]  # an end that gave nothing better
            asked |= {(k, x.tobytes()) for k, x in again}
            _better(ends, [(k, x, SHARP, MOST_STEPS) for k, x in again], pool, solved)
            best = min(ends.values(), key=lambda found: found.rank)
            if best.rank[0] == before.rank[0] and best.rank[1] > (1.0 - _GAIN) * before.rank[1]:
                return

    def _widen(self, ends: dict[int, Found], limits: Limits) -> None:
        """Who may have a level more does no worse: it need hardly be used."""
        for levels in sorted(ends):
            if levels - 1 in ends:
                wider = self._glanced(self._space.widened(ends[levels - 1].x, levels - 1), levels, limits)
                ends[levels] = min(ends[levels], wider, key=lambda found: found.rank)

    def _promise(self, known: Known, limits: Limits) -> float:
        """As `Found.promise`."""
        value = known.felt + COST_WEIGHT * known.mean_us / self._budget_us
        excess = np.log(max(known.p999_us / limits.budget_us, known.memory_mb / limits.memory_mb))
        return float(value + _PROMISE * max(excess, 0.0))

    def _know(self, levels: int, found: Found) -> None:
        mean_us = found.predicted["loop_cost_mean_us"]
        felt = found.objective - COST_WEIGHT * mean_us / self._budget_us
        p999_us, memory_mb = found.predicted["loop_cost_p999_us"], found.predicted["memory_mb"]
        self._known.add(Known(levels, found.x, felt, mean_us, p999_us, memory_mb))

    @property
    def measured(self) -> LadderMeasurement:
        """The surrogate's arrays."""
        return self._measured

    @property
    def space(self) -> Space:
        """The box."""
        return self._space

    def _compile(self, pool: ThreadPoolExecutor, levels: int, limits: Limits) -> None:
        """All compiled functions at the same time; a thread each, since concurrent first calls would compile twice."""
        if self._compiled:
            return
        x = self._space.sample(1, levels, 0)[0]

        def build() -> None:
            with jax.enable_x64(True):
                one = jnp.asarray(1)
                _solve(jnp.asarray(x), self._measured, self.problem(levels, limits), jnp.asarray(SOFT), one)

        waits = [pool.submit(build), pool.submit(self._glanced, x, levels, limits)]
        self.look(x, levels, limits)
        for wait in waits:
            wait.result()
        self._compiled = True

    def starts(self, pool: ThreadPoolExecutor, levels: int, limits: Limits, seed: int) -> list[NDArray[np.float64]]:
        """The most promising of many points, since a look costs less than a step. One of them keeps the limits, or
        breaks them least: from points that all break them a search may end where it cannot break them less."""
        points = [*self._space.sample(SCREENED, levels, seed), *self._space.anchors(levels)]
        looks = list(pool.map(lambda x: self._glanced(x, levels, limits), points))
        for look in looks:
            self._know(levels, look)
        order = sorted(range(len(points)), key=lambda i: looks[i].promise)
        careful = sorted(range(len(points)), key=lambda i: looks[i].promising(_CAREFUL))
        safest = min(order, key=lambda i: max(looks[i].excess, 0.0) if np.isfinite(looks[i].promise) else np.inf)
        bold = order[: STARTS - STARTS // 3]
        chosen = [*bold, *[i for i in careful if i not in bold][: STARTS // 3]]
        if safest not in chosen and all(looks[i].excess > 0.0 for i in chosen):
            chosen[-1] = safest
        return [points[i] for i in chosen]

    def slopes(
        self, x: NDArray[np.float64], levels: int, limits: Limits
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Gradient (n,) of the objective; excess (2,) over budget and memory as the search allows them, ln, and its
        Jacobian (2, n). By the code that was compiled for searching."""
        held = Limits(MARGIN * limits.budget_us, limits.memory_mb)
        with jax.enable_x64(True):
            asked = jnp.asarray(x), self._measured, self.problem(levels, held), jnp.asarray(SHARP), jnp.asarray(1)
            gradient, excess, jacobian = map(np.asarray, _solve(*asked)[1])
        return gradient, excess, jacobian

    def look(self, x: NDArray[np.float64], levels: int, limits: Limits) -> Found:
        """All that the surrogate says of x."""
        with jax.enable_x64(True):
            asked = jnp.asarray(x), self._measured, self.problem(levels, limits), jnp.asarray(SHARP)
            raw, value = jax.device_get(_look(*asked))
        return _found(x, value, {name: float(each) for name, each in raw.items()}, limits)

    def glances(self, points: Sequence[NDArray[np.float64]], levels: int, limits: Limits) -> list[Found]:
        """What a search needs to know of points."""
        with ThreadPoolExecutor(threads()) as pool:
            return list(pool.map(lambda x: self._glanced(x, levels, limits), points))

    def _glanced(self, x: NDArray[np.float64], levels: int, limits: Limits) -> Found:
        """What a search needs to know of x: `predicted` has `GLANCED` alone."""
        with jax.enable_x64(True):
            asked = jnp.asarray(x), self._measured, self.problem(levels, limits), jnp.asarray(SHARP)
            value, *metrics = np.asarray(_glance(*asked))
        return _found(x, value, dict(zip(GLANCED, map(float, metrics), strict=True)), limits)


def _found(x: NDArray[np.float64], value: float, predicted: dict[str, float], limits: Limits) -> Found:
    excess = max(
        np.log(predicted["loop_cost_p999_us"] / limits.budget_us), np.log(predicted["memory_mb"] / limits.memory_mb)
    )
    return Found(np.asarray(x), float(value), float(excess), predicted)


def _better(ends: dict[int, Found], tasks: Sequence[Task], pool: ThreadPoolExecutor, solved: Solved) -> None:
    """Searches, and keeps the best of each level count."""
    for (levels, *_), end in zip(tasks, list(pool.map(solved, tasks)), strict=True):
        if levels not in ends or end.rank < ends[levels].rank:
            ends[levels] = end


def heads_of(found: Sequence[Found], levels: int) -> list[Found]:
    """The best that are finite: those of soft searches that are worth a sharp one. Raises ArithmeticError: none is."""
    finite = [f for f in found if np.isfinite(f.objective)]
    if not finite:
        broken = sorted(name for name, value in found[0].predicted.items() if not np.isfinite(value))
        raise ArithmeticError(f"{levels} levels: not finite from any start: {', '.join(broken)}")
    return sorted(finite, key=lambda f: f.rank)[:HEADS]
