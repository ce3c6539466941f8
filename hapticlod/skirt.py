"""A strip of faces along every open border, so that simplification keeps the border where it is."""

from __future__ import annotations

import numpy as np

from hapticlod.topology import edge_table

# A skirt face flatter than this part of (edge length x skirt height) has no normal to hold the border with.
_FLAT = 0.05


def add_skirt(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hang two faces on every border edge, along the surface normal.

    Edges that border nothing cost a quadric simplifier nothing to move: a flat patch would shrink from its rim. The
    planes of the skirt hold the rim, like the constraint planes of Garland and Heckbert (1997, section 6); its faces
    are dropped afterwards.

    Args:
        vertices: (n, 3) float64. faces: (m, 3) int.

    Returns:
        Vertices and faces of the mesh with the skirt; the first n and m are those given.
    """
    border = edge_table(faces).boundary
    if len(border) == 0:
        return vertices, faces
    hanging = np.unique(border)
    down = -vertex_normals(vertices, faces)[hanging]
    height = float(np.median(np.linalg.norm(vertices[border[:, 0]] - vertices[border[:, 1]], axis=1)))
    below = np.full(len(vertices), -1)
    below[hanging] = len(vertices) + np.arange(len(hanging))
    points = np.concatenate((vertices, vertices[hanging] + height * down))
    a, b = border[:, 0], border[:, 1]
    # The face runs from a to b, so the skirt runs from b to a.
    upper, lower = np.column_stack((b, a, below[a])), np.column_stack((b, below[a], below[b]))
    least = _FLAT * height * np.linalg.norm(vertices[a] - vertices[b], axis=1)
    firm = (_double_area(points, upper) > least) & (_double_area(points, lower) > least)
    return points, np.concatenate((faces, upper[firm], lower[firm]))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normal (n, 3) of every vertex, faces weighted by area; (0, 0, 0) where they cancel or there are none."""
    corners = [vertices[faces[:, k]] for k in range(3)]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    total = np.column_stack(
        [np.bincount(faces.ravel(), weights=np.repeat(normal[:, k], 3), minlength=len(vertices)) for k in range(3)]
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)


def _double_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)
