"""Faces without area: contract dust edges, flip caps, so that removing such a face opens no crack."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from hapticlod.topology import is_among

_PASSES = 8  # a cap may lean on another cap; chains longer than this are left open


def squared(vectors: np.ndarray) -> np.ndarray:
    """Squared length (n,) of vectors (n, 3)."""
    return np.einsum("ij,ij->i", vectors, vectors)


def is_flat(vertices: np.ndarray, faces: np.ndarray, height: float) -> np.ndarray:
    """Faces (m,) bool whose least height is at most `height` (unit of `vertices`), repeated corners included."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    longest = np.maximum.reduce([squared(b - a), squared(c - b), squared(a - c)])
    return squared(np.cross(b - a, c - a)) <= height**2 * longest  # (2 area)^2 = (height * longest edge)^2


def contract_dust(vertices: np.ndarray, faces: np.ndarray, length: float) -> np.ndarray:
    """Where every vertex goes, (n,) int, when the ends of each edge no longer than `length` become one."""
    goal = np.arange(len(vertices))
    edges = np.concatenate((faces[:, :2], faces[:, 1:], faces[:, [2, 0]]))
    dust = edges[squared(vertices[edges[:, 0]] - vertices[edges[:, 1]]) <= length**2]
    dust = dust[dust[:, 0] != dust[:, 1]]
    if len(dust) == 0:
        return goal
    size = len(vertices)
    graph = coo_matrix((np.ones(len(dust), dtype=np.int8), (dust[:, 0], dust[:, 1])), shape=(size, size))
    count, label = connected_components(graph.tocsr(), directed=False)
    lowest = np.full(count, size, dtype=np.int64)
    np.minimum.at(lowest, label, goal)
    return lowest[label]


def flip_caps(vertices: np.ndarray, faces: np.ndarray, height: float, source: np.ndarray | None = None) -> np.ndarray:
    """Faces (m, 3) with every cap mended that can be.

    A cap is a face without area, the corner c of which lies on its longest edge (a, b). Dropping it would leave the
    neighbour (b, a, d) with a vertex in the middle of its edge. Instead the shared edge is flipped: (a, b, c) and
    (b, a, d) become (a, d, c) and (d, b, c), which cover what the neighbour covered. `source` (m,), what each face
    comes from, is changed accordingly.
    """
    faces = faces.copy()
    for _ in range(_PASSES):
        caps = np.flatnonzero(is_flat(vertices, faces, height))
        caps = caps[~_repeats(faces[caps])]
        if len(caps) == 0:
            break
        stride = len(vertices)
        corners = vertices[faces[caps]]
        long = np.argmax(np.stack([squared(corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)]), axis=0)
        row = np.arange(len(caps))
        a, b, c = (faces[caps][row, (long + k) % 3] for k in range(3))
        all_a, all_b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
        key = np.minimum(all_a, all_b) * stride + np.maximum(all_a, all_b)
        wanted = np.minimum(a, b) * stride + np.maximum(a, b)
        near = np.flatnonzero(is_among(key, wanted))
        near = near[np.argsort(key[near], kind="stable")]
        left, right = np.searchsorted(key[near], wanted, "left"), np.searchsorted(key[near], wanted, "right")
        touched: set[int] = set()
        for i in np.flatnonzero(right - left == 2):
            other = int(near[left[i]] if near[left[i]] // 3 != caps[i] else near[left[i] + 1])
            face, cap = other // 3, int(caps[i])
            if face in touched or cap in touched or all_a[other] != b[i]:
                continue
            d = int(faces[face, (other + 2 - 3 * face) % 3])
            new = np.array([[a[i], d, c[i]], [d, b[i], c[i]]])
            if d == c[i] or is_flat(vertices, new, height).any():
                continue
            faces[cap], faces[face] = new
            if source is not None:
                source[cap] = source[face]
            touched.update((face, cap))
        if not touched:
            break
    return faces


def _repeats(faces: np.ndarray) -> np.ndarray:
    return (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
