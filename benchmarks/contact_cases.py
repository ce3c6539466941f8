"""Meshes, motions and tools of the contact benchmark, as files for the program contact_replay."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hapticlod.shipped import shipped_config
from hapticlod.toml import load_toml
from hapticlod.tool_file import ProfileFile, ToolFile

Array = NDArray[np.float64]

SPHERE_RADIUS_MM = 50.0
PERIOD_S = 1e-3


def write_stl(path: Path, vertices: Array, faces: NDArray[np.integer]) -> Path:
    """Binary STL, faces turned outward from the origin as they are given."""
    corners = vertices.astype("<f4")[faces]
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
    rows["corners"] = corners
    unfinished = path.with_suffix(".part")
    with open(unfinished, "wb") as out:
        out.write(b"contact benchmark".ljust(80, b" "))
        out.write(np.uint32(len(faces)).tobytes())
        out.write(rows.tobytes())
    return unfinished.replace(path)


def sphere_file(folder: Path, triangles: int) -> Path:
    """A sphere of 50 mm over a Fibonacci lattice: triangles of one size, in no order. 2.6 M take half a minute."""
    path = folder / f"sphere_{triangles}.stl"
    if path.exists():
        return path
    n = (triangles + 4) // 2
    k = np.arange(n) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * k / n), np.pi * (1.0 + np.sqrt(5.0)) * k
    points = np.column_stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])
    points = (points * SPHERE_RADIUS_MM).astype(np.float32).astype(np.float64)
    faces = ConvexHull(points, qhull_options="Qt").simplices
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, corners.mean(axis=1)) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return write_stl(path, points, faces)


def plane_file(folder: Path, cells: int) -> Path:
    """100 x 100 mm at z = 0, 2 cells^2 triangles."""
    path = folder / f"plane_{2 * cells * cells}.stl"
    if path.exists():
        return path
    axis = np.linspace(-50.0, 50.0, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = (i * (cells + 1) + j).ravel()
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return write_stl(path, np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), faces)


def depth_mm(ticks: int) -> tuple[Array, Array]:
    """Time and depth: free space for 0.1 s, then 0.5 to 1 mm deep, twice a second."""
    time_s = np.arange(ticks, dtype=np.float64) * PERIOD_S
    depth: Array = np.minimum(-2.0 + 20.0 * time_s, 0.75 + 0.25 * np.sin(4.0 * np.pi * time_s))
    return time_s, depth


def write_motion(path: Path, place_mm: Array) -> Path:
    np.savetxt(path, place_mm, fmt="%.6f", delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    return path


def motion_on_sphere(folder: Path, speed_mm_s: float, radius_mm: float, ticks: int) -> Path:
    """Great circles that drift; the ball's centre is lifted by its radius."""
    time_s, depth = depth_mm(ticks)
    angle = speed_mm_s * time_s / SPHERE_RADIUS_MM
    tilt = 0.13 * angle + 0.3
    outward = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    place = outward * (SPHERE_RADIUS_MM + radius_mm - depth)[:, None]
    return write_motion(folder / f"sphere_r{radius_mm:g}_{speed_mm_s:g}_{ticks}.csv", place)


def motion_on_top(folder: Path, speed_mm_s: float, radius_mm: float, ticks: int) -> Path:
    """A circle 20 degrees about the sphere's top, where a tool with a shank along +z meets it with its tip."""
    time_s, depth = depth_mm(ticks)
    polar = np.radians(20.0)
    angle = speed_mm_s * time_s / (SPHERE_RADIUS_MM * np.sin(polar))
    outward = np.column_stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.full(ticks, np.cos(polar))]
    )
    place = outward * (SPHERE_RADIUS_MM + radius_mm - depth)[:, None]
    return write_motion(folder / f"top_r{radius_mm:.3f}_{speed_mm_s:g}_{ticks}.csv", place)


def motion_on_plane(folder: Path, speed_mm_s: float, ticks: int) -> Path:
    """A circle of 40 mm."""
    time_s, depth = depth_mm(ticks)
    way = speed_mm_s * time_s / 40.0
    place = np.column_stack([40.0 * np.cos(way) + 1.7, 40.0 * np.sin(way) - 2.3, -depth])
    return write_motion(folder / f"plane_{speed_mm_s:g}_{ticks}.csv", place)


def burr_file(folder: Path, balls: int) -> tuple[Path, float]:
    """The shipped flame burr, filled with so many balls; and the radius of its tip's ball."""
    shipped = load_toml(shipped_config("tools/burr_flame.toml"), ToolFile).root
    if not isinstance(shipped, ProfileFile):
        raise TypeError("the shipped burr is no profile any more")
    # Filling takes whole rings and may end a few balls short.
    tool = shipped.model_copy(update={"balls": balls + 20}).tool().first(balls)
    path = folder / f"burr_{tool.balls}.csv"
    np.savetxt(path, tool.rows, fmt="%.6f", delimiter=",", header="x_mm,y_mm,z_mm,radius_mm", comments="")
    return path, tool.reference_radius_mm
