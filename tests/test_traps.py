"""What a level owes to its past: told from what its surface does, and shared by those who were there."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapticlod.surrogate.ladder_curves import places
from hapticlod.surrogate.traps import Traps, trapped
from tuning.split_traps import split_traps

INSTANTS = 40


def test_a_trap_is_what_a_fresh_arrival_does_not_feel() -> None:
    """Squared errors of 1 on either surface; caught from instant 10 to 19, as if free at 14, at 100."""
    own, fresh = np.ones((1, 1, INSTANTS)), np.ones((1, 1, INSTANTS))
    own[..., 10:20] = 100.0
    own[..., 14] = 1.0
    excess, begins = split_traps(own, fresh, np.arange(INSTANTS) == 0)
    assert np.flatnonzero(begins[0, 0]).tolist() == [10]
    assert np.flatnonzero(excess[0, 0]).tolist() == [10, 11, 12, 13, 15, 16, 17, 18, 19]
    assert np.all(own - excess <= 4.0)
    rough, none = split_traps(own, own, np.arange(INSTANTS) == 0)  # as bad for those who just came: the surface's own
    assert not rough.any() and not none.any()


def expected(level_at: np.ndarray, begin: int, end: int) -> np.ndarray:
    """Who has been at level 1 at every instant since the trap began, one hand."""
    there = np.array([np.all(level_at[begin : i + 1] == 1) for i in range(INSTANTS)])
    return np.where((np.arange(INSTANTS) >= begin) & (np.arange(INSTANTS) < end), there, 0.0)


@pytest.mark.parametrize(("switch", "back"), [(3, 37), (15, 37), (3, 14), (12, 17)])
def test_only_who_was_there_is_caught(switch: int, back: int) -> None:
    """A hand that goes to level 1 and back, while level 1 on its own is caught from instant 10 to 19."""
    at = np.where((np.arange(INSTANTS) >= switch) & (np.arange(INSTANTS) < back), 1, 0)
    with jax.enable_x64(True):
        caught = np.zeros((2, 1, INSTANTS))
        caught[1, 0, 10:20] = 5.0
        begins = np.zeros((2, 1, INSTANTS), dtype=bool)
        begins[1, 0, 10] = True
        where = places(jnp.log(jnp.array([1.0, 4.0])), jnp.zeros(1), jnp.log(jnp.array([1.0, 4.0])), jnp.zeros(2))
        moves = np.diff(at, prepend=0)
        felt, force = trapped(
            Traps(jnp.asarray(caught), jnp.asarray(0.1 * caught), jnp.asarray(begins)), where,
            jnp.asarray(np.stack([at == 0, at == 1]).astype(float)), jnp.asarray((moves == 1).astype(float)[None]),
            jnp.asarray((moves == -1).astype(float)[None]), jnp.arange(INSTANTS) == 0,
        )  # fmt: skip
    np.testing.assert_allclose(felt, 5.0 * expected(at, 10, 20), atol=1e-3)
    np.testing.assert_allclose(force, 0.1 * np.asarray(felt), atol=1e-9)
