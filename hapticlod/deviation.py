"""How far a simplified mesh lies from its scan: rms and Hausdorff distance, by samples in both directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hapticlod.closest import SurfaceIndex
from hapticlod.skirt import vertex_normals
from hapticlod.topology import edge_table

SAMPLES = 8000  # on each surface, evenly over its area
_WORST = 60  # samples around which the greatest distance is searched further
_SUSPECTS = 1500  # vertices asked because they left their tangent plane most


@dataclass(frozen=True)
class Deviation:
    """Distance between a mesh and its scan.

    Attributes:
        rms_mm: root mean square distance, both directions weighted alike.
        hausdorff_mm: greatest distance found in either direction (the true one is never less).
        turned_part: part of the mesh's area that faces against the nearest face of the scan: on parts thinner than the
            distance between mesh and scan the nearest face may be the other side's.
    """

    rms_mm: float
    hausdorff_mm: float
    turned_part: float


class ScanSurface:
    """A scan, ready to be measured against: vertices (n, 3) float64 mm, faces (m, 3) int.

    Sampling: `SAMPLES` points per surface, one at random in each of as many equal parts of its area taken in face
    order (which follows space, so the points spread evenly); their squares give the rms. The Hausdorff distance is the
    greatest of those, of the distances around the `_WORST` of them, of `_SUSPECTS` scan vertices that lie furthest from
    the tangent plane of the vertex they became, and of as many border vertices. Distances themselves are exact.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self._points, self._on = spread_points(vertices, faces, SAMPLES)
        self._border = np.unique(edge_table(faces).boundary)

    @cached_property
    def index(self) -> SurfaceIndex:
        """Closest points on the scan."""
        return SurfaceIndex(self.vertices, self.faces)

    def deviation(
        self, vertices: np.ndarray, faces: np.ndarray, vertex_map: np.ndarray, mesh: SurfaceIndex | None = None
    ) -> Deviation:
        """Measure a mesh against the scan; vertex_map (n,) int gives the mesh's vertex for every scan vertex.

        `mesh`: the index of the mesh, if there is one.
        """
        mesh = mesh or SurfaceIndex(vertices, faces)
        to_mesh = mesh.nearest(self._points).distance_mm
        suspects = np.concatenate(
            (
                self._off_plane(vertices, faces, vertex_map),
                self._around(self.faces, self._on, to_mesh),
                self._furthest_moved(vertices, vertex_map),
            )
        )
        far = mesh.nearest(self.vertices[suspects]).distance_mm

        points, on = spread_points(vertices, faces, SAMPLES)
        to_scan = self.index.nearest(points)
        around = self._around(faces, on, to_scan.distance_mm, corners=False)
        if len(around) > _SUSPECTS // 3:  # faces smaller than the gaps between samples: their corners will do
            back = self.index.nearest(vertices[np.unique(faces[around])]).distance_mm
        else:
            back = self.index.nearest(_on_faces(vertices, faces[around])).distance_mm
        facing = np.einsum("ij,ij->i", _normals(vertices, faces[on]), _normals(self.vertices, self.faces[to_scan.face]))
        return Deviation(
            rms_mm=float(np.sqrt(0.5 * (np.mean(to_mesh**2) + np.mean(to_scan.distance_mm**2)))),
            hausdorff_mm=float(max(part.max(initial=0.0) for part in (to_mesh, far, to_scan.distance_mm, back))),
            turned_part=float(np.mean(facing < 0.0)),
        )

    def _off_plane(self, vertices: np.ndarray, faces: np.ndarray, vertex_map: np.ndarray) -> np.ndarray:
        normal = vertex_normals(vertices, faces)[vertex_map]
        height = np.abs(np.einsum("ij,ij->i", normal, self.vertices - vertices[vertex_map]))
        count = min(_SUSPECTS, len(height))
        return np.argpartition(height, len(height) - count)[len(height) - count :]

    def _furthest_moved(self, vertices: np.ndarray, vertex_map: np.ndarray) -> np.ndarray:
        """Border vertices: a border that recedes leaves the surface sideways, within its tangent plane."""
        way = self.vertices[self._border] - vertices[vertex_map[self._border]]
        return self._border[np.argsort(-np.einsum("ij,ij->i", way, way), kind="stable")[:_SUSPECTS]]

    @staticmethod
    def _around(faces: np.ndarray, on: np.ndarray, distance: np.ndarray, corners: bool = True) -> np.ndarray:
        """Faces next to the worst samples in face order, which is order in space; or their corners."""
        reach = max(1, len(faces) // SAMPLES)
        worst = on[np.argsort(distance)[-_WORST:]]
        window = np.unique(np.clip(worst[:, None] + np.arange(-reach, reach + 1), 0, len(faces) - 1))
        return np.unique(faces[window]) if corners else window


def spread_points(vertices: np.ndarray, faces: np.ndarray, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3) on a mesh, one in each of `count` equal parts of its area, and the face (count,) of each.

    Always the same points for the same mesh.
    """
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    place = (np.arange(count) + rng.random(count)) / count * area[-1]
    face = np.minimum(np.searchsorted(area, place, side="right"), len(faces) - 1)
    root, along = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return (1 - root) * a[face] + root * (1 - along) * b[face] + root * along * c[face], face


def _on_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Ten points per face: corners, middle, and thirds along the edges."""
    steps = [(i, j, 3 - i - j) for i in range(4) for j in range(4 - i)]
    weights = np.array(steps) / 3.0
    return np.einsum("pk,fkx->fpx", weights, vertices[faces]).reshape(-1, 3)


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
