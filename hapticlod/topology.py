"""Edges, components and orientation of a triangle mesh, in whole-array operations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, eq=False)
class EdgeTable:
    """What every edge of a mesh joins.

    Attributes:
        boundary: (b, 2) int, vertices of the edges with one face, in that face's direction.
        pairs: (p, 2) int, the two faces of each edge that has exactly two.
        consistent: (p,) bool, true where the two faces run through their edge in opposite directions.
        non_manifold: number of edges with more than two faces.
    """

    boundary: np.ndarray
    pairs: np.ndarray
    consistent: np.ndarray
    non_manifold: int


def edge_table(faces: np.ndarray) -> EdgeTable:
    """Sort the 3 m half-edges of `faces` (m, 3) by their vertices and read the edges off."""
    start = np.asarray(faces, dtype=np.int64).ravel()
    end = np.asarray(faces, dtype=np.int64)[:, [1, 2, 0]].ravel()
    stride = int(start.max(initial=0)) + 1
    key = np.minimum(start, end) * stride + np.maximum(start, end)
    order = np.argsort(key)
    key = key[order]
    first = np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1]))) if len(key) else np.zeros(0, np.int64)
    count = np.diff(np.append(first, len(key)))
    single = order[first[count == 1]]
    one, two = order[first[count == 2]], order[first[count == 2] + 1]
    return EdgeTable(
        boundary=np.column_stack((start[single], end[single])),
        pairs=np.column_stack((one // 3, two // 3)),
        consistent=start[one] == end[two],
        non_manifold=int((count > 2).sum()),
    )


def vertex_components(faces: np.ndarray, vertex_count: int) -> tuple[int, np.ndarray]:
    """Number of components (joined through shared vertices) that have faces, and the component (m,) of each face."""
    if len(faces) == 0:
        return 0, np.zeros(0, dtype=np.int32)
    rows = np.concatenate((faces[:, 0], faces[:, 1]))
    columns = np.concatenate((faces[:, 1], faces[:, 2]))
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(vertex_count, vertex_count))
    _, label = connected_components(graph.tocsr(), directed=False)
    of_face = label[faces[:, 0]]
    used = np.zeros(int(label.max()) + 1, dtype=bool)
    used[of_face] = True
    return int(used.sum()), (np.cumsum(used, dtype=np.int32) - 1)[of_face]


def is_among(values: np.ndarray, few: np.ndarray) -> np.ndarray:
    """Which of many integers (k,) occur in `few` (j,), as (k,) bool; np.isin would sort or hash the many."""
    if len(few) == 0:
        return np.zeros(len(values), dtype=bool)
    known = np.sort(few)
    return known[np.minimum(np.searchsorted(known, values), len(known) - 1)] == values
