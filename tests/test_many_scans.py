"""Surrogates of several scans in one vmapped call: each search goes where it goes alone, also beside other shapes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from surrogate_cases import made_measurement, made_space

from tuning import many_scans
from tuning.search import MARGIN, SHARP, Limits, Search, solve

LIMITS, STEPS = [Limits(200.0, 100.0), Limits(300.0, 100.0), Limits(250.0, 100.0)], 3


def test_a_batch_goes_where_each_scan_goes_alone(monkeypatch):
    with jax.enable_x64(True):
        surrogates = [made_measurement(0), made_measurement(1)]
        # Of another shape: it goes by itself.
        cut = surrogates[0].cost.tail_share.nodes[..., :-1], surrogates[0].cost.samples.nodes[..., :-1]
        where = lambda m: (m.cost.tail_share.nodes, m.cost.samples.nodes, m.cost.sizes)
        surrogates.append(eqx.tree_at(where, surrogates[0], (*cut, surrogates[0].cost.sizes[..., :-1])))
    space = made_space()
    searches = [Search(measured, space, 200.0) for measured in surrogates]
    starts = [[(k, space.sample(1, k, 10 * i + k)[0]) for k in (1, 3)] for i in range(3)]
    calls = []
    solving = many_scans._solve_many
    monkeypatch.setattr(many_scans, "_solve_many", lambda *asked: calls.append(asked[0].shape) or solving(*asked))
    together = many_scans.ends_of(searches, starts, LIMITS, SHARP, STEPS)
    assert calls == [(2, 2, space.size), (1, 2, space.size)]
    alone = jax.jit(lambda *asked: solve(*asked)[0])
    moved = []
    for i, search in enumerate(searches[:2]):
        held = replace(LIMITS[i], budget_us=MARGIN * LIMITS[i].budget_us)
        for (levels, start), (same, found) in zip(starts[i], together[i], strict=True):
            with jax.enable_x64(True):
                asked = search.measured, search.problem(levels, held), jnp.asarray(SHARP), jnp.asarray(STEPS)
                x = np.asarray(alone(jnp.asarray(space.ordered(start, levels)), *asked))
            assert levels == same
            moved.append(np.abs(found.x - space.ordered(start, levels)).max())
            np.testing.assert_allclose(found.x, space.ordered(x, levels), atol=1e-9)
            assert found.objective == search.look(found.x, levels, LIMITS[i]).objective
    assert max(moved) > 0.01
