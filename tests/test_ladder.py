"""The ladder against independent truths: closed forms, brute-force distances, the library's own results."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from hapticlod.closest import SurfaceIndex
from hapticlod.collapse import _SWEEPS, SIMPLIFIED_EXTENT, collapse
from hapticlod.deviation import ScanSurface, spread_points
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder, build_ladder
from hapticlod.scan import Scan, load_scan, scan_from_arrays
from hapticlod.skirt import add_skirt
from hapticlod.topology import edge_table


def sphere_scan(subdivisions: int = 5, radius_mm: float = 20.0) -> Scan:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return scan_from_arrays(np.array(mesh.vertices), np.array(mesh.faces), "sphere")


def flat_scan(cells: int = 60, hole: bool = True) -> Scan:
    """A square of 30 mm with a square hole, shaken in its plane, so that no collapse is a tie."""
    x, y = np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0), indexing="ij")
    inner = (x > 0) & (x < cells) & (y > 0) & (y < cells)
    rng = np.random.default_rng(0)
    shake = 0.2 * rng.uniform(-1, 1, (2, *x.shape)) * inner
    if hole:
        rim = (np.abs(x - cells / 2) <= 10) & (np.abs(y - cells / 2) <= 10)
        shake *= ~rim
    vertices = np.column_stack(((x + shake[0]).ravel(), (y + shake[1]).ravel(), np.zeros(x.size))) * 30.0 / cells
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    faces = np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    if hole:
        middle = vertices[faces].mean(axis=1)[:, :2] - 15.0
        faces = faces[np.abs(middle).max(axis=1) > 5.0]
    return scan_from_arrays(vertices, faces, "flat")


def brute_distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance (k,) from points to a mesh by asking every face (trimesh's own routine)."""
    corners = vertices[faces]
    return np.array(
        [
            np.linalg.norm(trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p, axis=1).min()
            for p in points
        ]
    )


def area_mm2(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


@pytest.fixture(scope="module")
def sphere() -> Ladder:
    return build_ladder(sphere_scan())


@pytest.fixture(scope="module")
def crop(data_dir: Path) -> Ladder:
    return build_ladder(load_scan(data_dir / "dirty" / "00_clean_crop_8k.ply"), rungs=8, coarsest_ratio=80)


# --- distances --------------------------------------------------------------------------------------------------------


def test_closest_points_equal_brute_force_on_an_ugly_mesh() -> None:
    rng = np.random.default_rng(4)
    small = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    needle = np.array([[-40.0, 0, 0], [40, 0.01, 0], [40, -0.01, 0.02], [0, 30, 5], [0, -30, 5]])
    vertices = np.concatenate((small.vertices + [1, 2, 0], needle))
    faces = np.concatenate((small.faces, np.array([[0, 1, 2], [0, 3, 1], [0, 1, 4]]) + len(small.vertices)))
    points = np.concatenate((rng.uniform(-45, 45, (150, 3)), rng.normal(0, 0.5, (100, 3)) + [1, 2, 0]))
    near = SurfaceIndex(vertices, faces).nearest(points)
    assert near.distance_mm == pytest.approx(brute_distance(points, vertices, faces), rel=1e-9, abs=1e-12)
    assert np.linalg.norm(near.point_mm - points, axis=1) == pytest.approx(near.distance_mm, abs=1e-12)
    own = [brute_distance(p[None], vertices, faces[f][None])[0] for p, f in zip(points, near.face, strict=True)]
    assert own == pytest.approx(near.distance_mm, abs=1e-12)


def test_spread_points_cover_the_area_evenly() -> None:
    scan = flat_scan(20, hole=False)
    points, face = spread_points(scan.vertices, scan.faces, 6400)
    assert brute_distance(points[:40], scan.vertices, scan.faces[face[:40]]).max() < 1e-12
    cells = np.histogram2d(points[:, 0], points[:, 1], bins=8, range=[[0, 30], [0, 30]])[0]
    assert cells.min() > 80 and cells.max() < 120  # 100 each, far more even than independent points (+- 30)


def test_offset_sphere_has_its_closed_form_distances() -> None:
    scan = sphere_scan(5, 20.0)
    larger = scan.vertices * 1.01
    found = ScanSurface(scan.vertices, scan.faces).deviation(larger, scan.faces, np.arange(len(larger)))
    assert found.rms_mm == pytest.approx(0.2, rel=0.01) and found.hausdorff_mm == pytest.approx(0.2, rel=0.01)
    assert found.turned_part == 0.0


def test_sphere_rungs_have_the_error_of_a_polyhedron(sphere: Ladder) -> None:
    # A sphere of area A in f nearly equilateral faces of circumradius rho^2 = 4 A / (3 sqrt(3) f). Quadrics put the
    # vertices outside so that the error is about equioscillating: Hausdorff between half and all of rho^2 / (2 r).
    for rung in sphere.rungs[3:]:
        rho_squared = 4.0 * 4.0 * np.pi * 20.0**2 / (3.0 * np.sqrt(3.0) * rung.triangles)
        sagitta = rho_squared / (2.0 * 20.0)
        assert 0.2 * sagitta < rung.rms_mm < 0.7 * sagitta
        assert 0.5 * sagitta < rung.hausdorff_mm < 3.0 * sagitta


def test_rms_and_hausdorff_agree_with_brute_force(crop: Ladder) -> None:
    scan, rung = crop.scan, crop.rungs[-2]
    from_scan, _ = spread_points(scan.vertices, scan.faces, 1501)
    from_rung, _ = spread_points(rung.vertices, rung.faces, 400)
    to_rung = brute_distance(from_scan, rung.vertices, rung.faces)
    to_scan = brute_distance(from_rung, scan.vertices, scan.faces)
    rms = np.sqrt(0.5 * (np.mean(to_rung**2) + np.mean(to_scan**2)))
    assert rung.rms_mm == pytest.approx(rms, rel=0.05)
    assert rung.hausdorff_mm >= max(to_rung.max(), to_scan.max())


@pytest.mark.parametrize("ratio", [2, 12, 60])
def test_hausdorff_is_found_on_a_ragged_scan(ratio: int, crop: Ladder) -> None:
    """Against every vertex and very many points, with the exact search that the test above holds to brute force."""
    rung = crop.at(crop.scan.triangles // ratio)
    there = SurfaceIndex(rung.vertices, rung.faces)
    back = SurfaceIndex(crop.scan.vertices, crop.scan.faces)
    points = np.concatenate((crop.scan.vertices, spread_points(crop.scan.vertices, crop.scan.faces, 30_000)[0]))
    truth = there.nearest(points).distance_mm.max()
    truth = max(truth, back.nearest(spread_points(rung.vertices, rung.faces, 30_000)[0]).distance_mm.max())
    assert rung.hausdorff_mm == pytest.approx(truth, rel=0.05)


# --- the list of collapses --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sphere", "crop", "flat"])
def test_replayed_prefix_equals_the_library_asked_for_fewer(name: str, request: pytest.FixtureRequest) -> None:
    scan = flat_scan(40) if name == "flat" else request.getfixturevalue(name).scan
    full = collapse(scan.vertices, scan.faces, scan.triangles // 40)
    # The same input the list was made from: with the skirt, in interleaved order.
    centre, scale = scan.centre_mm, SIMPLIFIED_EXTENT / scan.extent_mm
    points, faces = add_skirt((scan.vertices - centre) * scale, scan.faces.astype(np.int64))
    order = np.argsort(np.arange(len(faces)) % _SWEEPS, kind="stable")
    for part in (0.8, 0.3, 0.1):
        shorter: Any = fast_simplification.simplify(
            points, faces[order].astype(np.int32), target_count=int(part * len(faces)), return_collapses=True
        )
        theirs, steps = shorter[0] / scale + centre, len(shorter[2])
        assert np.array_equal(shorter[2][:, 0], full.kept[:steps])
        vertices, mesh, _ = full.mesh(steps)
        used = vertices[np.unique(mesh)]
        if len(faces) == scan.triangles:  # closed: no skirt vertices among theirs
            assert len(used) == len(theirs)
        assert KDTree(theirs).query(used)[0].max() < 1e-6 * scan.extent_mm


def test_rungs_are_nested_prefixes(sphere: Ladder, crop: Ladder) -> None:
    for ladder in (sphere, crop):
        counts = [rung.triangles for rung in ladder.rungs]
        assert counts == sorted(counts, reverse=True) and len(set(counts)) == len(counts)
        for fine, coarse in zip(ladder.rungs, ladder.rungs[1:], strict=False):
            # Each vertex of the finer rung has one image: the map to the coarser rung factors through the finer.
            image = np.full(len(fine.vertices), -1)
            image[fine.vertex_map] = coarse.vertex_map
            assert np.array_equal(image[fine.vertex_map], coarse.vertex_map)
            assert set(np.unique(image)) == set(range(len(coarse.vertices)))


def test_faces_of_a_rung_are_the_scan_faces_seen_through_the_map(sphere: Ladder) -> None:
    for rung in sphere.rungs[1:]:
        seen = rung.vertex_map[sphere.scan.faces]
        whole = seen[(seen[:, 0] != seen[:, 1]) & (seen[:, 1] != seen[:, 2]) & (seen[:, 2] != seen[:, 0])]
        assert np.array_equal(whole, rung.faces)


def test_map_leads_to_a_vertex_near_by(crop: Ladder) -> None:
    for rung in crop.rungs[1:]:
        way = np.linalg.norm(rung.vertices[rung.vertex_map] - crop.scan.vertices, axis=1)
        assert np.median(way) < 2.0 * rung.mean_edge_mm and way.max() < 10.0 * rung.mean_edge_mm


def test_any_count_can_be_asked_for(crop: Ladder) -> None:
    assert crop.at(10**9) is crop.rungs[0] and crop.at(crop.rungs[3].triangles) is crop.rungs[3]
    coarsest = crop.at(1)
    assert coarsest.triangles <= crop.rungs[-1].triangles and coarsest.is_larger_than_asked
    for asked in (5000, 4999, 1234, 300):
        rung = crop.at(asked)
        assert asked - 2 <= rung.triangles <= asked and not rung.is_larger_than_asked
        assert crop.at(asked) is rung and crop.at(rung.triangles) is rung
        assert rung.vertex_map.shape == (len(crop.scan.vertices),)
        assert 0.0 < rung.rms_mm < rung.hausdorff_mm
    with pytest.raises(InputError, match="less than 1"):
        crop.at(0)


# --- soundness --------------------------------------------------------------------------------------------------------


def test_rung_zero_is_the_scan_and_sizes_are_log_spaced(sphere: Ladder) -> None:
    first = sphere.rungs[0]
    assert first.vertices is sphere.scan.vertices and first.faces is sphere.scan.faces
    assert (first.rms_mm, first.hausdorff_mm) == (0.0, 0.0) and len(sphere.rungs) == 12
    steps = np.diff(np.log([rung.triangles for rung in sphere.rungs[:-1]]))
    assert steps == pytest.approx(-np.log(300) / 11, rel=0.01)
    assert all(np.diff([rung.rms_mm for rung in sphere.rungs]) > 0)
    edge = np.sqrt(4 / np.sqrt(3) * 4 * np.pi * 400 / first.triangles)  # of equilateral faces of that area
    assert first.mean_edge_mm == pytest.approx(edge, rel=0.02)


def test_closed_rungs_stay_closed_and_face_outward(sphere: Ladder) -> None:
    for rung in sphere.rungs:
        edges = edge_table(rung.faces)
        assert len(edges.boundary) == 0 and edges.non_manifold == 0 and edges.consistent.all()
        a, b, c = (rung.vertices[rung.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        assert (np.einsum("ij,ij->i", normal, a + b + c) > 0).all()
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
        assert volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=12.0 / rung.triangles)
        assert rung.deviation.turned_part == 0.0


def test_open_borders_stay_where_they_are() -> None:
    """Without its skirt a flat sheet loses its rim at no cost to a quadric; with it the shape is exact to the end."""
    scan = flat_scan()
    ladder = build_ladder(scan, rungs=6, coarsest_ratio=50)
    for rung in ladder.rungs:
        assert area_mm2(rung.vertices, rung.faces) == pytest.approx(30**2 - 10**2, rel=1e-3)
        assert rung.hausdorff_mm < 0.1
        assert rung.vertices.max(axis=0) == pytest.approx([30, 30, 0], abs=0.1)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_ladder_does_not_know_the_unit(scale: float, crop: Ladder) -> None:
    scan = scan_from_arrays(crop.scan.vertices * scale + 1e4 * scale, crop.scan.faces)
    rung = build_ladder(scan, rungs=3, coarsest_ratio=30).rungs[-1]
    plain = crop.at(scan.triangles // 30)
    assert rung.triangles == pytest.approx(plain.triangles, rel=0.01)
    assert rung.rms_mm == pytest.approx(plain.rms_mm * scale, rel=0.1)


@pytest.mark.parametrize(
    "name", ["06_nonmanifold_fins.ply", "09_noise_50um.ply", "10_cracked_soup.ply", "11_holes_5pct.ply"]
)
def test_dirty_scans_give_sound_rungs(name: str, data_dir: Path) -> None:
    scan = load_scan(data_dir / "dirty" / name)
    ladder = build_ladder(scan, rungs=6)
    for rung in ladder.rungs:
        assert np.isfinite(rung.vertices).all()
        assert rung.faces.min() >= 0 and rung.faces.max() < len(rung.vertices)
        assert rung.vertex_map.min() >= 0 and rung.vertex_map.max() < len(rung.vertices)
        sides = rung.faces
        assert ((sides[:, 0] != sides[:, 1]) & (sides[:, 1] != sides[:, 2]) & (sides[:, 2] != sides[:, 0])).all()
        assert rung.deviation.turned_part < 0.05 and rung.hausdorff_mm < 0.25 * scan.extent_mm


def test_a_rung_larger_than_asked_is_kept_and_reported(data_dir: Path) -> None:
    ladder = build_ladder(load_scan(data_dir / "dirty" / "11_holes_5pct.ply"))
    assert ladder.rungs[-1].is_larger_than_asked
    assert any("were asked for" in note for note in ladder.notes)


def test_islands_that_vanish_leave_no_dangling_map() -> None:
    big = sphere_scan(4)
    rng = np.random.default_rng(6)
    place = rng.normal(size=(40, 3))
    place *= 30.0 / np.linalg.norm(place, axis=1, keepdims=True)
    corners = (place[:, None] + rng.uniform(-0.2, 0.2, (40, 3, 3))).reshape(-1, 3)
    scan = scan_from_arrays(
        np.concatenate((big.vertices, corners)),
        np.concatenate((big.faces, np.arange(120).reshape(-1, 3) + len(big.vertices))),
    )
    ladder = build_ladder(scan)
    for rung in ladder.rungs:
        assert rung.vertex_map.min() >= 0 and rung.vertex_map.max() < len(rung.vertices)
    coarsest = ladder.rungs[-1]
    assert set(coarsest.vertex_map.tolist()) == set(range(len(coarsest.vertices)))


@pytest.mark.parametrize("triangles", [1, 2, 4])
def test_the_smallest_scans_have_a_ladder(triangles: int) -> None:
    vertices = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])[:triangles]
    ladder = build_ladder(scan_from_arrays(vertices, faces))
    assert ladder.rungs[0].triangles == triangles and all(rung.triangles >= 1 for rung in ladder.rungs)


def test_progress_and_bad_arguments() -> None:
    seen: list[float] = []
    build_ladder(sphere_scan(2), rungs=3, progress=lambda stage, part: seen.append(part))
    assert seen[0] == 0.0 and seen[-1] == 1.0 and seen == sorted(seen)
    for count, ratio in ((0, 300.0), (3, 0.5), (3, float("nan"))):
        with pytest.raises(InputError, match=r"rungs = 0|coarsest_ratio"):
            build_ladder(sphere_scan(1), count, ratio)


def test_threads_do_not_disturb_each_other(sphere: Ladder) -> None:
    from concurrent.futures import ThreadPoolExecutor

    scan = sphere.scan
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda _: collapse(scan.vertices, scan.faces, 200), range(3)))
    for result in results[1:]:
        assert np.array_equal(result.kept, results[0].kept) and np.array_equal(result.position, results[0].position)


def test_ladder_travels_to_other_processes(crop: Ladder) -> None:
    twin = pickle.loads(pickle.dumps(copy.copy(crop)))
    assert twin.at(700).triangles == crop.at(700).triangles and twin.rungs[2].rms_mm == crop.rungs[2].rms_mm
