"""The parts of the paper's table 5, which it could not render: a head with its mouth, 5.3 M triangles in seven parts.

Generated, with the table's triangle counts exactly; their shapes are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from hapticlod.dentition import make_dentition

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.integer]]
TABLE_5 = {
    "head": 2_638_217,
    "face": 12_556,
    "upper teeth": 1_270_536,
    "lower teeth": 1_176_883,
    "upper gum": 112_386,
    "lower gum": 65_200,
    "tongue": 656,
}


def sheet(triangles: int, place: Callable[[Array, Array], Array]) -> Mesh:
    """A grid over [0, 1] x [0, 1] with exactly so many triangles: the last ones of its last row are left out."""
    wide = max(2, round(np.sqrt(triangles / 2)))
    high = -(-triangles // (2 * wide))
    v, u = np.meshgrid(np.linspace(0.0, 1.0, high + 1), np.linspace(0.0, 1.0, wide + 1), indexing="ij")
    corner = (np.arange(high)[:, None] * (wide + 1) + np.arange(wide)).ravel()
    a, b, c, d = corner, corner + 1, corner + wide + 1, corner + wide + 2
    faces = np.stack([np.stack([a, b, d], 1), np.stack([a, d, c], 1)], 1).reshape(-1, 3)[:triangles]
    return place(u, v).reshape(-1, 3), faces


def shell(
    half_axes_mm: tuple[float, float, float], bump_mm: float, turns: float = 0.97
) -> Callable[[Array, Array], Array]:
    """An ellipsoid with bumps, open along a slit and at both poles; outward normals."""

    def place(u: Array, v: Array) -> Array:
        around, up = 2.0 * np.pi * turns * u, np.pi * (0.02 + 0.96 * v)
        away = np.stack([np.sin(up) * np.sin(around), np.sin(up) * np.cos(around), np.cos(up)], -1)
        bumps = np.sin(23.0 * away[..., 0]) * np.sin(19.0 * away[..., 1] + 1.0) * np.sin(17.0 * away[..., 2] + 2.0)
        return away * (np.array(half_axes_mm) + bump_mm * bumps[..., None])

    return place


def arch(triangles: int, seed: int, upper: bool, widen: float) -> Mesh:
    """A row of teeth or a gum outside it: a dentition with exactly so many triangles."""
    scan = make_dentition(max(round(1.02 * triangles), 2000), seed)
    vertices = scan.vertices * np.array([widen, widen, 1.0])
    faces = scan.faces[:triangles]
    if upper:  # turned over, above the lower one
        vertices, faces = vertices * np.array([1.0, 1.0, -1.0]) + np.array([0.0, 0.0, 26.0]), faces[:, ::-1]
    return vertices, faces


def make_parts(share: float) -> dict[str, Mesh]:
    """All seven, each with its share of the table's triangles."""
    counts = {name: max(round(share * count), min(count, 656)) for name, count in TABLE_5.items()}
    lower, middle = np.array([0.0, 22.0, 13.0]), np.array([0.0, 20.0, 6.0])
    head, face, tongue = (
        sheet(counts["head"], shell((78.0, 100.0, 115.0), 1.5)),
        sheet(counts["face"], shell((84.0, 106.0, 121.0), 1.0, 0.4)),
        sheet(counts["tongue"], shell((17.0, 20.0, 7.0), 0.3)),
    )
    return {
        "head": (head[0] + lower, head[1]),
        "face": (face[0] + lower, face[1]),
        "upper teeth": arch(counts["upper teeth"], 1, True, 1.0),
        "lower teeth": arch(counts["lower teeth"], 0, False, 1.0),
        "upper gum": arch(counts["upper gum"], 3, True, 1.4),
        "lower gum": arch(counts["lower gum"], 2, False, 1.4),
        "tongue": (tongue[0] + middle, tongue[1]),
    }


def write_parts(folder: Path, share: float) -> Path:
    """PLY files and the scene that names them. The tongue and the gums are softer than what is not said."""
    lines = ['name = "full mouth"\n']
    for name, (vertices, faces) in make_parts(share).items():
        file = folder / f"{name.replace(' ', '_')}.ply"
        trimesh.Trimesh(vertices, faces, process=False).export(file)
        soft = {"tongue": 0.2, "upper gum": 0.4, "lower gum": 0.4}.get(name)
        material = f"material = {{ stiffness_n_mm = {soft} }}\n" if soft else ""
        lines.append(f'[[part]]\nname = "{name}"\nscan = "{file.name}"\nunit = "mm"\n{material}')
    path = folder / "full_mouth.toml"
    path.write_text("\n".join(lines))
    return path
