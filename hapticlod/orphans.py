"""Vertices that lose their last face during simplification: who stands for them in the coarser meshes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree


def adopt_isolated(
    vertices: np.ndarray,
    faces: np.ndarray,
    parent: np.ndarray,
    step: np.ndarray,
    death: np.ndarray,
    kept: np.ndarray,
    position: np.ndarray,
) -> None:
    """Give every vertex that was never merged, but has no face left in the end, a parent (`parent`, `step` change).

    It goes to the other end of the edge that its last face became. Where that one is without faces too (a small island
    has vanished), it goes to the nearest vertex that stays to the end, so that the meshes remain nested.

    Args:
        vertices, faces: the full mesh. parent, step, death, kept, position: as in CollapseList.
    """
    last = len(kept)
    root = np.where(step <= last, parent, np.arange(len(parent)))
    while not np.array_equal(root, root[root]):
        root = root[root]
    stays = np.zeros(len(vertices), dtype=bool)
    stays[root[faces[death > last]].ravel()] = True
    isolated = np.zeros(len(vertices), dtype=bool)
    isolated[root[faces].ravel()] = True
    isolated &= ~stays
    if not isolated.any():
        return
    final = vertices.copy()
    final[kept] = position
    survivors = np.flatnonzero(stays)
    tree = KDTree(final[survivors])
    touching = np.flatnonzero(isolated[root[faces]].any(axis=1))
    touching = touching[np.argsort(death[touching], kind="stable")]
    last_face = dict(zip(root[faces[touching]].ravel().tolist(), np.repeat(touching, 3).tolist(), strict=True))
    for vertex in np.flatnonzero(isolated).tolist():
        face = last_face[vertex]
        when = int(death[face])
        other = next((int(corner) for corner in faces[face] if root[corner] != vertex), vertex)
        if isolated[root[other]]:
            parent[vertex] = survivors[tree.query(final[vertex])[1]]
        else:
            while step[other] <= when:
                other = int(parent[other])
            parent[vertex] = other
        step[vertex] = when
