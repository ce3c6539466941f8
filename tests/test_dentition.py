"""The generated jaw: its size, its soundness, its pits and its noise, measured on the mesh itself."""

from __future__ import annotations

import numpy as np
import pytest

from hapticlod.closest import SurfaceIndex
from hapticlod.dentition import PIT_DEPTH_MM, PITS_PER_TOOTH, dentition_pits, make_dentition
from hapticlod.errors import InputError
from hapticlod.scan import Scan
from hapticlod.topology import edge_table


@pytest.mark.parametrize("triangles", [10_000, 33_333, 123_456])
def test_count_size_and_soundness(triangles: int) -> None:
    scan = make_dentition(triangles, seed=3)
    assert scan.triangles == pytest.approx(triangles, rel=0.01)
    width, depth, height = scan.vertices.max(axis=0) - scan.vertices.min(axis=0)
    assert 60 < width < 72 and 40 < depth < 65 and 10 < height < 20
    assert scan.report.repaired() == {} and scan.report.components == 1
    assert scan.report.non_manifold_edges.found == 0 and scan.report.inconsistent_edges.found == 0
    border = edge_table(scan.faces).boundary
    step = dict(border.tolist())
    at, length = int(border[0, 0]), 0
    while True:  # one loop around the whole sheet
        at, length = step[at], length + 1
        if at == border[0, 0]:
            break
    assert length == len(border)


def test_triangles_are_well_shaped_and_face_outward(small_dentition: Scan) -> None:
    corners = small_dentition.vertices[small_dentition.faces]
    sides = corners - np.roll(corners, -1, axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    quality = 2.0 * np.sqrt(3.0) * np.linalg.norm(normal, axis=1) / (sides**2).sum(axis=(1, 2))  # 1: equilateral
    assert np.median(quality) > 0.8 and np.percentile(quality, 1) > 0.4
    assert quality.min() > 0.15  # a sheet that folds over itself has slivers at the fold
    edges = np.linalg.norm(sides, axis=2)
    assert np.percentile(edges, 99) < 2.0 * np.median(edges) and edges.min() > 0.1 * np.median(edges)
    crest = corners[:, :, 2].mean(axis=1) > np.percentile(small_dentition.vertices[:, 2], 95)
    assert (normal[crest, 2] > 0).mean() > 0.95


def test_seeds_and_sizes() -> None:
    one, two, other = make_dentition(12_000), make_dentition(12_000), make_dentition(12_000, seed=1)
    assert one.digest == two.digest != other.digest
    finer = SurfaceIndex(*(lambda s: (s.vertices, s.faces))(make_dentition(60_000)))
    same = finer.nearest(one.vertices).distance_mm
    assert np.median(same) < 0.03  # the same jaw at another size, up to noise and sagitta
    assert np.median(finer.nearest(other.vertices).distance_mm) > 3 * np.median(same)


def test_noise_is_as_strong_as_asked() -> None:
    smooth = make_dentition(60_000, noise_um=0.0)
    noisy = make_dentition(60_000, noise_um=8.0)
    away = SurfaceIndex(smooth.vertices, smooth.faces).nearest(noisy.vertices).distance_mm
    # Along the normal of a nearly flat neighbourhood the distance is the size of the displacement.
    assert np.sqrt(np.mean(away**2)) == pytest.approx(0.008, rel=0.05)


def test_pits_are_a_tenth_of_a_mm_deep_on_fourteen_teeth() -> None:
    pits = dentition_pits(seed=2)
    assert len(pits.centre_mm) == 14 * PITS_PER_TOOTH and PIT_DEPTH_MM == 0.1
    scan = make_dentition(600_000, seed=2, noise_um=0.0)
    below = pits.centre_mm - SurfaceIndex(scan.vertices, scan.faces).nearest(pits.centre_mm).point_mm
    depth = np.einsum("ij,ij->i", below, pits.outward)
    # In a fissure or on a neighbour's slope the nearest point is no longer the floor of the pit.
    assert np.median(depth) == pytest.approx(PIT_DEPTH_MM, rel=0.1) and (depth > 0.05).mean() > 0.95


@pytest.mark.parametrize(
    "wrong", [{"triangles": 100}, {"triangles": 10**8}, {"noise_um": -1.0}, {"noise_um": float("nan")}]
)
def test_bad_arguments(wrong: dict) -> None:
    with pytest.raises(InputError, match="dentition"):
        make_dentition(**wrong)
