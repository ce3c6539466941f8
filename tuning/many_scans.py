"""The surrogates of many scans, optimised in one vmapped call: what a GPU is for. `Search` does one scan, on threads.

Surrogates whose arrays have the same shapes go together, all their level counts and starts at once; those of other
shapes follow in calls of their own. Motions of the same lengths and ladders of the same heights give the same shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from tuning.compile_cache import compiled
from tuning.sample import threads
from tuning.search import (
    MARGIN,
    MOST_STEPS,
    SHARP,
    SOFT,
    SOFT_STEPS,
    Found,
    Limits,
    Problem,
    Search,
    heads_of,
    solve,
)

Start = tuple[int, NDArray[np.float64]]  # level count, x


def best_of_scans(
    searches: Sequence[Search], counts: Sequence[int], limits: Sequence[Limits], seed: int
) -> list[dict[int, Found]]:
    """The best of every level count for every scan, from drawn starts alone: without the splits, hops and polish that
    `Search.best_of_each` goes on with.

    Args:
        searches: one per scan, each with its own surrogate and space, all over the same population of motions.
        counts: level counts, each of which every space has room for.
        limits: of every scan. seed: of the starts.
    """
    with ThreadPoolExecutor(threads()) as pool:
        held = [Limits(MARGIN * each.budget_us, each.memory_mb) for each in limits]
        starts = [
            [(k, x) for k in counts for x in search.starts(pool, k, within, seed)]
            for search, within in zip(searches, held, strict=True)
        ]
    ends = ends_of(searches, starts, limits, SOFT, SOFT_STEPS)
    heads = [[(k, f.x) for k in counts for f in heads_of([f for n, f in each if n == k], k)] for each in ends]
    sharp = ends_of(searches, heads, limits, SHARP, MOST_STEPS)
    return [{k: min((f for n, f in each if n == k), key=lambda f: f.rank) for k in counts} for each in sharp]


def ends_of(
    searches: Sequence[Search],
    starts: Sequence[Sequence[Start]],
    limits: Sequence[Limits],
    sharpness: float,
    steps: int,
) -> list[list[tuple[int, Found]]]:
    """Where each start of each scan ends after at most so many steps, and what its surrogate says there."""
    ends: list[list[tuple[int, Found]]] = [[] for _ in searches]
    with jax.enable_x64(True):
        for group in _alike(searches):
            points = np.stack([[searches[i].space.ordered(x, k) for k, x in starts[i]] for i in group])
            problems = [[_within(searches[i], k, limits[i]) for k, _ in starts[i]] for i in group]
            problem = _stack([_stack(each) for each in problems])
            measured = _stack([searches[i].measured for i in group])
            asked = jnp.asarray(points), measured, problem, jnp.asarray(sharpness), jnp.asarray(steps)
            found = np.asarray(_solve_many(*asked))
            for i, each in zip(group, found, strict=True):
                for (levels, _), x in zip(starts[i], each, strict=True):
                    ordered = searches[i].space.ordered(x, levels)
                    ends[i].append((levels, searches[i].look(ordered, levels, limits[i])))
    return ends


def _within(search: Search, levels: int, limits: Limits) -> Problem:
    return search.problem(levels, Limits(MARGIN * limits.budget_us, limits.memory_mb))


def _alike(searches: Sequence[Search]) -> list[list[int]]:
    """Indices of surrogates with equal shapes and equal static parts, together."""
    groups: dict[object, list[int]] = {}
    for i, search in enumerate(searches):
        arrays, fixed = eqx.partition(search.measured, eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        groups.setdefault((tree, tuple((x.shape, str(x.dtype)) for x in leaves), fixed), []).append(i)
    return list(groups.values())


def _stack(trees: Sequence) -> object:
    """Arrays of equal trees along a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _many(x0: Array, measured: object, problem: Problem, sharpness: Array, steps: Array) -> Array:
    """(scans, starts, n) -> the same; each scan's surrogate serves all its starts."""
    one = lambda x, surrogate, limits: solve(x, surrogate, limits, sharpness, steps)[0]
    return jax.vmap(jax.vmap(one, (0, None, 0)), (0, 0, 0))(x0, measured, problem)


_solve_many = compiled(_many)
