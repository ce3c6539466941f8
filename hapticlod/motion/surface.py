"""A scan's surface as an oriented point cloud to walk on: smooth at a chosen spacing, indifferent to dirty topology.

Points are laid on the triangles and averaged in voxels; the surface near a place is the plane that its weighted
neighbours agree on (moving least squares, Levin 1998; Alexa et al. 2003). Cracks, slivers, duplicate and
non-manifold faces do no harm, and scanner noise below the spacing is what a hand would not follow anyway.
"""

from collections.abc import Callable
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hapticlod.errors import InputError

Array = NDArray[np.float64]

_CLOUD_POINTS = 150_000  # about as many as the spacing aims at
_MOST_SAMPLES = 4_000_000
_NEIGHBOURS = 8
_LEAF = 32  # points: from a ball's centre many are about as near, and scipy's 10 makes twice the way
_SEATINGS = 12
SEATED = 0.98  # of its radius a ball is from the surface that it rests on


class ScanLike(Protocol):
    """What is needed of a scan."""

    @property
    def vertices(self) -> Any: ...
    @property
    def faces(self) -> Any: ...


class Surface:
    """An oriented cloud.

    Attributes:
        points_mm: (M, 3); normals: (M, 3) unit, outward as the scan's faces are.
        spacing_mm: voxel edge of the cloud.
        extent_mm: diagonal of its box.
        border_mm: (M,) distance to the nearest open border, at most `margin_mm`, infinite where there is none near.
        border_away: (M, 3) unit vector away from that border, 0 where there is none near.
    """

    def __init__(self, scan: ScanLike) -> None:
        vertices = np.asarray(scan.vertices, dtype=np.float64)
        faces = np.asarray(scan.faces)
        corners = vertices[faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled_area = np.linalg.norm(cross, axis=1)
        solid = doubled_area > 0
        if not solid.any():
            raise InputError("scan", "has no area to move on", "give a mesh with triangles")
        corners, cross, doubled_area = corners[solid], cross[solid], doubled_area[solid]
        area = float(doubled_area.sum()) / 2.0
        self.extent_mm = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self.spacing_mm = max(float(np.sqrt(area / _CLOUD_POINTS)), 1e-6 * self.extent_mm)
        samples, of_face = _samples(corners, doubled_area / 2.0, self.spacing_mm)
        weights = (doubled_area / np.bincount(of_face, minlength=len(doubled_area)))[of_face]
        normals = (cross / doubled_area[:, None])[of_face]
        self.points_mm, self.normals, self.weights = _averaged(samples, normals, weights, self.spacing_mm)
        self.tree = KDTree(self.points_mm, leafsize=_LEAF)
        self.margin_mm = 0.04 * self.extent_mm
        self.border_mm, self.border_away = self._borders(vertices, faces)

    def nearest(self, place_mm: Array, count: int) -> tuple[Array, NDArray[np.intp]]:
        """Distances (n,), increasing, of the nearest points to one place (3,), and these points, by index."""
        # What KDTree adds to its parent is checks, which take as long as the search for one place.
        distance, nearest = super(KDTree, self.tree).query(place_mm, min(count, len(self.points_mm)))
        return np.atleast_1d(distance), np.atleast_1d(nearest)

    def project(self, places_mm: Array) -> tuple[Array, Array]:
        """Nearest smooth surface points (K, 3) mm and unit normals (K, 3) for `places_mm` (K, 3) near the surface."""
        distance, nearest = _nearest(self.tree, places_mm, min(_NEIGHBOURS, len(self.points_mm)))
        normals = self.normals[nearest]
        agree = np.einsum("ijk,ik->ij", normals, normals[:, 0]) > 0.2  # not the far side of a thin wall
        weight = np.exp(-np.square(distance / (1.5 * self.spacing_mm + distance[:, :1]))) * agree
        weight /= weight.sum(axis=1, keepdims=True)
        centre = np.einsum("ij,ijk->ik", weight, self.points_mm[nearest])
        normal = np.einsum("ij,ijk->ik", weight, normals)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        height = np.einsum("ik,ik->i", places_mm - centre, normal)
        return places_mm - height[:, None] * normal, normal

    def carries(self, radius_mm: float) -> bool:
        """Whether a ball of `radius_mm` rests on the cloud's points; a smaller one would slip between them."""
        return radius_mm >= self.spacing_mm

    def clearance_mm(self, places_mm: Array) -> Array:
        """Distance (K,) of `places_mm` (K, 3) from the nearest point of the cloud."""
        return _nearest(self.tree, places_mm, 1)[0][:, 0]

    def seated(self, centres_mm: Array, radius_mm: float) -> tuple[Array, Array]:
        """Centres (K, 3) of balls that rest on the surface next to `centres_mm` (K, 3), and contact normals (K, 3).

        The balls must be beside the surface already, on the right side of it: see `hapticlod.motion.roll`.
        """
        centres = self._cleared(centres_mm, radius_mm, np.abs)
        distance, nearest = _nearest(self.tree, centres, min(_NEIGHBOURS, len(self.points_mm)))
        away = (centres[:, None] - self.points_mm[nearest]) / np.maximum(distance, 1e-12)[:, :, None]
        weight = np.exp((distance[:, :1] ** 2 - np.square(distance)) / self.spacing_mm**2)
        normals = np.einsum("ij,ijk->ik", weight, away)
        return centres, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def pushed_out(self, centres_mm: Array, radius_mm: float) -> Array:
        """`centres_mm` (K, 3) of a ball; those that sink into the surface are lifted until it rests on it."""
        if self.carries(radius_mm):
            return self._cleared(centres_mm, radius_mm, lambda short: short)
        places, normals = self.project(centres_mm)
        height = np.einsum("ij,ij->i", centres_mm - places, normals)
        return centres_mm + np.maximum(radius_mm - height, 0.0)[:, None] * normals

    def _cleared(self, centres_mm: Array, radius_mm: float, counts: Callable[[Array], Array]) -> Array:
        """`centres_mm` (K, 3), moved along the line from the nearest point while what is missing (K,) counts."""
        centres = centres_mm.copy()
        left = np.arange(len(centres))
        for _ in range(_SEATINGS):
            distance, nearest = _nearest(self.tree, centres[left], 1)
            off = counts(radius_mm - distance[:, 0]) > 0.5 * (1.0 - SEATED) * radius_mm
            left = left[off]
            if len(left) == 0:
                break
            touched = self.points_mm[nearest[off, 0]]
            away = (centres[left] - touched) / np.maximum(distance[off], 1e-9 * radius_mm)
            centres[left] = touched + radius_mm * away
        return centres

    def bearing_mm(self, places_mm: Array, normals: Array, depth_mm: Array) -> Array:
        """How deep (K,) a HIP may go below `places_mm` (K, 3) before another flank is as near as the one above it.

        A ball that touches the place from inside is shrunk until it crosses the surface no more (Ma, Bae and Choi
        2012): its radius is the distance to the medial axis, where the surface contact point would change flanks.
        Never more than the wanted `depth_mm` (K,).
        """
        radius = depth_mm.copy()
        left = np.flatnonzero(radius > self.spacing_mm)
        for _ in range(8):
            distance, nearest = _nearest(self.tree, places_mm[left] - radius[left, None] * normals[left], 1)
            crossing = distance[:, 0] < 0.95 * radius[left] - 0.25 * self.spacing_mm
            left = left[crossing]
            if len(left) == 0:
                break
            chord = places_mm[left] - self.points_mm[nearest[crossing, 0]]
            rise = np.maximum(np.einsum("ij,ij->i", chord, normals[left]), 1e-12)
            shrunk = np.einsum("ij,ij->i", chord, chord) / (2.0 * rise)
            radius[left] = np.clip(shrunk, 0.5 * self.spacing_mm, 0.9 * radius[left])
        return radius

    def near_share(self, places_mm: Array, within_mm: float) -> float:
        """Share of `places_mm` (K, 3) that lie within `within_mm` of the surface."""
        distance, _ = self.tree.query(places_mm, distance_upper_bound=within_mm + self.spacing_mm)
        return float(np.mean(np.isfinite(distance)))

    def _borders(self, vertices: Array, faces: NDArray[Any]) -> tuple[Array, Array]:
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        keys, counts = np.unique(edges[:, 0].astype(np.int64) * len(vertices) + edges[:, 1], return_counts=True)
        single = keys[counts == 1]
        far, away = np.full(len(self.points_mm), np.inf), np.zeros_like(self.points_mm)
        if len(single) == 0:
            return far, away
        middles = 0.5 * (vertices[single // len(vertices)] + vertices[single % len(vertices)])
        distance, nearest = _nearest(KDTree(middles), self.points_mm, 1, self.margin_mm)
        near = np.isfinite(distance[:, 0])
        far[near] = distance[near, 0]
        away[near] = self.points_mm[near] - middles[nearest[near, 0]]
        away[near] /= np.maximum(np.linalg.norm(away[near], axis=1, keepdims=True), 1e-12)
        return far, away


_surfaces: WeakKeyDictionary[Any, Surface] = WeakKeyDictionary()


def surface_of(scan: ScanLike) -> Surface:
    """The surface of a scan, made once per scan object."""
    try:
        if scan not in _surfaces:
            _surfaces[scan] = Surface(scan)
        return _surfaces[scan]
    except TypeError:  # no weak reference to it can be held
        return Surface(scan)


def _nearest(tree: KDTree, places: Array, count: int, within: float = np.inf) -> tuple[Array, NDArray[np.intp]]:
    """Distances and indices (K, count); beyond `within` the distance is infinite."""
    distance, nearest = tree.query(places, k=count, distance_upper_bound=within)
    return np.reshape(distance, (len(places), count)), np.reshape(nearest, (len(places), count)).astype(np.intp)


def _samples(corners: Array, areas: Array, spacing: float) -> tuple[Array, NDArray[np.intp]]:
    """Points on the triangles, one at least on each, about one per `spacing` squared; and their triangles."""
    counts = np.maximum(np.ceil(areas / spacing**2), 1).astype(np.int64)
    if counts.sum() > max(_MOST_SAMPLES, len(areas)):
        counts = np.maximum(counts * (_MOST_SAMPLES / counts.sum()), 1).astype(np.int64)
    of_face = np.repeat(np.arange(len(areas)), counts)
    rank = np.arange(len(of_face)) - np.repeat(np.cumsum(counts) - counts, counts)
    # one point: the centroid; several: a lattice of the plastic number (Roberts 2018), folded into the triangle
    a, b = (0.7548776662466927 * rank + 1 / 3) % 1.0, (0.5698402909980532 * rank + 1 / 3) % 1.0
    folded = a + b > 1.0
    a, b = np.where(folded, 1.0 - a, a), np.where(folded, 1.0 - b, b)
    first = corners[of_face, 0]
    points = first + a[:, None] * (corners[of_face, 1] - first) + b[:, None] * (corners[of_face, 2] - first)
    return points, of_face


def _averaged(points: Array, normals: Array, weights: Array, spacing: float) -> tuple[Array, Array, Array]:
    """Weighted means per voxel; faces that look different ways stay apart, so that thin walls keep two sides."""
    cell = np.floor((points - points.min(axis=0)) / spacing).astype(np.int64)
    side = np.argmax(np.abs(normals), axis=1)
    side = 2 * side + (np.take_along_axis(normals, side[:, None], axis=1)[:, 0] < 0)
    sizes = cell.max(axis=0) + 1
    key = ((cell[:, 0] * sizes[1] + cell[:, 1]) * sizes[2] + cell[:, 2]) * 6 + side
    _, group = np.unique(key, return_inverse=True)
    total = np.bincount(group, weights).astype(np.float64)
    mean = np.stack([np.bincount(group, weights * points[:, k]) / total for k in range(3)], axis=1)
    normal = np.stack([np.bincount(group, weights * normals[:, k]) for k in range(3)], axis=1)
    length = np.linalg.norm(normal, axis=1)
    keep = length > 1e-9 * total.max()
    outward = normal[keep] / length[keep, None]
    return mean[keep], outward, total[keep]
