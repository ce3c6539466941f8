"""Whether a contact point's way leads through a mesh: the oracle of `make soak-scans`, nothing of it the runtime's."""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.spatial import KDTree

from hapticlod.closest import SurfaceIndex
from hapticlod.topology import edge_table

_CHUNK = 20_000
# A way that grazes an edge may count it twice or not at all: a way leads through if it does so however its ends are
# shifted, by this part of the ball's radius.
_SHIFTS, _SHIFT_OF_RADIUS = 3, 0.3


class Crossings:
    """Counts how often segments cross a mesh: vertices (n, 3) float64, faces (m, 3)."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._corners = vertices[faces]
        centre = self._corners.mean(axis=1)
        radius = np.linalg.norm(self._corners - centre[:, None], axis=2).max(axis=1)
        octave = np.floor(np.log2(np.maximum(radius, 1e-30))).astype(int)
        self._classes = []
        for value in np.unique(octave):
            members = np.flatnonzero(octave == value)
            tree = KDTree(centre[members], balanced_tree=False, compact_nodes=False)
            self._classes.append((members, tree, float(radius[members].max())))
        self._border = None
        if len(border := np.unique(edge_table(faces).boundary)):
            self._border = KDTree(vertices[border])
            edges = edge_table(faces).boundary
            self._border_edge = float(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).max())

    def count(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(k,) crossings of the segments start to end (k, 3) each."""
        found = [self._count(start[i : i + _CHUNK], end[i : i + _CHUNK]) for i in range(0, len(start), _CHUNK)]
        return np.concatenate(found) if found else np.zeros(0, dtype=int)

    def near_border(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Whether an open border passes within reach (k,) of points (k, 3): round it a way may lead to the back."""
        if self._border is None:
            return np.zeros(len(points), dtype=bool)
        return self._border.query(points, workers=-1)[0] <= reach + 0.5 * self._border_edge

    def _count(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        total = np.zeros(len(start), dtype=int)
        middle, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=1)
        for members, tree, radius in self._classes:
            lists = tree.query_ball_point(middle, half + radius, workers=-1, return_sorted=False)
            number = np.fromiter(map(len, lists), dtype=np.int64, count=len(lists))
            face = members[np.fromiter(chain.from_iterable(lists), dtype=np.int64, count=int(number.sum()))]
            row = np.repeat(np.arange(len(start)), number)
            hit = _crosses(start[row], end[row], self._corners[face])
            total += np.bincount(row[hit], minlength=len(start))
        return total


def _crosses(p: np.ndarray, q: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Segment p to q against one triangle each (Moeller and Trumbore, 1997): (k,) bool."""
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    way = q - p
    h = np.cross(way, v)
    det = np.einsum("ij,ij->i", u, h)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (p - a) / det[:, None]
        along_u = np.einsum("ij,ij->i", s, h)
        g = np.cross(s, u)
        along_v = np.einsum("ij,ij->i", way, g)
        t = np.einsum("ij,ij->i", v, g)
    return (det != 0.0) & (along_u >= 0.0) & (along_v >= 0.0) & (along_u + along_v <= 1.0) & (t >= 0.0) & (t <= 1.0)


class Judge:
    """Holds the places of a tool of one ball against one level's mesh.

    The ball needs a radius: a point's SCP lies on the surface, and in a sharp groove no direction tells its side.

    Args:
        vertices: (n, 3), what the runtime has of them: float32, relative to its origin. faces: (m, 3).
        radius_mm: of the ball, above slack_mm: what the solver may be off by.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, radius_mm: float, slack_mm: float) -> None:
        self._surface = SurfaceIndex(vertices, faces)
        self._crossings = Crossings(vertices, faces)
        self._radius_mm, self._slack_mm = radius_mm, slack_mm

    def least_clearance_mm(self, scp: np.ndarray) -> float:
        """Of the ball at SCPs (k, 3), negative where it penetrates."""
        if len(scp) == 0:
            return np.inf
        return float(self._surface.nearest(scp).distance_mm.min()) - self._radius_mm

    def through(self, scp: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Which steps lead through the surface, as indices.

        A ball that is nowhere nearer than its radius cannot have passed a surface by a step shorter than its diameter;
        longer ones must cross an even number of times, but round a border.

        Args:
            scp: (T, 3). steps: indices t of steps t-1 to t to judge.
        """
        rng = np.random.default_rng(0)
        way = np.linalg.norm(scp[steps] - scp[steps - 1], axis=1)
        suspect = steps[way >= 2.0 * (self._radius_mm - self._slack_mm)]
        for number in range(_SHIFTS):
            if len(suspect) == 0:
                return suspect
            shift = rng.normal(size=(2, len(suspect), 3)) if number else np.zeros((2, len(suspect), 3))
            shift *= _SHIFT_OF_RADIUS * self._radius_mm / np.maximum(np.linalg.norm(shift, axis=2, keepdims=True), 1.0)
            crossed = self._crossings.count(scp[suspect - 1] + shift[0], scp[suspect] + shift[1])
            suspect = suspect[crossed % 2 == 1]
        reach = np.linalg.norm(scp[suspect] - scp[suspect - 1], axis=1) + 2.0 * self._radius_mm
        return suspect[~self._crossings.near_border(scp[suspect], reach)]
