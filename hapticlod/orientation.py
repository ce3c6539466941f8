"""Make neighbouring faces agree on their outer side, and closed components face outward."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from hapticlod.topology import EdgeTable

# How many of the largest components are asked whether a closed one lies inside them.
LARGEST_BOXES = 256


def faces_to_flip(face_count: int, edges: EdgeTable) -> np.ndarray:
    """Which faces (m,) bool to turn so that neighbours agree, turning the smaller part of every patch.

    Patches are joined through edges of exactly two faces. Every face has two nodes, "kept" and "turned"; an edge joins
    equal nodes where its faces agree and opposite nodes where they do not. In an orientable patch the two nodes of a
    face fall into different components of this double cover; a patch that cannot be oriented (a Moebius strip) is left.
    """
    if bool(edges.consistent.all()):
        return np.zeros(face_count, dtype=bool)
    one, two = edges.pairs[:, 0], edges.pairs[:, 1]
    turned = np.where(edges.consistent, 0, face_count)
    rows = np.concatenate((one, one + face_count))
    columns = np.concatenate((two + turned, two + (face_count - turned)))
    size = 2 * face_count
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(size, size))
    _, label = connected_components(graph.tocsr(), directed=False)
    kept, flipped = label[:face_count], label[face_count:]
    # The side of the cover that keeps more faces wins; equal sides keep the side of the patch's first face.
    votes = np.bincount(kept, minlength=int(label.max()) + 1)
    return (votes[flipped] > votes[kept]) | ((votes[flipped] == votes[kept]) & (flipped < kept))


def signed_volumes(vertices: np.ndarray, faces: np.ndarray, component: np.ndarray, count: int) -> np.ndarray:
    """Signed volume (count,) of every component, in cubed units of `vertices`; meaningful where it is closed."""
    centre = vertices.mean(axis=0)  # far from the origin the sum of huge terms would drown the volume
    a, b, c = (vertices[faces[:, k]] - centre for k in range(3))
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.bincount(component, weights=six, minlength=count) / 6.0


def inside_out(
    vertices: np.ndarray, faces: np.ndarray, parts: int, part: np.ndarray, edges: EdgeTable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which components (parts,) are closed, which of those point inward, and which of those must be turned.

    A closed component that points inward is a fault, unless it is the wall of a cavity. So one that lies in the box of
    another component is turned only where that other one is: then the whole body came inverted.
    """
    open_vertices = np.zeros(len(vertices), dtype=bool)
    open_vertices[edges.boundary.ravel()] = True
    is_open = np.zeros(parts, dtype=bool)
    corner_open = open_vertices[faces]
    is_open[part[corner_open[:, 0] | corner_open[:, 1] | corner_open[:, 2]]] = True
    clash = edges.pairs[~edges.consistent]
    is_open[part[clash[:, 0]]] = True  # a component that cannot be oriented has no inside
    closed = ~is_open
    inward = closed & (signed_volumes(vertices, faces, part, parts) < 0.0)
    if not inward.any():
        return closed, inward, inward
    of_vertex = np.zeros(len(vertices), dtype=part.dtype)
    of_vertex[faces.ravel()] = np.repeat(part, 3)
    order = np.argsort(of_vertex, kind="stable")
    start = np.searchsorted(of_vertex[order], np.arange(parts))
    low = np.minimum.reduceat(vertices[order], start)
    high = np.maximum.reduceat(vertices[order], start)
    largest = np.argsort(-np.linalg.norm(high - low, axis=1), kind="stable")[:LARGEST_BOXES]
    container = np.full(parts, -1)
    for outer in largest[::-1]:  # the largest box is asked last and wins
        container[((low > low[outer]) & (high < high[outer])).all(axis=1)] = outer
    outermost = container < 0
    outward = inward & (outermost | (inward & outermost)[container])
    return closed, inward, outward
