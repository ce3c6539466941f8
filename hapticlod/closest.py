"""Exact closest points on a triangle mesh, for many points at once."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import KDTree

_CHUNK = 4000  # points per round: keeps the arrays of candidate pairs in cache
_WORKERS = -1  # threads of the tree searches
_LARGE = 4.0  # pieces larger than this many median radii are halved
_SMALL_GROUP = 0.02  # a size class with a smaller part of the pieces joins the next larger one


@dataclass(frozen=True, eq=False)
class Nearest:
    """For every query point: distance_mm (k,) float64, face (k,) int and the closest point_mm (k, 3) on that face."""

    distance_mm: np.ndarray
    face: np.ndarray
    point_mm: np.ndarray


class SurfaceIndex:
    """Finds closest points on a mesh (vertices (n, 3) mm, faces (m, 3), none without area).

    Large faces are cut into pieces, and the pieces sorted by radius (centroid to farthest corner) into a few classes
    with a tree of centroids each. The piece of the nearest centroid gives a bound d; a piece of a class can be nearer
    only if its centroid is nearer than d plus the greatest radius of the class. So the result is exact.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        corners, self._face = _pieces(vertices[faces])
        centroid, radius = _centroid_and_radius(corners)
        self._frames = _local_frames(corners[:, 0], corners[:, 1], corners[:, 2])
        # Median splits cost more to build than they save in queries here.
        self._all = KDTree(centroid, balanced_tree=False, compact_nodes=False)
        self._classes = []
        for members in _size_classes(radius):
            tree = KDTree(centroid[members], balanced_tree=False, compact_nodes=False)
            self._classes.append((members, tree, float(radius[members].max())))

    def nearest(self, points: np.ndarray) -> Nearest:
        """Closest points on the mesh for points (k, 3) mm, finite."""
        parts = [self._nearest(points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
        piece = np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
        square, point = _to_triangles(points, self._frames[piece], want_point=True)
        return Nearest(np.sqrt(square), self._face[piece], point)

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        best = np.full(len(points), np.inf)
        piece = np.zeros(len(points), dtype=np.int64)
        _, near = self._all.query(points, workers=_WORKERS)
        self._keep_nearer(points, np.arange(len(points)), np.asarray(near), best, piece)
        for members, tree, radius in self._classes:
            reach = (np.sqrt(best) + radius) * (1.0 + 1e-9)
            lists = tree.query_ball_point(points, reach, workers=_WORKERS, return_sorted=False)
            count = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
            near = np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(count.sum()))
            self._keep_nearer(points, np.repeat(np.arange(len(points)), count), members[near], best, piece)
        return piece

    def _keep_nearer(
        self, points: np.ndarray, row: np.ndarray, candidate: np.ndarray, best: np.ndarray, piece: np.ndarray
    ) -> None:
        """Lower `best` (squared) and set `piece` where a candidate of the rows (sorted) is nearer."""
        if len(row) == 0:
            return
        square, _ = _to_triangles(points[row], self._frames[candidate])
        start = np.flatnonzero(np.concatenate(([True], row[1:] != row[:-1])))
        least = np.minimum.reduceat(square, start)
        at_least = np.flatnonzero(square == np.repeat(least, np.diff(np.append(start, len(row)))))
        first = at_least[np.searchsorted(at_least, start)]
        rows = row[start]
        better = least < best[rows]
        best[rows[better]] = least[better]
        piece[rows[better]] = candidate[first[better]]


def _pieces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve large faces, corners (m, 3, 3), across their longest side: pieces (p, 3, 3), and the face (p,) of each."""
    _, radius = _centroid_and_radius(corners)
    limit = _LARGE * float(np.median(radius))
    while True:
        done, owners = [corners[radius <= limit]], [np.flatnonzero(radius <= limit)]
        large, owner = corners[radius > limit], np.flatnonzero(radius > limit)
        count = len(done[0])
        while len(large) and count + len(large) < 4 * len(corners) + 100_000:
            sides = np.linalg.norm(large - np.roll(large, -1, axis=1), axis=2)
            start = sides.argmax(axis=1)
            a, b, c = (large[np.arange(len(large)), (start + k) % 3] for k in range(3))
            middle = 0.5 * (a + b)
            halves = np.concatenate((np.stack((a, middle, c), axis=1), np.stack((middle, b, c), axis=1)))
            owner = np.concatenate((owner, owner))
            small = _centroid_and_radius(halves)[1] <= limit
            done.append(halves[small])
            owners.append(owner[small])
            count += int(small.sum())
            large, owner = halves[~small], owner[~small]
        if len(large) == 0:
            return np.concatenate(done), np.concatenate(owners)
        limit *= 2.0


def _centroid_and_radius(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    centroid = corners.mean(axis=1)
    square = np.einsum("ijk,ijk->ij", corners - centroid[:, None], corners - centroid[:, None])
    return centroid, np.sqrt(np.maximum.reduce([square[:, k] for k in range(3)]))


def _size_classes(radius: np.ndarray) -> list[np.ndarray]:
    """Pieces grouped by the power of two of their radius (p,); a group of few joins the next larger one.

    Few small pieces among large ones add few candidates; a class of their own would add a search for every point.
    """
    octave = np.floor(np.log2(radius)).astype(int)
    groups, waiting = [], np.zeros(0, dtype=np.int64)
    for value in np.unique(octave):
        waiting = np.concatenate((waiting, np.flatnonzero(octave == value)))
        if len(waiting) >= _SMALL_GROUP * len(radius):
            groups.append(waiting)
            waiting = waiting[:0]
    return [*groups, waiting] if len(waiting) else groups


def _local_frames(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Per face (m, 15): corner a, unit axes u (along ab), v (in the plane), w (normal), then b.u, c.u, c.v."""
    length = np.linalg.norm(b - a, axis=1)
    u = (b - a) / length[:, None]
    w = np.cross(u, c - a)
    w /= np.linalg.norm(w, axis=1)[:, None]
    v = np.cross(w, u)
    ac = c - a
    return np.column_stack((a, u, v, w, length, np.einsum("ij,ij->i", ac, u), np.einsum("ij,ij->i", ac, v)))


def _to_triangles(points: np.ndarray, frame: np.ndarray, want_point: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Squared distance (k,) from point i to the face of frame[i], and the closest point (k, 3) (empty unless wanted).

    In the plane of the face the triangle is (0, 0), (bx, 0), (cx, cy) with bx > 0 and cy > 0.
    """
    offset = points - frame[:, 0:3]
    x = np.einsum("ij,ij->i", offset, frame[:, 3:6])
    y = np.einsum("ij,ij->i", offset, frame[:, 6:9])
    z = np.einsum("ij,ij->i", offset, frame[:, 9:12])
    bx, cx, cy = frame[:, 12], frame[:, 13], frame[:, 14]
    inside = (y >= 0.0) & (cy * x - cx * y >= 0.0) & (cy * (bx - x) - (bx - cx) * y >= 0.0)
    qx, qy = np.clip(x, 0.0, bx), np.zeros_like(x)  # on the side along u
    least = (x - qx) ** 2 + y * y
    for start_x, start_y, along_x, along_y in ((bx, 0.0, cx - bx, cy), (0.0, 0.0, cx, cy)):
        t = ((x - start_x) * along_x + (y - start_y) * along_y) / (along_x * along_x + along_y * along_y)
        t = np.clip(t, 0.0, 1.0)
        sx, sy = start_x + t * along_x, start_y + t * along_y
        square = (x - sx) ** 2 + (y - sy) ** 2
        if want_point:
            nearer = square < least
            qx, qy = np.where(nearer, sx, qx), np.where(nearer, sy, qy)
        least = np.minimum(least, square)
    square = np.where(inside, 0.0, least) + z * z
    if not want_point:
        return square, np.zeros((0, 3))
    qx, qy = np.where(inside, x, qx), np.where(inside, y, qy)
    return square, frame[:, 0:3] + qx[:, None] * frame[:, 3:6] + qy[:, None] * frame[:, 6:9]
