"""Join vertices that are one point: equal ones, and ones within a tolerance along open borders."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from hapticlod.box import bounding_box, box_diagonal
from hapticlod.topology import edge_table, is_among

# Two border vertices nearer than this, as a part of the extent (the diagonal of the bounding box), are one point:
# 9.5 um on a dental arch of 95 mm. A crack that narrow is an artefact of export, not of the tooth.
TOLERANCE_OF_EXTENT = 1e-4
# ... but never so far that a fine mesh loses shape: at most this part of the median edge.
TOLERANCE_OF_EDGE = 0.05
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], dtype=np.uint64)


def weld_equal(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group vertices (n, 3) float64 that are equal.

    Returns:
        keep (k,): index of the first vertex of each group, ascending; group (n,): the group of every vertex.
    """
    bits = np.ascontiguousarray(vertices + 0.0).view(np.uint64)  # + 0.0 turns -0.0 into 0.0
    with np.errstate(over="ignore"):
        hashed = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        hashed = (hashed ^ (hashed >> np.uint64(29)) ^ bits[:, 1]) * np.uint64(0xBF58476D1CE4E5B9)
        hashed = (hashed ^ (hashed >> np.uint64(32)) ^ bits[:, 2]) * np.uint64(0x94D049BB133111EB)
        hashed ^= hashed >> np.uint64(31)
    order = np.argsort(hashed)
    differs = _rows_differ(bits[order])
    hashed = hashed[order]
    if bool((differs & (hashed[1:] == hashed[:-1])).any()):
        # Two points share a hash: sort by the coordinates themselves.
        order = np.lexsort((bits[:, 2], bits[:, 1], bits[:, 0]))
        differs = _rows_differ(bits[order])
    run = np.concatenate(([0], np.cumsum(differs)))
    first = np.minimum.reduceat(order, np.flatnonzero(np.concatenate(([True], differs))))
    rank = np.empty(len(first), dtype=np.int64)
    by_first = np.argsort(first)
    rank[by_first] = np.arange(len(first))
    group = np.empty(len(vertices), dtype=np.int64)
    group[order] = rank[run]
    return first[by_first], group


def _rows_differ(rows: np.ndarray) -> np.ndarray:
    """Where a row (n, 3) differs from the one before it, (n - 1,) bool."""
    change = rows[1:] != rows[:-1]
    return change[:, 0] | change[:, 1] | change[:, 2]


def weld_near_borders(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray]:
    """Make border vertices that are nearer to each other than a tolerance into one.

    Only vertices on open borders move: a mesh without cracks is returned as it came. The two ends of one edge are
    never a pair, so a short border edge stays.

    Args:
        vertices: (n, 3) float64, finite. faces: (m, 3) int, without repeated corners.

    Returns:
        The tolerance, in the unit of `vertices` (0 where there is no border), and where every vertex goes, (n,) int.
    """
    goal = np.arange(len(vertices))
    on_border = np.zeros(len(vertices), dtype=bool)
    on_border[edge_table(faces).boundary.ravel()] = True
    border = np.flatnonzero(on_border)
    if len(border) == 0:
        return 0.0, goal
    tolerance = _tolerance(vertices, faces)
    border = border[_may_have_neighbour(vertices[border], tolerance)]
    if len(border) == 0:
        return tolerance, goal
    tree = KDTree(vertices[border], balanced_tree=False, compact_nodes=False)  # built fast: it is asked once
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    if len(pairs) == 0:
        return tolerance, goal
    pairs = np.sort(border[pairs], axis=1)
    stride = len(vertices)
    edges = np.concatenate((faces[:, :2], faces[:, 1:], faces[:, [2, 0]])).astype(np.int64)
    edges = np.sort(edges[on_border[edges[:, 0]] & on_border[edges[:, 1]]], axis=1)
    pair, edge = pairs[:, 0] * stride + pairs[:, 1], edges[:, 0] * stride + edges[:, 1]
    pairs = pairs[~is_among(pair, edge[is_among(edge, pair)])]
    graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(stride, stride))
    count, label = connected_components(graph.tocsr(), directed=False)
    lowest = np.full(count, stride, dtype=np.int64)
    np.minimum.at(lowest, label, goal)
    return tolerance, lowest[label]


def _may_have_neighbour(points: np.ndarray, distance: float) -> np.ndarray:
    """Points (n, 3) that may have another within `distance`, as (n,) bool: among few a tree finds pairs fast.

    Two points that near lie in one cell of four grids, each shifted against the last by a quarter of a cell along all
    axes, where cells are four times as wide: every axis parts them in one of the four at most.
    """
    found = np.zeros(len(points), dtype=bool)
    low, high = bounding_box(points)
    # No more cells than rounding leaves room for: wider ones are right, too.
    width = max(4.001 * distance, 2.0**-36 * float((high - low).max()), np.finfo(np.float64).tiny)
    at = (points - low) / width
    for grid in range(4):
        cell = (at + 0.25 * grid).astype(np.uint64)
        with np.errstate(over="ignore"):  # equal cells have equal keys; others may, too
            key = cell[:, 0] * _MIXERS[0] + cell[:, 1] * _MIXERS[1] + cell[:, 2] * _MIXERS[2]
        order = np.argsort(key)
        alike = np.flatnonzero(key[order[1:]] == key[order[:-1]])
        found[order[alike]] = found[order[alike + 1]] = True
    return found


def _tolerance(vertices: np.ndarray, faces: np.ndarray) -> float:
    extent = box_diagonal(vertices)
    sample = faces[:: max(1, len(faces) // 100_000)]
    edge = np.linalg.norm(vertices[sample] - vertices[sample[:, [1, 2, 0]]], axis=2)
    return min(TOLERANCE_OF_EXTENT * extent, TOLERANCE_OF_EDGE * float(np.median(edge)))
