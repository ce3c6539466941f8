"""Every metric, differentiated in every continuous parameter: against float64 differences; jit, jvp and vmap apart."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from surrogate_cases import made_measurement

from hapticlod.metrics import METRIC_KEYS
from hapticlod.surrogate.surrogate import predict
from tuning.space import decode, split

pytestmark = pytest.mark.slow
LEVELS, MOST = 3, 4
BUDGET_US = 60.0
# ln of: triangles, balls, cells (edges), speeds; hysteresis, filter, blend (ms), L in, L out.
POINT = np.log(
    [7e4, 2.1e4, 4.2e3, 4.2e3, 13.0, 9.0, 5.0, 5.0, 2.7, 5.2, 6.1, 6.1, 22.0, 61.0, 61.0, 0.11, 9.0, 35.0, 0.21, 0.26]
)
# Entries of levels that are not used: nothing may depend on them.
UNUSED = (3, 7, 11, 14)
NAMES = [f"{name}[{i}]" for name, values in split(np.arange(20), MOST).items() for i in range(len(values))]
STEP = 1e-5
SHARPNESS = 6.0  # sharper, and a count of switches is an integer that depends on nothing


@pytest.fixture(scope="module")
def plain():
    with jax.enable_x64(True):
        measured = made_measurement()

        def metrics(point):
            found = predict(measured, decode(point, jnp.asarray(LEVELS), MOST), BUDGET_US, SHARPNESS)
            return jnp.stack([found[key] for key in METRIC_KEYS])

        return metrics


@pytest.fixture(scope="module")
def model(plain):
    return jax.jit(plain)


@pytest.fixture(scope="module")
def slopes(model):
    """(metrics, parameters) by reverse mode."""
    with jax.enable_x64(True):
        return np.asarray(jax.jit(jax.jacrev(model))(jnp.asarray(POINT)))


@pytest.fixture(scope="module")
def quotients(model):
    """(metrics, parameters) by central differences, Richardson-extrapolated from two steps."""
    with jax.enable_x64(True):

        def central(step):
            columns = []
            for i in range(len(POINT)):
                moved = np.zeros(len(POINT))
                moved[i] = step
                columns.append((model(jnp.asarray(POINT + moved)) - model(jnp.asarray(POINT - moved))) / (2 * step))
            return np.stack(columns, axis=1)

        return (4 * central(STEP / 2) - central(STEP)) / 3


def test_every_metric_is_predicted_and_finite(model):
    with jax.enable_x64(True):
        values = np.asarray(model(jnp.asarray(POINT)))
    assert values.shape == (len(METRIC_KEYS),) and np.isfinite(values).all()
    # All branches are in use: nothing sits at a constant.
    named = dict(zip(METRIC_KEYS, values, strict=True))
    assert named["switches_per_s"] > 1 and 0.01 < named["mapping_hit_rate"] < 0.999
    assert 0.001 < named["deadline_miss_rate"] < 0.9 and named["discontinuity_per_s"] > 0.1


@pytest.mark.parametrize("key", METRIC_KEYS)
def test_gradient_is_the_difference_quotient(key, slopes, quotients):
    row, expected = slopes[METRIC_KEYS.index(key)], quotients[METRIC_KEYS.index(key)]
    scale = np.abs(expected).max()
    assert scale > 1e-9, "depends on nothing"
    wrong = {
        name: (float(a), float(b))
        for name, a, b in zip(NAMES, row, expected, strict=True)
        if abs(a - b) > 1e-4 * abs(b) + 1e-6 * scale + 1e-8
    }
    assert wrong == {}


@pytest.mark.parametrize("index", [i for i in range(len(POINT)) if i not in UNUSED], ids=lambda i: NAMES[i])
def test_every_parameter_matters_to_some_metric(index, quotients):
    assert np.abs(quotients[:, index]).max() > 1e-6


def test_levels_that_are_not_used_change_nothing(slopes):
    np.testing.assert_array_equal(slopes[:, UNUSED], 0.0)


def test_forward_mode_agrees_with_reverse(model, slopes):
    direction = np.random.default_rng(0).normal(size=len(POINT))
    with jax.enable_x64(True):
        _, forward = jax.jvp(model, (jnp.asarray(POINT),), (jnp.asarray(direction),))
    np.testing.assert_allclose(forward, slopes @ direction, rtol=1e-7, atol=1e-9)


def test_a_batch_is_its_members(model):
    points = np.stack([POINT, POINT + 0.05, POINT - 0.03])
    with jax.enable_x64(True):
        batch = np.asarray(jax.jit(jax.vmap(model))(jnp.asarray(points)))
        alone = np.stack([np.asarray(model(jnp.asarray(point))) for point in points])
    np.testing.assert_allclose(batch, alone, rtol=1e-9, atol=1e-12)


def test_compiled_is_what_is_written(plain, model):
    with jax.enable_x64(True):
        np.testing.assert_allclose(model(jnp.asarray(POINT)), plain(jnp.asarray(POINT)), rtol=1e-9, atol=1e-12)
