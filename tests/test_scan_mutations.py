"""Crops of scans, mutated: refused for a reason that is true, or loaded, simplified and touched as the report says.

HAPTICLOD_MUTATIONS=1000 (`make mutate-scans`) tries more of them than CI does.
"""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scan_mutations import crop, mutated, written

from hapticlod.config import Level, LodConfig
from hapticlod.dentition import make_dentition
from hapticlod.errors import InputError
from hapticlod.ladder import build_ladder
from hapticlod.motion import Motion
from hapticlod.repair import DEGENERATE_HEIGHT_OF_EXTENT, LARGEST_COORDINATE_MM, STRAY_OF_REACH
from hapticlod.replay import replay
from hapticlod.scan import Scan, load_scan
from hapticlod.tool import ball
from hapticlod.topology import edge_table

CASES = int(os.environ.get("HAPTICLOD_MUTATIONS", "6"))
TRIANGLES = 220
RADIUS_MM = 0.2


@pytest.fixture(scope="module")
def whole(data_dir_or_none: Path | None) -> list[tuple[np.ndarray, np.ndarray]]:
    """What crops are taken from: a generated dentition, and a real scan where there is one."""
    made = make_dentition(4000)
    found = [(made.vertices, made.faces)]
    if data_dir_or_none is not None:
        real = load_scan(data_dir_or_none / "dirty" / "00_clean_crop_8k.ply")
        found.append((real.vertices, real.faces))
    return found


@pytest.mark.parametrize("seed", range(CASES))
def test_mutated_crops_are_loaded_truthfully(
    seed: int, whole: list[tuple[np.ndarray, np.ndarray]], tmp_path: Path
) -> None:
    rng = np.random.default_rng([7, seed])
    vertices, faces = whole[seed % len(whole)]
    vertices, faces = crop(rng, vertices, faces, TRIANGLES)
    vertices, faces, faults = mutated(rng, vertices, faces)
    path = tmp_path / f"scan.{'ply' if rng.random() < 0.5 else 'stl'}"
    vertices, faces = written(path, vertices, faces)
    try:
        scan = load_scan(path, "mm")
    except InputError as refused:
        judge_refusal(refused, vertices, faces)
        return
    judge_scan(scan, vertices, faces, rng)
    judge_ladder(scan, rng)
    judge_touch(scan, rng)
    assert faults


def judge_refusal(refused: InputError, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Only what cannot be a scan is refused, and the reason is the true one."""
    usable = usable_faces(vertices, faces, 4.0)  # heaps of dust take some along that are just high enough
    far = np.abs(vertices[faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]]).max(initial=0.0)
    if "from the origin" in str(refused):
        assert far > LARGEST_COORDINATE_MM
    elif "from the middle of the scan" in str(refused):
        corners = vertices[faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]].reshape(-1, 3)
        away = np.sort(np.linalg.norm(corners - np.median(corners, axis=0), axis=1))
        assert away[-1] > 0.5 * STRAY_OF_REACH * away[int(0.9 * len(away))]
    else:
        assert len(usable) == 0, str(refused)


def usable_faces(vertices: np.ndarray, faces: np.ndarray, times: float = 1.0) -> np.ndarray:
    """Faces of the file that are triangles: finite, and so many times higher than float32 resolves of the whole."""
    finite = faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]
    if len(finite) == 0:
        return finite
    corners = vertices[finite]
    extent = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return finite[area > times * DEGENERATE_HEIGHT_OF_EXTENT * extent * longest]


def judge_scan(scan: Scan, vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator) -> None:
    """Nothing was moved, dropped or added but what the report says."""
    report = scan.report
    assert report.triangles_read == len(faces)
    gone = report.triangles_read - report.triangles
    told = report.faces_on_not_finite.found + report.duplicate_faces.found
    assert told <= gone <= told + report.degenerate_faces.found
    known = {tuple(row) for row in (vertices + 0.0).tolist()}
    assert all(tuple(row) in known for row in (scan.vertices + 0.0).tolist())
    edges = edge_table(scan.faces)
    assert (len(edges.boundary), edges.non_manifold) == (
        report.boundary_edges.found,
        report.non_manifold_edges.found,
    )
    clash = report.inconsistent_edges.found - report.inconsistent_edges.fixed
    assert int((~edges.consistent).sum()) == clash
    # Level 0 is where the file's surface is, both ways, up to what was welded and what is too flat to be a face.
    bound = 2.0 * report.weld_tolerance_mm * (report.near_vertices.found > 0)
    bound += 4.0 * DEGENERATE_HEIGHT_OF_EXTENT * scan.extent_mm
    usable = usable_faces(vertices, faces)
    assert distances(inside(rng, vertices, usable), scan.vertices, scan.faces).max() <= bound
    assert distances(inside(rng, scan.vertices, scan.faces), vertices, usable).max() <= bound


def judge_ladder(scan: Scan, rng: np.random.Generator) -> None:
    ladder = build_ladder(scan, rungs=3, coarsest_ratio=15.0)
    for rung in ladder.rungs[1:]:
        assert 1 <= rung.triangles < scan.triangles
        there = distances(inside(rng, scan.vertices, scan.faces), rung.vertices, rung.faces)
        back = distances(inside(rng, rung.vertices, rung.faces), scan.vertices, scan.faces)
        assert max(there.max(), back.max()) <= 1.02 * rung.hausdorff_mm + 1e-6 * scan.extent_mm


def judge_touch(scan: Scan, rng: np.random.Generator) -> None:
    """A ball is pressed against the finest level here and there: it is never nearer than its radius."""
    if scan.extent_mm > 1e4:
        return  # a spike of kilometres: the ball is below what the model resolves
    ladder = build_ladder(scan, rungs=1)
    stops = inside(rng, scan.vertices, scan.faces)[:12] + rng.normal(0.0, 1.0, (12, 3))
    path = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(stops)])
    motion = Motion(np.arange(len(path)) / 1000.0, path, None, 1000.0, "stabs", {})
    cell_mm = 3.0 * ladder.rungs[0].mean_edge_mm
    config = LodConfig(levels=(Level(triangles=scan.triangles, cell_mm=cell_mm, balls=1),))
    record = replay(config, ladder, motion, ball(RADIUS_MM))
    assert np.isfinite(record.force).all()
    free = distances(record.scp[1::9], scan.vertices, scan.faces)
    assert free.min() >= RADIUS_MM - 1e-3 - 1e-5 * scan.extent_mm


def inside(rng: np.random.Generator, vertices: np.ndarray, faces: np.ndarray, count: int = 40) -> np.ndarray:
    """Points within random faces."""
    weights = rng.dirichlet([1.0, 1.0, 1.0], count)
    return np.einsum("ik,ikx->ix", weights, vertices[faces[rng.integers(len(faces), size=count)]])


def distances(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance (k,) of points to a mesh, by asking every face (trimesh's own routine)."""
    corners = vertices[faces]
    found = []
    for point in points:
        near = trimesh.triangles.closest_point(corners, np.broadcast_to(point, (len(corners), 3)))
        found.append(np.linalg.norm(near - point, axis=1).min())
    return np.array(found)
