"""Surrogates of several scans in one vmapped call: each search goes where it goes alone, also beside other shapes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from surrogate_cases import made_measurement, made_space

from tuning import many_scans, search
from tuning.search import MARGIN, SHARP, Limits, Search

pytestmark = pytest.mark.slow
SPACE = made_space()
LIMITS, STEPS = [Limits(200.0, 100.0), Limits(300.0, 100.0), Limits(250.0, 100.0)], 3


@pytest.fixture(scope="module")
def searches() -> list[Search]:
    """Two of one shape, and one of another between them."""
    with jax.enable_x64(True):
        first, last = made_measurement(0), made_measurement(1)
        cut = first.cost.depth.nodes[..., :-1], first.cost.samples.nodes[..., :-1], first.cost.sizes[..., :-1]
        where = lambda m: (m.cost.depth.nodes, m.cost.samples.nodes, m.cost.sizes)
        other = eqx.tree_at(where, first, cut)
    return [Search(measured, SPACE, 200.0) for measured in (first, other, last)]


def starts(levels: tuple[int, ...]) -> list[list[tuple[int, np.ndarray]]]:
    return [[(k, SPACE.sample(1, k, 10 * i + k)[0]) for k in levels] for i in range(3)]


def test_each_of_a_batch_goes_where_it_goes_alone(searches: list[Search]) -> None:
    alike, limits, begun = searches[::2], LIMITS[::2], starts((1, 3))[::2]
    together = many_scans.ends_of(alike, begun, limits, SHARP, STEPS)
    moved = []
    for each, within, points, ends in zip(alike, limits, begun, together, strict=True):
        held = replace(within, budget_us=MARGIN * within.budget_us)
        for (levels, start), (same, found) in zip(points, ends, strict=True):
            with jax.enable_x64(True):
                asked = each.measured, each.problem(levels, held), jnp.asarray(SHARP), jnp.asarray(STEPS)
                x = np.asarray(search._solve(jnp.asarray(SPACE.ordered(start, levels)), *asked)[0])
            assert levels == same
            moved.append(np.abs(found.x - SPACE.ordered(start, levels)).max())
            np.testing.assert_allclose(found.x, SPACE.ordered(x, levels), atol=1e-9)
            assert found.objective == each.look(found.x, levels, within).objective
    assert max(moved) > 0.01


def test_other_shapes_go_by_themselves_and_come_back_in_order(searches: list[Search], monkeypatch) -> None:
    """With a search that leaves its mark: the point comes back moved by the budget and the surrogate it was given."""
    calls = []

    def marked(x0, measured, problem, sharpness, steps):
        calls.append((x0.shape, measured.cost.sizes.shape[-1]))
        mark = problem.budget_us + measured.cost.sizes.shape[-1]
        return jnp.full_like(x0, 0.5) + 1e-4 * mark[..., None]

    monkeypatch.setattr(many_scans, "_solve_many", marked)
    begun = starts((2, 3))
    ends = many_scans.ends_of(searches, begun, LIMITS, SHARP, STEPS)
    sizes = [each.measured.cost.sizes.shape[-1] for each in searches]
    assert calls == [((2, 2, SPACE.size), sizes[0]), ((1, 2, SPACE.size), sizes[1])] and sizes[0] != sizes[1]
    for points, found, limits, size in zip(begun, ends, LIMITS, sizes, strict=True):
        assert [k for k, _ in found] == [k for k, _ in points]
        for levels, each in found:
            expected = SPACE.ordered(np.full(SPACE.size, 0.5 + 1e-4 * (MARGIN * limits.budget_us + size)), levels)
            np.testing.assert_allclose(each.x, expected, atol=1e-12)
