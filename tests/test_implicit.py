"""Optima differentiated implicitly, against optima known in closed form."""

import numpy as np
import pytest

from tuning.implicit import differentiate_optimum


def quadratic(x):
    """(x0 - 1)^2 + 2 (x1 - 1)^2 - x3, with ln(x0 + x1) as its one excess less ln p; x2 has no effect."""
    gradient = np.array([2 * (x[0] - 1), 4 * (x[1] - 1), 0.0, -1.0])
    total = x[0] + x[1]
    return gradient, np.array([np.log(total)]), np.array([[1 / total, 1 / total, 0.0, 0.0]])


def at(p):
    """The minimum for x0 + x1 <= p, and its multiplier with respect to p."""
    multiplier = 4 * (2 - p) / 3
    return np.array([1 - multiplier / 2, 1 - multiplier / 4, 0.37, 1.0]), multiplier


@pytest.mark.parametrize("p", [0.7, 1.0, 1.4])
def test_a_binding_limit_moves_the_optimum_as_in_closed_form(p):
    x, multiplier = at(p)
    assert x[0] > 0

    def slopes(point):
        gradient, excess, jacobian = quadratic(point)
        return gradient, excess - np.log(p), jacobian

    found = differentiate_optimum(slopes, x, np.array([[-1.0 / p]]))
    # The Hessian is singular along x2, and x3 is held by its bound.
    np.testing.assert_allclose(found.x[:, 0], [2 / 3, 1 / 3, 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(found.objective, [-multiplier], rtol=1e-9)
    assert found.residual < 1e-9
    step = 1e-6
    np.testing.assert_allclose((at(p + step)[0] - at(p - step)[0]) / (2 * step), found.x[:, 0], atol=1e-7)


def test_a_limit_that_does_not_bind_moves_nothing():
    def slopes(point):
        gradient, excess, jacobian = quadratic(point)
        return gradient, excess - np.log(5.0), jacobian

    found = differentiate_optimum(slopes, np.array([1.0, 1.0, 0.2, 1.0]), np.array([[-0.2, 1.0]]))
    assert found.x.shape == (4, 2) and not found.x.any() and not found.objective.any() and not found.multipliers.any()


def test_rows_between_levers_hold_while_a_limit_moves():
    """x1 >= x0 binds beside the limit x0 + x1 <= p: both rise by a half; of f, (x0 - 1)^2 + 2 x1^2 in place of it."""

    def slopes(point):
        gradient = np.array([2 * (point[0] - 1), 4 * point[1]])
        return gradient, np.array([point.sum() - 0.5]), np.ones((1, 2))

    found = differentiate_optimum(
        slopes, np.array([0.25, 0.25]), np.array([[-1.0]]), linear=(np.array([[1.0, -1.0]]), np.zeros(1))
    )
    np.testing.assert_allclose(found.x[:, 0], [0.5, 0.5], atol=1e-9)
    # df/dp = (2 (x0 - 1) + 4 x1) / 2
    np.testing.assert_allclose(found.objective, [-0.25], atol=1e-9)


def test_what_is_no_optimum_is_told_by_its_residual():
    found = differentiate_optimum(
        lambda x: (np.array([1.0, -1.0]), np.array([-1.0]), np.zeros((1, 2))), np.array([0.5, 0.5]), np.array([[-1.0]])
    )
    assert found.residual == pytest.approx(1.0)


def test_saddle_directions_are_left_alone():
    """f = x0^2 - (x1 - 1/2)^2 + x0 pushed down: x0 <= p binds nothing, so curvature alone decides; x1 must not run."""

    def slopes(x):
        return np.array([2 * (x[0] - 1), -2 * (x[1] - 0.5)]), np.array([x[0] + 0.1 * x[1] - 0.55]), np.array([[1, 0.1]])

    found = differentiate_optimum(slopes, np.array([0.5, 0.5]), np.array([[-1.0]]))
    assert np.isfinite(found.x).all() and np.abs(found.x).max() < 2.0


@pytest.mark.parametrize("broken_at", [0.5, 0.497])
def test_slopes_that_are_not_finite_are_told(broken_at):
    """At the optimum itself, or at a neighbour that differences look at."""

    def slopes(x):
        bad = np.nan if abs(x[0] - broken_at) < 1e-6 else 0.0
        return np.array([-1.0 + bad, 2 * (x[1] - 1)]), np.array([x.sum() - 1.0]), np.ones((1, 2))

    found = differentiate_optimum(slopes, np.array([0.5, 0.5]), np.array([[-1.0]]))
    assert found.residual == np.inf and not found.x.any()
