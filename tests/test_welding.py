"""Which vertices are joined, held against every pair."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from hapticlod.welding import weld_near_borders


@pytest.mark.parametrize("offset", [0.0, 1e5, -3e8])
@pytest.mark.parametrize("seed", range(5))
def test_every_pair_within_the_tolerance_is_found(seed: int, offset: float) -> None:
    """Loose triangles, some with a corner a little less or more than the tolerance from another's."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0.0, 100.0, (300, 1, 3)) + rng.normal(0.0, 1.0, (300, 3, 3))
    points, faces = corners.reshape(-1, 3) + offset, np.arange(900).reshape(-1, 3)
    tolerance, _ = weld_near_borders(points, faces)
    way = rng.normal(size=(100, 3))
    way *= tolerance * rng.uniform(0.9, 1.1, (100, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    points[:300:3] = points[450:750:3] + way
    tolerance, goal = weld_near_borders(points, faces)
    near = cdist(points, points) <= tolerance
    assert near.sum() > len(points) + 20
    for one, other in np.argwhere(near):
        assert goal[one] == goal[other] or one // 3 == other // 3
    joined = goal != np.arange(len(goal))
    assert (near[joined].sum(axis=1) > 1).all()


def test_a_tolerance_far_below_what_numbers_resolve() -> None:
    """Cells of that width could not be counted."""
    points = np.array([[0, 0, 0], [1e-12, 0, 0], [0, 1e-12, 0], [1e9, 1e9, 1e9], [1e9, 1e9 + 1, 1e9], [0, 0, 2e-12]])
    tolerance, goal = weld_near_borders(points, np.array([[0, 1, 2], [0, 1, 5], [0, 2, 5], [3, 4, 5]]))
    assert 0.0 < tolerance < 1e-10 and (goal == np.arange(6)).all()
