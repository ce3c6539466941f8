"""Every rung is looked at before anybody may use it, by other means than those that made and measured it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hapticlod.closest import SurfaceIndex
from hapticlod.deviation import Deviation, ScanSurface, spread_points
from hapticlod.errors import HapticLODError
from hapticlod.orientation import signed_volumes
from hapticlod.topology import edge_table, vertex_components

# A rung's face is what a face of the scan became. More than this part of the area that looks the other way than the
# scan's did is a rung turned inside out somewhere.
MOST_TURNED = 0.01
LEAST_VOLUME = 0.02  # of a part's: a volume nearer to 0 than this has no sign
CHECKED = 1000  # points of the scan, vertices of the scan and points of the rung that are asked for their distance
_SEED = 1  # other points than those of `ScanSurface`


class UnsoundRung(HapticLODError):
    """A rung that must not be touched; its text says why, without a subject."""


class Sides:
    """Which way a scan faces: what its rungs are held against. vertices (n, 3), faces (m, 3)."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._vertices, self._faces = vertices, faces
        self._parts, self._part = vertex_components(faces, len(vertices))
        edges = edge_table(faces)
        is_open = np.zeros(len(vertices), dtype=bool)
        is_open[edges.boundary.ravel()] = True
        is_open[faces[edges.pairs[~edges.consistent]].ravel()] = True
        volume = signed_volumes(vertices, faces, self._part, self._parts)
        volume[self._part[is_open[faces].any(axis=1)]] = 0.0  # an open part has none
        self._volume = volume

    def check(self, vertices: np.ndarray, corners: np.ndarray, alive: np.ndarray) -> None:
        """Raise UnsoundRung unless a rung is finite, in range, and faces as the scan does.

        Args:
            vertices: (v, 3) of the rung. corners: (f, 3), its faces, those without area included.
            alive: (m,) bool, the faces of the scan that these were.
        """
        if len(corners) == 0:
            raise UnsoundRung("has no faces")
        if corners.min() < 0 or corners.max() >= len(vertices):
            raise UnsoundRung("has a face without its vertex")
        if not np.isfinite(vertices).all():
            raise UnsoundRung("has a vertex at infinity")
        now, then = _normals(vertices, corners), _normals(self._vertices, self._faces[alive])
        area = np.linalg.norm(now, axis=1)
        turned = np.einsum("ij,ij->i", now, then) < 0.0
        # A closed part thinner than the rung's error: each face looks its way, but one side lies behind the other.
        part = self._part[alive]
        volume = signed_volumes(vertices, corners, part, self._parts)
        inverted = volume * np.sign(self._volume) < -LEAST_VOLUME * np.abs(self._volume)
        turned |= inverted[part]
        if (share := float(area[turned].sum() / area.sum())) > MOST_TURNED:
            raise UnsoundRung(f"has {100.0 * share:.1f} % of its area turned inside out")


def checked_deviation(
    said: Deviation, scan: ScanSurface, vertices: np.ndarray, faces: np.ndarray, mesh: SurfaceIndex
) -> Deviation:
    """`said`, with the Hausdorff distance raised to what other points show, should they lie further away.

    Args:
        scan: what the rung is held against. vertices, faces: of the rung. mesh: the rung's index.
    """
    rng = np.random.default_rng(_SEED)
    there = np.concatenate(
        (
            scan.vertices[rng.integers(0, len(scan.vertices), CHECKED)],
            spread_points(scan.vertices, scan.faces, CHECKED, _SEED)[0],
        )
    )
    back = spread_points(vertices, faces, CHECKED, _SEED)[0]
    furthest = max(mesh.nearest(there).distance_mm.max(), scan.index.nearest(back).distance_mm.max())
    return replace(said, hausdorff_mm=max(said.hausdorff_mm, float(furthest)))


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
