"""Rungs that only fill up a shape change neither predictions nor slopes, inside the ladder and at both of its ends."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapticlod.surrogate.surrogate import predict
from tests.surrogate_cases import made_measurement, made_space
from tuning.common_shape import RUNG_STEP, in_common_shape
from tuning.space import decode

LEVELS = 3


@pytest.fixture(scope="module")
def surrogates():
    with jax.enable_x64(True):
        plain = made_measurement()
        yield plain, in_common_shape(plain), made_space()


def _outcome(measured, space, x):
    low, high = map(jnp.asarray, space.log_bounds)

    def metrics(x):
        found = predict(measured, decode(low + x * (high - low), jnp.asarray(LEVELS)), 100.0)
        return jnp.stack([found[name] for name in sorted(found)])

    return eqx.filter_jit(lambda x: (metrics(x), jax.jacfwd(metrics)(x)))(jnp.asarray(x))


def test_rungs_are_filled_up_before_the_finest(surrogates):
    plain, filled, _ = surrogates
    rungs = plain.coarseness.shape[0]
    assert filled.coarseness.shape == (RUNG_STEP,) and np.all(np.diff(filled.coarseness) > 0)
    np.testing.assert_array_equal(filled.coarseness[-rungs:], plain.coarseness)
    np.testing.assert_array_equal(filled.feel.felt.nodes[:, -rungs:], plain.feel.felt.nodes)
    for leaf, before in zip(jax.tree.leaves(filled), jax.tree.leaves(plain), strict=True):
        assert rungs not in leaf.shape[:3] or leaf.shape == before.shape, "an array kept its rungs"


@pytest.mark.parametrize("place", ["inside", "finest", "coarsest"])
def test_predictions_and_slopes_are_the_same(surrogates, place):
    plain, filled, space = surrogates
    x = space.ordered(space.sample(1, LEVELS, 3)[0], LEVELS)
    if place == "finest":
        x[0] = 1.0
    if place == "coarsest":
        x[LEVELS - 1] = 0.0
    for got, expected in zip(_outcome(filled, space, x), _outcome(plain, space, x), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-11)


def test_one_rung_and_a_full_shape_stay_as_they_are(surrogates):
    _, filled, _ = surrogates
    assert in_common_shape(filled) is filled
