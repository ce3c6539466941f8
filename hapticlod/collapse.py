"""One list of edge collapses from the scan to its coarsest rung; every prefix of it is a level of detail.

The list comes from fast-simplification (quadric error metric: Garland and Heckbert, 1997). The library keeps its state
in globals and its thresholds are absolute, so it runs under a lock, on coordinates scaled to about 1000 units. What a
prefix looks like is worked out here: the position of a merged vertex depends only on the quadrics merged into it, and
in one pass of the library a vertex takes part in one collapse at most, so the list replays in a few dozen array steps.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hapticlod.islands import Collapses, drop_islands, find_islands
from hapticlod.orphans import adopt_isolated
from hapticlod.skirt import add_skirt
from hapticlod.topology import edge_table

SIMPLIFIED_EXTENT = 1000.0
_LOCK = threading.Lock()  # two runs at once give wrong meshes without a word
# Faces are handed over in this many interleaved sweeps, so that a prefix that ends inside a pass of the library is
# evenly fine everywhere instead of coarse where the pass has been and fine where it has not.
_SWEEPS = 16


@dataclass(frozen=True, eq=False)
class CollapseList:
    """Collapses of a mesh of m faces, in order. Its n vertices are followed by those of the skirt along its borders.

    Islands go by the rule of `hapticlod.islands`: with a collapse, or after the last as one that moves nothing.

    Attributes:
        vertices, faces: (n + skirt, 3) float64 and (m, 3) int.
        vertex_count: n.
        parent: (n + skirt,) int, the vertex that each vertex became part of; itself where it never did.
        step: (n + skirt,) int, how many collapses have been made when that has happened; c + 1 where it never does.
        kept: (c,) int, the vertex that each collapse kept.
        position: (c, 3) float64, where it put that vertex, in the unit of the mesh.
        face_death: (m,) int, number of collapses after which the face is gone; c + 1 where it stays.
        alive_after: (c + 1,) int, number of faces left after 0, 1, ... c collapses.
    """

    vertices: np.ndarray
    faces: np.ndarray
    vertex_count: int
    parent: np.ndarray
    step: np.ndarray
    kept: np.ndarray
    position: np.ndarray
    face_death: np.ndarray
    alive_after: np.ndarray

    def collapses_for(self, triangles: int) -> int:
        """The least number of collapses that leaves at most so many faces; all of them where none does."""
        return min(int(np.searchsorted(-self.alive_after, -triangles)), len(self.kept))

    def alive(self, collapses: int) -> np.ndarray:
        """Which faces (m,) bool of the full mesh are left after so many collapses, in the order of `mesh`'s."""
        return self.face_death > collapses

    def mesh(self, collapses: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The mesh after so many collapses.

        Returns:
            vertices (v, 3) float64, faces (f, 3) int32, and for every vertex of the full mesh its vertex (n,) int32 in
            this one. Order is kept: what stays follows the order of the full mesh. A vertex may be without faces.
        """
        root = self._roots(collapses)
        corners = root[self.faces[self.alive(collapses)]]
        moved = self.vertices.copy()
        # Where a vertex was kept several times the last assignment stays, which is its last position.
        moved[self.kept[:collapses]] = self.position[:collapses]
        used = np.zeros(len(moved), dtype=bool)
        used[corners.ravel()] = True
        used[root[: self.vertex_count]] = True
        new = (np.cumsum(used) - 1).astype(np.int32)
        return moved[used], new[corners], new[root[: self.vertex_count]]

    def _roots(self, collapses: int) -> np.ndarray:
        """The vertex (n + skirt,) that every vertex has become part of after so many collapses."""
        root = np.where(self.step <= collapses, self.parent, np.arange(len(self.parent)))
        while True:
            above = root[root]
            if np.array_equal(above, root):
                return root
            root = above


def collapse(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> CollapseList:
    """Simplify a clean mesh to about `triangles` faces and work out the list of collapses.

    The list may end earlier (the simplifier found nothing more to collapse without turning a face over).

    Args:
        vertices: (n, 3) float64. faces: (m, 3) int, in range, none without area: the simplifier crashes or returns
            nonsense on anything else.
        triangles: at least 1.
    """
    faces = np.asarray(faces, dtype=np.int64)
    vertex_count = len(vertices)
    centre = 0.5 * (vertices.max(axis=0) + vertices.min(axis=0))
    scale = SIMPLIFIED_EXTENT / float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))
    points, corners = add_skirt((vertices - centre) * scale, faces)
    vertices = np.concatenate((vertices, points[len(vertices) :] / scale + centre))
    corners = corners[np.argsort(np.arange(len(corners)) % _SWEEPS, kind="stable")]
    pairs = _simplify(points, corners, triangles)
    place = _replay(points, corners, pairs) / scale + centre
    kept, gone = pairs[:, 0], pairs[:, 1]
    never = len(pairs) + 1
    parent = np.arange(len(vertices))
    parent[gone] = kept
    step = np.full(len(vertices), never, dtype=np.int64)
    step[gone] = np.arange(1, never)
    death = _face_death(faces, parent, step)
    alive = len(faces) - np.cumsum(np.bincount(death, minlength=never + 1)[:never])
    # Something must be left to touch.
    last = int(np.flatnonzero(alive >= min(triangles, alive[0]))[-1])
    if last + 1 < never:
        undone = step > last
        parent[undone], step[undone] = np.flatnonzero(undone), last + 1
        death = np.minimum(death, last + 1)
        kept, place, alive = kept[:last], place[:last], alive[: last + 1]
    if (islands := find_islands(vertices, faces, corners)) is not None:
        final = vertices.copy()
        final[kept] = place
        made = drop_islands(islands, faces, triangles, Collapses(parent, step, death, kept, place, final))
        parent, step, death, kept, place = made.parent, made.step, made.death, made.kept, made.place
        alive = len(faces) - np.cumsum(np.bincount(death, minlength=len(kept) + 2)[: len(kept) + 1])
    adopt_isolated(vertices, faces, parent, step, death, kept, place)
    return CollapseList(vertices, faces, vertex_count, parent, step, kept, place, death, alive)


def _simplify(points: np.ndarray, faces: np.ndarray, triangles: int) -> np.ndarray:
    """Pairs (c, 2) int64 of the vertex kept and the vertex merged into it, in the order of the library."""
    import fast_simplification

    corners = np.ascontiguousarray(faces, dtype=np.int32)
    with _LOCK:
        result = fast_simplification.simplify(
            np.ascontiguousarray(points), corners, target_count=min(triangles, len(faces)), return_collapses=True
        )
    return np.asarray(result[-1], dtype=np.int64).reshape(-1, 2)


def _replay(points: np.ndarray, faces: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Position (c, 3) of the kept vertex after each collapse, as the library computed it (its calculate_error)."""
    quadric = _vertex_quadrics(points, faces)
    border = np.zeros(len(points), dtype=bool)
    border[edge_table(faces).boundary.ravel()] = True
    point = points.copy()
    place = np.empty((len(pairs), 3))
    for wave in _waves(pairs, len(points)):
        a, b = pairs[wave, 0], pairs[wave, 1]
        merged = quadric[b] + quadric[a]
        place[wave] = _best_point(merged, point[a], point[b], border[a] & border[b])
        point[a] = place[wave]
        quadric[a] = merged
    return place


def _waves(pairs: np.ndarray, vertex_count: int) -> Iterator[np.ndarray]:
    """Groups of collapses that do not depend on each other, in order: those that come first for both their vertices."""
    left = np.arange(len(pairs))
    first = np.empty(vertex_count, dtype=np.int64)
    while len(left):
        a, b = pairs[left, 0], pairs[left, 1]
        # Written backwards, so that the earliest collapse of a vertex is the one that remains.
        first[np.column_stack((b, a)).ravel()[::-1]] = np.repeat(left, 2)[::-1]
        ready = (first[a] == left) & (first[b] == left)
        yield left[ready]
        left = left[~ready]


def _vertex_quadrics(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sum (n, 10) of the plane quadrics of the faces around every vertex, unweighted as in the library."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    plane = np.column_stack((normal, -np.einsum("ij,ij->i", normal, a)))
    corner = faces.ravel()
    terms = [(i, j) for i in range(4) for j in range(i, 4)]
    columns = [
        np.bincount(corner, weights=np.repeat(plane[:, i] * plane[:, j], 3), minlength=len(points)) for i, j in terms
    ]
    return np.column_stack(columns)


def _best_point(q: np.ndarray, p: np.ndarray, r: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Point (w, 3) of least quadric error q (w, 10); where that is undefined, the best of p, r and their middle."""

    def det(*k: int) -> np.ndarray:
        a11, a12, a13, a21, a22, a23, a31, a32, a33 = (q[:, i] for i in k)
        plus = a11 * a22 * a33 + a13 * a21 * a32 + a12 * a23 * a31
        return plus - a13 * a22 * a31 - a11 * a23 * a32 - a12 * a21 * a33

    whole = det(0, 1, 2, 1, 4, 5, 2, 5, 7)
    with np.errstate(divide="ignore", invalid="ignore"):
        best = np.column_stack(
            (
                -1 / whole * det(1, 2, 3, 4, 5, 6, 5, 7, 8),
                1 / whole * det(0, 2, 3, 1, 5, 6, 2, 7, 8),
                -1 / whole * det(0, 1, 3, 1, 4, 6, 2, 5, 8),
            )
        )
    plain = np.flatnonzero((whole == 0.0) | border)
    if len(plain):
        choices = np.stack((p[plain], r[plain], (p[plain] + r[plain]) / 2))
        errors = np.stack([_error(q[plain], choice) for choice in choices])
        # The library lets a later choice win a tie.
        pick = len(choices) - 1 - np.argmin(errors[::-1], axis=0)
        best[plain] = choices[pick, np.arange(len(plain))]
    return best


def _error(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    x, y, z = p.T
    return (
        q[:, 0] * x * x + 2 * q[:, 1] * x * y + 2 * q[:, 2] * x * z + 2 * q[:, 3] * x + q[:, 4] * y * y
        + 2 * q[:, 5] * y * z + 2 * q[:, 6] * y + q[:, 7] * z * z + 2 * q[:, 8] * z + q[:, 9]
    )  # fmt: skip


def _face_death(faces: np.ndarray, parent: np.ndarray, step: np.ndarray) -> np.ndarray:
    """When two corners of each face become one: both walk up the forest, the earlier move first, until they meet."""
    never = int(step.max())
    death = np.full(len(faces), never, dtype=np.int64)
    for k in range(3):
        a, b = faces[:, k].copy(), faces[:, (k + 1) % 3].copy()
        active = np.arange(len(faces))
        while len(active):
            u, v = a[active], b[active]
            first = step[u] <= step[v]
            mover = np.where(first, u, v)
            when = step[mover]
            go = when < death[active]  # otherwise neither moves any more, or the face is gone before
            active, first, mover, when = active[go], first[go], mover[go], when[go]
            a[active] = np.where(first, parent[mover], a[active])
            b[active] = np.where(first, b[active], parent[mover])
            met = a[active] == b[active]
            death[active[met]] = when[met]
            active = active[~met]
    return death
