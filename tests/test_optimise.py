"""The constrained minimiser against scipy's SLSQP with the same gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import minimize

from tuning.optimise import SequentialQuadratic
from tuning.quadratic import solve_quadratic


@pytest.fixture(autouse=True)
def _float64():
    with jax.enable_x64(True):
        yield


def rosenbrock(y, args):
    value = 0.1 * jnp.sum(100 * (y[1:] - y[:-1] ** 2) ** 2 + (1 - y[:-1]) ** 2)
    return value, jnp.array([jnp.sum(y**2) - 2.0, y[0] * y[1] - 0.5])


def hock_schittkowski_71(z, args):
    """Problem 71 of Hock & Schittkowski (1981), its equality relaxed; optimum 17.0140173."""
    x = 1 + 4 * z
    return x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2], jnp.array([25 - jnp.prod(x), jnp.sum(x**2) - 40]) / 10


def tail_cost(y, args):
    """A toy of the tuner's shape: error falls and cost grows with y; the cost's upper tail is bounded."""
    noise = jnp.asarray(np.random.default_rng(0).gamma(2.0, 1.0, (500, 8)))
    cost = noise @ jnp.exp(2 * y)
    tail = jnp.mean(jax.lax.top_k(cost, 25)[0])
    return jnp.sum(jnp.exp(-3 * y) * jnp.arange(1.0, 9.0)), jnp.array([jnp.log(tail / 40)])


PROBLEMS = [(rosenbrock, 6, 0.0, 1.5), (hock_schittkowski_71, 4, 0.0, 1.0), (tail_cost, 8, 0.0, 1.0)]


def slsqp(fn, starts, lower, upper):
    """The least value that SLSQP ends at from any of the starts."""
    value = jax.jit(lambda y: fn(y, None)[0])
    excess = jax.jit(lambda y: fn(y, None)[1])
    slope, slopes = jax.jit(jax.grad(value)), jax.jit(jax.jacrev(excess))
    constraint = {"type": "ineq", "fun": lambda y: -np.array(excess(y)), "jac": lambda y: -np.array(slopes(y))}
    bounds = [(lower, upper)] * starts.shape[1]
    found = [
        minimize(
            lambda y: float(value(y)), y0, jac=lambda y: np.array(slope(y)), bounds=bounds, method="SLSQP",
            constraints=constraint, options={"ftol": 1e-10, "maxiter": 200},
        )
        for y0 in starts
    ]  # fmt: skip
    return min(each.fun for each in found)


@pytest.mark.parametrize(("fn", "n", "lower", "upper"), PROBLEMS, ids=lambda p: getattr(p, "__name__", ""))
def test_reaches_slsqp_optimum_from_every_start(fn, n, lower, upper):
    options = {"lower": jnp.full(n, lower), "upper": jnp.full(n, upper)}
    run = jax.jit(lambda y0: optx.minimise(fn, SequentialQuadratic(), y0, None, options, has_aux=True, throw=False))
    starts = np.random.default_rng(1).uniform(lower, upper, (6, n))
    reference = slsqp(fn, starts, lower, upper)
    judge = jax.jit(lambda y: fn(y, None))
    for start in starts:
        solution = run(jnp.asarray(start))
        value, excess = judge(solution.value)
        assert solution.result == optx.RESULTS.successful
        assert float(value) <= reference + 1e-3 * abs(reference)
        assert float(jnp.max(excess)) < 1e-5
        assert np.all(np.asarray(solution.value) >= lower) and np.all(np.asarray(solution.value) <= upper)
        assert int(solution.stats["num_steps"]) <= 60


@pytest.mark.parametrize("away", [1e-2, 1e-3, 1e-4, 1e-5])
def test_what_is_gained_on_a_curved_limit_is_kept(away):
    """Nearest point to (3, 1) in the unit disc, from inside: steps along the tangent end a hair outside."""

    def problem(y, args):
        return jnp.sum((y - jnp.array([3.0, 1.0])) ** 2), jnp.array([jnp.sum(y**2) - 1.0])

    best = np.array([3.0, 1.0]) / np.sqrt(10.0)
    start = (1.0 - away) * best
    options = {"lower": jnp.full(2, -2.0), "upper": jnp.full(2, 2.0)}
    solution = optx.minimise(problem, SequentialQuadratic(), jnp.asarray(start), None, options, has_aux=True)
    value, excess = problem(solution.value, None)
    assert float(excess[0]) < 2e-6  # atol, and little more
    assert float(value) <= float(problem(jnp.asarray(best), None)[0]) + 0.05 * away


def test_linear_rows_hold_and_bind():
    """Nearest point to (1, 0) with y1 >= y0 + 0.2 in the unit box: (0.4, 0.6)."""
    options = {
        "lower": jnp.zeros(2), "upper": jnp.ones(2), "linear": (jnp.array([[1.0, -1.0]]), jnp.array([-0.2])),
    }  # fmt: skip
    fn = lambda y, _: ((y[0] - 1) ** 2 + y[1] ** 2, jnp.array([-1.0]))
    solution = optx.minimise(fn, SequentialQuadratic(), jnp.array([0.1, 0.9]), None, options, has_aux=True)
    np.testing.assert_allclose(solution.value, [0.4, 0.6], atol=1e-4)


def test_infeasible_ends_at_the_least_violation():
    options = {"lower": jnp.zeros(2), "upper": jnp.ones(2)}
    fn = lambda y, _: (jnp.sum((y - 0.5) ** 2), jnp.array([2.0 - jnp.sum(y * jnp.array([1.0, 0.5]))]))
    solution = optx.minimise(
        fn, SequentialQuadratic(), jnp.array([0.2, 0.3]), None, options, has_aux=True, throw=False, max_steps=100
    )
    np.testing.assert_allclose(solution.value, [1.0, 1.0], atol=1e-3)


def test_steps_into_nan_are_refused():
    options = {"lower": jnp.full(1, -1.0), "upper": jnp.full(1, 1.0)}
    fn = lambda y, _: (jnp.sum(jnp.where(y < -0.1, jnp.nan, (y + 0.05) ** 2)), jnp.array([-1.0]))
    solution = optx.minimise(fn, SequentialQuadratic(), jnp.array([0.9]), None, options, has_aux=True, throw=False)
    np.testing.assert_allclose(solution.value, [-0.05], atol=1e-3)


def test_nan_at_the_start_is_reported():
    options = {"lower": jnp.zeros(1), "upper": jnp.ones(1)}
    fn = lambda y, _: (jnp.sum(y) * jnp.nan, jnp.array([-1.0]))
    solution = optx.minimise(fn, SequentialQuadratic(), jnp.array([0.5]), None, options, has_aux=True, throw=False)
    assert solution.result == optx.RESULTS.nonfinite


def test_quadratic_programme_meets_its_optimality_conditions():
    random, solve = np.random.default_rng(3), jax.jit(solve_quadratic)
    for _ in range(5):
        n, rows = 7, 12
        root = random.normal(size=(n, n))
        hessian, gradient = root @ root.T + 0.1 * np.eye(n), random.normal(size=n)
        matrix = random.normal(size=(rows, n))
        limits = matrix @ random.normal(size=n) + random.uniform(0, 1, rows)
        ours = solve(*map(jnp.asarray, (hessian, gradient, matrix, limits)))
        x, dual = np.asarray(ours.x), np.asarray(ours.multipliers)
        # Karush-Kuhn-Tucker: necessary and, the programme being convex, sufficient.
        np.testing.assert_allclose(hessian @ x + gradient + matrix.T @ dual, 0, atol=1e-7)
        assert np.all(matrix @ x <= limits + 1e-8) and np.all(dual >= 0)
        np.testing.assert_allclose(dual * (limits - matrix @ x), 0, atol=1e-7)
        assert np.any(dual > 1e-3)
