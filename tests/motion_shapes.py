"""Meshes whose geometry is known in closed form, to move on."""

from dataclasses import dataclass

import numpy as np


@dataclass(eq=False)
class Mesh:
    """Vertices (n, 3) mm and faces (m, 3), and nothing else of a scan."""

    vertices: np.ndarray
    faces: np.ndarray


def sphere(radius_mm: float = 50.0, subdivisions: int = 5) -> Mesh:
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return Mesh(vertices=np.array(made.vertices), faces=np.array(made.faces))


def cube(side_mm: float, edge_mm: float) -> Mesh:
    import trimesh

    made = trimesh.creation.box((side_mm, side_mm, side_mm)).subdivide_to_size(edge_mm)
    return Mesh(vertices=np.array(made.vertices), faces=np.array(made.faces))


def plate(side_mm: float = 100.0, cells: int = 50) -> Mesh:
    """A flat open square in z = 0 that faces +z."""
    along = np.linspace(-side_mm / 2, side_mm / 2, cells + 1)
    x, y = np.meshgrid(along, along, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.column_stack([first, first + cells + 1, first + cells + 2])
    upper = np.column_stack([first, first + cells + 2, first + 1])
    return Mesh(vertices=vertices, faces=np.concatenate([lower, upper]))
