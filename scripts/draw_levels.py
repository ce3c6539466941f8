"""Draws docs/levels.png: the generated dentition at three levels, flat-shaded, so that facets show.

python scripts/draw_levels.py docs/levels.png [BUNDLE]     (levels of a bundle instead of fixed rungs)
"""

import struct
import sys
import zlib
from pathlib import Path

import numpy as np

WIDTH, HEIGHT = 420, 330
VIEW = np.array([[1.0, 0.0, 0.0], [0.0, 0.82, -0.57], [0.0, 0.57, 0.82]])  # rows: right, up, towards the eye
LIGHT = np.array([-0.45, 0.55, 0.70]) / np.linalg.norm([-0.45, 0.55, 0.70])
IVORY, PAPER = np.array([238.0, 226.0, 205.0]), np.array([255, 255, 255], dtype=np.uint8)


def shaded(vertices: np.ndarray, faces: np.ndarray, window_mm: tuple[float, float, float]) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) uint8 picture of a mesh; window_mm = (left, bottom, width) in the view plane."""
    left, bottom, width = window_mm
    seen = (vertices @ VIEW.T - [left, bottom, 0.0]) * [WIDTH / width, WIDTH / width, 1.0]
    corners = seen[faces]
    edges = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals = normals @ VIEW.T
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    inside = (corners[..., 0].max(1) > 0) & (corners[..., 0].min(1) < WIDTH) & (corners[..., 1].min(1) < HEIGHT)
    corners, normals = corners[inside], normals[inside]
    # Points over every triangle, three per pixel of its longer side, then the nearest point of each pixel.
    size = np.ptp(corners[..., :2], axis=1).max(axis=1)
    steps = np.clip(np.ceil(3.0 * size), 1, 400).astype(int)
    pixels, depths, sources = [], [], []
    for step in np.unique(steps):
        rows = np.flatnonzero(steps == step)
        i, j = np.meshgrid(np.arange(step + 1), np.arange(step + 1))
        keep = i + j <= step
        u, v = i[keep] / step, j[keep] / step
        weights = np.column_stack([1 - u - v, u, v])
        for part in np.array_split(rows, max(1, len(rows) * len(weights) // 4_000_000)):
            points = np.einsum("pk,tkd->tpd", weights, corners[part])
            x, y = points[..., 0].astype(int), points[..., 1].astype(int)
            on = (points[..., 0] >= 0) & (x < WIDTH) & (points[..., 1] >= 0) & (y < HEIGHT)
            pixels.append(((HEIGHT - 1 - y) * WIDTH + x)[on])
            depths.append(points[..., 2][on])
            sources.append(np.broadcast_to(part[:, None], on.shape)[on])
    pixel, depth, source = (np.concatenate(parts) for parts in (pixels, depths, sources))
    order = np.lexsort((depth, pixel))
    last = order[np.append(np.diff(pixel[order]) > 0, True)]
    bright = 0.22 + 0.78 * np.maximum(normals[source[last]] @ LIGHT, 0.0)
    picture = np.tile(PAPER, (HEIGHT * WIDTH, 1))
    picture[pixel[last]] = (bright[:, None] * IVORY).astype(np.uint8)
    return picture.reshape(HEIGHT, WIDTH, 3)


def png(picture: np.ndarray) -> bytes:
    """A picture (h, w, 3) uint8 as PNG."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = picture.shape
    rows = b"".join(b"\0" + row.tobytes() for row in picture)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def main() -> None:
    target = Path(sys.argv[1])
    if len(sys.argv) > 2:
        from hapticlod.bundle import read_bundle

        meshes = [(level.vertices.astype(float), level.faces.astype(int)) for level in read_bundle(sys.argv[2]).levels]
    else:
        from hapticlod.dentition import make_dentition
        from hapticlod.ladder import build_ladder

        ladder = build_ladder(make_dentition(290_000, seed=0))
        rungs = [ladder.at(count) for count in (290_000, 29_000, 4_000)]
        centre = ladder.scan.centre_mm
        meshes = [(rung.vertices - centre, rung.faces) for rung in rungs]
    # A corner of the arch, the same for every level.
    seen = meshes[0][0] @ VIEW.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    span = high - low
    window = (low[0] + 0.02 * span[0], high[1] - 0.62 * span[1], 0.42 * span[0])
    strip = np.concatenate([shaded(*mesh, window) for mesh in meshes], axis=1)
    target.write_bytes(png(strip))
    print(f"{target}: {', '.join(str(len(faces)) for _, faces in meshes)} triangles, {target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
