"""Makes a clean crop of a scan dirty, in the ways that real scans are; each way draws from a seeded generator."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]
Fault = Callable[[np.random.Generator, np.ndarray, np.ndarray], Mesh]


def crop(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray, triangles: int) -> Mesh:
    """The faces nearest to a random one."""
    middle = vertices[faces].mean(axis=1)
    away = np.linalg.norm(middle - middle[rng.integers(len(middle))], axis=1)
    chosen = faces[np.argsort(away, kind="stable")[:triangles]]
    used = np.unique(chosen)
    return vertices[used].copy(), np.searchsorted(used, chosen)


def _some(rng: np.random.Generator, count: int, most: float = 0.1) -> np.ndarray:
    return rng.choice(count, size=max(1, int(rng.uniform(0.0, most) * count)), replace=False)


def _joined(vertices: np.ndarray, faces: np.ndarray, more: np.ndarray, corners: np.ndarray) -> Mesh:
    return np.concatenate((vertices, more)), np.concatenate((faces, corners + len(vertices)))


def nan_vertices(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    vertices = vertices.copy()
    vertices[_some(rng, len(vertices), 0.03), rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    return vertices, faces


def duplicates(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    again = np.roll(faces[_some(rng, len(faces))], rng.integers(3), axis=1)
    return vertices, np.concatenate((faces, again if rng.random() < 0.5 else again[:, ::-1]))


def without_area(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Points, segments, and vertices in the middle of an edge on one side only."""
    pick = faces[_some(rng, len(faces))]
    a, b = pick[:, 0], pick[:, 1]
    kind = rng.integers(3)
    if kind < 2:
        return vertices, np.concatenate((faces, np.column_stack((a, a, a if kind else b))))
    middle = 0.5 * (vertices[a] + vertices[b])
    new = len(vertices) + np.arange(len(a))
    return np.concatenate((vertices, middle)), np.concatenate((faces, np.column_stack((b, a, new))))


def flipped(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    faces = faces.copy()
    pick = _some(rng, len(faces), 0.4)
    faces[pick] = faces[pick][:, ::-1]
    return vertices, faces


def inverted(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return vertices, faces[:, ::-1].copy()


def fins(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """More than two faces at an edge."""
    pick = faces[_some(rng, len(faces), 0.03)]
    tips = vertices[pick].mean(axis=1) + rng.normal(0.0, 0.3, (len(pick), 3))
    new = len(vertices) + np.arange(len(pick))
    return np.concatenate((vertices, tips)), np.concatenate((faces, np.column_stack((pick[:, :2], new))))


def holes(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return vertices, np.delete(faces, _some(rng, len(faces)), axis=0)


def cracked(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Every face for itself, its corners moved by up to some micrometres."""
    gap = 10.0 ** rng.uniform(-6, -2)
    soup = vertices[faces].reshape(-1, 3)
    return soup + rng.uniform(-gap, gap, soup.shape), np.arange(len(soup)).reshape(-1, 3)


def specks(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Loose triangles and tetrahedra round about."""
    count = int(rng.integers(1, 8))
    span = np.nanmax(np.where(np.isfinite(vertices), vertices, np.nan), axis=0)
    tips = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) * rng.uniform(0.01, 0.5, (count, 1, 1))
    places = span + rng.normal(0.0, 3.0, (count, 1, 3))
    shape = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])[: 1 if rng.random() < 0.5 else 4]
    corners = np.concatenate([shape + 4 * i for i in range(count)])
    return _joined(vertices, faces, (places + tips).reshape(-1, 3), corners)


def double_layer(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """The same surface again, a little off, its faces either way."""
    turned = faces if rng.random() < 0.5 else faces[:, ::-1]
    return _joined(vertices, faces, vertices + [0.0, 0.0, 10.0 ** rng.uniform(-3, -0.5)], turned)


def noise(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return vertices + rng.normal(0.0, 10.0 ** rng.uniform(-3, -1), vertices.shape), faces


def far_away(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return vertices + rng.uniform(-1e5, 1e5, 3), faces


def unused(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return np.concatenate((vertices, rng.normal(0.0, 50.0, (5, 3)))), faces


def stray(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """One vertex far off: a spike, or beyond all scans."""
    vertices = vertices.copy()
    vertices[rng.integers(len(vertices))] *= 10.0 ** rng.uniform(1, 12)
    return vertices, faces


FAULTS: dict[str, Fault] = {
    fault.__name__: fault
    for fault in (
        nan_vertices, duplicates, without_area, flipped, inverted, fins, holes, cracked, specks, double_layer, noise,
        far_away, unused, stray,
    )
}  # fmt: skip


def mutated(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, str]:
    """One to four faults, one upon the other; and their names."""
    names = rng.choice(sorted(FAULTS), size=int(rng.integers(1, 5)), replace=False)
    for name in names:
        vertices, faces = FAULTS[name](rng, vertices, faces)
    return vertices, faces, " ".join(names)


def written(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Write a PLY (float64, shared vertices) or binary STL (float32 soup), by its ending; what it then holds."""
    if path.suffix == ".ply":
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        head += "".join(f"property double {axis}\n" for axis in "xyz")
        head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, faces
        path.write_bytes(head.encode() + vertices.astype("<f8").tobytes() + rows.tobytes())
        return vertices, faces
    with np.errstate(over="ignore"):
        corners = vertices[faces].astype("<f4")
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows["corners"] = corners
    path.write_bytes(b"solid".ljust(80) + struct.pack("<I", len(faces)) + rows.tobytes())
    return corners.astype(np.float64).reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
