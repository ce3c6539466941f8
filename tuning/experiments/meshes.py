"""The paper's plane and spheres, with its numbers of triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from hapticlod import _runtime
from hapticlod.scan import Scan, scan_from_arrays

PLANE_MM, SPHERE_MM = 100.0, 100.0
PLANE_TRIANGLES = (80000, 5000, 800)
SPHERE_VERTICES = (50937, 5016, 511)  # 2 n - 4 triangles: the paper's 101870, 10028 and 1018


def plane(triangles: int) -> Scan:
    """A square of 100 mm in XOY about the origin, facing +z. `triangles`: twice a square number."""
    n = round((triangles / 2) ** 0.5)
    line = np.linspace(-PLANE_MM / 2, PLANE_MM / 2, n + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    corner = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    lower = np.stack([corner, corner + n + 1, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + n + 1, corner + n + 2], axis=1)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return scan_from_arrays(vertices, np.concatenate([lower, upper]), f"plane-{2 * n * n}")


def sphere(vertices: int) -> Scan:
    """A sphere of 100 mm diameter about the origin: points along a Fibonacci spiral and their hull, 2 n - 4 faces."""
    i = np.arange(vertices) + 0.5
    z = 1.0 - 2.0 * i / vertices
    turn = np.pi * (1.0 + 5.0**0.5) * i
    points = np.column_stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z])
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return scan_from_arrays(0.5 * SPHERE_MM * points, faces, f"sphere-{len(faces)}")


def mesh_level(scan: Scan, origin_mm: np.ndarray, cell_mm: float) -> Any:
    """A mesh of its own, not a rung of a ladder, as a level of the runtime."""
    local = np.ascontiguousarray(scan.vertices - origin_mm, dtype=np.float32)
    return _runtime.Level(local, np.ascontiguousarray(scan.faces, dtype=np.uint32), cell_mm)
