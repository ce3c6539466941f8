"""Loading and cleaning scans: the repairs restore the very mesh, and bad files get one clear message."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hapticlod.errors import InputError
from hapticlod.scan import Scan, load_scan, scan_from_arrays
from hapticlod.topology import edge_table, vertex_components


def sphere(subdivisions: int = 2, radius_mm: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return np.array(mesh.vertices), np.array(mesh.faces)


def grid(cells: int = 6, pitch_mm: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0), indexing="ij")
    vertices = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size))) * pitch_mm
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    return vertices, np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))


def volume_mm3(scan: Scan) -> float:
    a, b, c = (scan.vertices[scan.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def same_mesh(scan: Scan, other: Scan) -> bool:
    return np.array_equal(scan.vertices, other.vertices) and _rotated(scan) == _rotated(other)


def _rotated(scan: Scan) -> set[tuple[int, ...]]:
    """Faces as a set, each started at its lowest corner, so that only the direction counts."""
    start = scan.faces.argmin(axis=1)
    return {tuple(np.roll(face, -first)) for face, first in zip(scan.faces.tolist(), start.tolist(), strict=True)}


# --- what each repair must do, on meshes whose truth is known ---------------------------------------------------------


def test_soup_becomes_the_mesh_it_came_from() -> None:
    vertices, faces = sphere()
    whole = scan_from_arrays(vertices, faces)
    soup = scan_from_arrays(vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    assert same_mesh(soup, whole)
    assert soup.report.equal_vertices.found == faces.size - len(vertices)
    assert soup.report.closed_components == 1 and soup.report.boundary_edges.found == 0


@pytest.mark.parametrize("gap_mm", [1e-5, 5e-4])
def test_cracked_soup_is_welded_and_says_so(gap_mm: float) -> None:
    vertices, faces = sphere(3)
    soup = vertices[faces].reshape(-1, 3)
    soup = soup + np.random.default_rng(1).uniform(-gap_mm, gap_mm, soup.shape)
    scan = scan_from_arrays(soup, np.arange(faces.size).reshape(-1, 3))
    assert scan.report.near_vertices.found == faces.size - len(vertices)
    assert scan.report.closed_components == 1 and scan.triangles == len(faces)
    assert 2 * gap_mm < scan.report.weld_tolerance_mm < 0.02


def test_a_wide_crack_and_a_fine_closed_mesh_are_left_alone() -> None:
    vertices, faces = grid()
    gap = scan_from_arrays(
        np.concatenate((vertices, vertices + np.array([6.05, 0, 0]))), np.concatenate((faces, faces + len(vertices)))
    )
    assert gap.report.components == 2 and gap.report.near_vertices.found == 0
    tiny, corners = sphere(2, radius_mm=1e-4)  # a closed mesh, finer than the tolerance of the body beside it
    big, more = sphere(3)
    scan = scan_from_arrays(np.concatenate((big, tiny + 30)), np.concatenate((more, corners + len(big))))
    assert scan.report.vertices == len(big) + len(tiny)


def test_degenerate_and_duplicate_faces_are_dropped_and_counted() -> None:
    vertices, faces = grid()
    point = vertices[[0, 0, 0]]
    extra = np.concatenate((faces[:3][:, [1, 2, 0]], faces[3:5][:, ::-1], [[0, 0, 8], [len(vertices)] * 3, [0, 7, 14]]))
    scan = scan_from_arrays(np.concatenate((vertices, point)), np.concatenate((faces, extra)))
    assert scan.report.duplicate_faces.found == 5
    assert scan.report.degenerate_faces.found == 3
    assert same_mesh(scan, scan_from_arrays(vertices, faces))


def test_a_cap_is_flipped_so_that_no_crack_opens() -> None:
    vertices, faces = sphere(1)
    # Put a vertex into the middle of an edge, but split only one of its two faces and fill with a flat face.
    face, other = (int(i) for i in edge_table(faces).pairs[0])
    a, b = (int(i) for i in set(faces[face]) & set(faces[other]))
    turn = faces[face].tolist()
    if turn[(turn.index(a) + 1) % 3] != b:
        a, b = b, a
    (c,) = set(turn) - {a, b}
    middle = len(vertices)
    points = np.concatenate((vertices, [(vertices[a] + vertices[b]) / 2]))
    corners = np.concatenate((np.delete(faces, face, axis=0), [[a, middle, c], [middle, b, c], [a, b, middle]]))
    scan = scan_from_arrays(points, corners)
    assert scan.report.degenerate_faces.found == 1
    assert scan.report.closed_components == 1 and scan.report.boundary_edges.found == 0
    assert volume_mm3(scan) == pytest.approx(volume_mm3(scan_from_arrays(vertices, faces)), rel=1e-12)


def test_vertices_that_are_no_numbers_take_their_faces_with_them() -> None:
    vertices, faces = grid()
    inner = 3 * 7 + 3  # used by six faces
    vertices[inner, 1] = np.nan
    scan = scan_from_arrays(np.concatenate((vertices, [[np.inf, 0, 0]])), faces)
    assert scan.report.not_finite_vertices.found == 2 and scan.report.faces_on_not_finite.found == 6
    assert scan.triangles == len(faces) - 6 and np.isfinite(scan.vertices).all()
    assert scan.report.boundary_edges.found == 4 * 6 + 6


def test_flipped_faces_are_turned_back_and_closed_bodies_face_outward() -> None:
    vertices, faces = sphere(3)
    truth = scan_from_arrays(vertices, faces)
    some = np.random.default_rng(2).random(len(faces)) < 0.3
    mixed = faces.copy()
    mixed[some] = mixed[some][:, ::-1]
    clash = int((~edge_table(mixed).consistent).sum())
    scan = scan_from_arrays(vertices, mixed)
    assert same_mesh(scan, truth) and scan.report.turned_faces == int(some.sum())
    assert scan.report.inconsistent_edges.found == scan.report.inconsistent_edges.fixed == clash
    inverted = scan_from_arrays(vertices, faces[:, ::-1])
    assert same_mesh(inverted, truth) and volume_mm3(inverted) > 0.0
    assert inverted.report.inside_out_components.fixed == 1 and inverted.report.turned_faces == len(faces)


def test_a_cavity_keeps_its_side_and_follows_an_inverted_body() -> None:
    vertices, faces = sphere(2)
    hollow = np.concatenate((vertices, vertices * 0.5))
    corners = np.concatenate((faces, faces[:, ::-1] + len(vertices)))
    scan = scan_from_arrays(hollow, corners)
    assert scan.report.inside_out_components.found == 1 and scan.report.inside_out_components.fixed == 0
    solid, core = volume_mm3(scan_from_arrays(vertices, faces)), volume_mm3(scan_from_arrays(vertices * 0.5, faces))
    assert volume_mm3(scan) == pytest.approx(solid - core, rel=1e-12)


def test_a_moebius_strip_is_reported_as_not_orientable() -> None:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.stack([(10 + side * np.cos(turn / 2)) for side in (-1, 1)], axis=1)
    height = np.stack([side * np.sin(turn / 2) for side in (-1, 1)], axis=1)
    vertices = np.stack((rim * np.cos(turn)[:, None], rim * np.sin(turn)[:, None], height), axis=2).reshape(-1, 3)
    faces = []
    for i in range(24):
        a, b = 2 * i, 2 * i + 1
        c, d = (2 * i + 2, 2 * i + 3) if i < 23 else (1, 0)
        faces += [[a, c, b], [b, c, d]]
    scan = scan_from_arrays(vertices, np.array(faces))
    left = scan.report.inconsistent_edges.found - scan.report.inconsistent_edges.fixed
    assert left > 0 and scan.report.closed_components == 0
    assert int((~edge_table(scan.faces).consistent).sum()) == left


def test_fins_and_borders_are_kept_and_counted() -> None:
    vertices, faces = grid()
    fin = np.array([[8, 16, len(vertices)]])  # a diagonal that two faces share already
    scan = scan_from_arrays(np.concatenate((vertices, [[2, 2, 5]])), np.concatenate((faces, fin)))
    assert scan.triangles == len(faces) + 1
    assert scan.report.non_manifold_edges.found == 1 and scan.report.non_manifold_edges.fixed == 0
    assert scan.report.boundary_edges.found == 4 * 6 + 2


def test_spatial_order_brings_neighbours_together() -> None:
    vertices, faces = grid(60)
    shuffled = np.random.default_rng(3).permutation(len(vertices))
    scan = scan_from_arrays(vertices[np.argsort(shuffled)], shuffled[faces])
    centre = scan.vertices[scan.faces].mean(axis=1)
    assert np.median(np.linalg.norm(np.diff(centre, axis=0), axis=1)) < 2.0
    assert np.median(np.abs(np.diff(scan.faces.astype(int), axis=1))) < 20


def test_far_offset_loses_nothing() -> None:
    vertices, faces = sphere(3)
    far = vertices + np.array([1e5, -2e5, 3e5])
    scan = scan_from_arrays(far, faces)
    assert {tuple(row) for row in scan.vertices.tolist()} == {tuple(row) for row in far.tolist()}
    assert scan.report.closed_components == 1 and scan.report.inside_out_components.found == 0


def test_scan_is_immutable_and_digest_follows_content() -> None:
    vertices, faces = grid()
    one, two = scan_from_arrays(vertices, faces), scan_from_arrays(vertices, faces)
    assert one.digest == two.digest and len(one.digest) == 64
    vertices[5, 2] = 1e-9
    assert scan_from_arrays(vertices, faces).digest != one.digest
    with pytest.raises(ValueError):
        one.vertices[0, 0] = 1.0
    assert one.extent_mm == pytest.approx(6 * 2**0.5) and one.centre_mm.tolist() == [3, 3, 0]


def test_report_speaks_to_people_and_to_json() -> None:
    vertices, faces = grid()
    report = scan_from_arrays(vertices, np.concatenate((faces, faces[:2]))).report
    assert report.lines()[0] == "72 triangles, 49 vertices, 1 component (read: 74 triangles)"
    assert "duplicate faces: 2 found, fixed" in report.lines() and "boundary edges: 24 found, kept" in report.lines()
    assert json.loads(json.dumps(report.to_dict()))["duplicate_faces"] == {"found": 2, "fixed": 2}


def test_strict_refuses_repairs_but_not_shared_vertices() -> None:
    vertices, faces = grid()
    soup = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    assert scan_from_arrays(*soup, strict=True).triangles == len(faces)
    with pytest.raises(InputError, match="2 duplicate faces"):
        scan_from_arrays(vertices, np.concatenate((faces, faces[:2])), strict=True)


# --- files ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "ply_ascii", "obj", "off", "glb"])
def test_every_format_gives_the_same_body(kind: str, tmp_path: Path) -> None:
    vertices, faces = sphere(2)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    name, _, ascii_form = kind.partition("_")
    options = {"encoding": "ascii"} if kind == "ply_ascii" else {}
    path = tmp_path / f"body.{name}"
    mesh.export(path, file_type="stl_ascii" if ascii_form and name == "stl" else name, **options)
    scan = load_scan(path)
    assert (scan.triangles, len(scan.vertices), scan.name, scan.source) == (320, 162, "body", path.name)
    assert volume_mm3(scan) == pytest.approx(volume_mm3(scan_from_arrays(vertices, faces)), rel=1e-6)


def test_glb_poses_are_applied_and_a_mirrored_body_still_faces_outward(tmp_path: Path) -> None:
    body = trimesh.Trimesh(*sphere(2), process=False)
    scene = trimesh.Scene()
    scene.add_geometry(body, transform=trimesh.transformations.translation_matrix([50, 0, 0]))
    scene.add_geometry(body, transform=np.diag([-1.0, 1.0, 1.0, 1.0]))
    scene.export(tmp_path / "two.glb")
    scan = load_scan(tmp_path / "two.glb")
    assert scan.report.components == 2 and scan.report.inside_out_components.found == 0
    assert scan.vertices[:, 0].max() == pytest.approx(60, rel=1e-6) and any("metres" in n for n in scan.report.notes)


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0), ("um", 1e-3), ("IN", 25.4)])
def test_units(unit: str, scale: float, tmp_path: Path) -> None:
    trimesh.Trimesh(*sphere(2), process=False).export(tmp_path / "s.ply")
    scan, plain = load_scan(tmp_path / "s.ply", unit), load_scan(tmp_path / "s.ply")
    assert np.array_equal(scan.vertices, plain.vertices * scale)


def binary_stl(count: int, held: int, comment: bytes = b"") -> bytes:
    return comment.ljust(80, b" ") + struct.pack("<I", count) + bytes(50 * held)


PLY = b"ply\nformat %s 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = PLY + b"element face %d\nproperty list uchar int vertex_indices\nend_header\n"

BAD_FILES = {
    "empty.stl": (b"", "is empty"),
    "tiny.stl": (b"solx", "has only 4 bytes"),
    "none.stl": (binary_stl(0, 0), "holds no triangles"),
    "cut.stl": (binary_stl(100, 60), "claims 100 triangles .* holds 60"),
    "lying.stl": (binary_stl(4_000_000_000, 1), "claims 4000000000 triangles"),
    "fewer.stl": (binary_stl(1, 3), "claims 1 triangles .* holds 3"),
    "zeros.stl": (binary_stl(9, 9), "every face is degenerate"),
    "cut_text.stl": (b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "1 facets begin, 0 end"),
    "huge.ply": (PLY_FACES % (b"binary_little_endian", 900_000_000, 1), "is cut short: its head claims 900000000 v"),
    "no_header.ply": (b"ply\nformat ascii 1.0\n", "does not start with a PLY header"),
    "odd.ply": (b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "odd.ply, line 3"),
    "cut.ply": (PLY_FACES % (b"ascii", 3, 2) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "claims 3 vertex, 2 face"),
    "more.ply": (PLY_FACES % (b"ascii", 3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 2 1\n", "is damaged"),
    "points.ply": (PLY % (b"ascii", 2) + b"end_header\n0 0 0\n1 0 0\n", r"point cloud \(2 points"),
    "index.ply": (PLY_FACES % (b"ascii", 3, 1) + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "index.ply, face 0: refers to v"),
    "spike.ply": (PLY_FACES % (b"ascii", 3, 1) + b"0 0 0\n1 0 0\n0 1e30 0\n3 0 1 2\n", "vertex 2: lies 1e.30 mm"),
    "nan.ply": (PLY_FACES % (b"ascii", 3, 1) + b"0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n", "NaN or infinite"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles|point cloud|cannot be read"),
    "index.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read as OBJ|refers to vertex"),
    "binary.obj": (bytes(200), "holds binary data"),
    "cut.off": (b"OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "claims 3 vertices and 2 faces, 4 lines follow"),
    "not.glb": (b"<gltf>" + bytes(50), "does not start like a GLB"),
    "packed.stl": (b"PK\x03\x04" + bytes(500), "is a zip archive; unpack it"),
    "scan.zip": (b"PK\x03\x04" + bytes(50), "is an archive; unpack it"),
    "cut.glb": (b"glTF" + struct.pack("<II", 2, 5000) + bytes(8), "cannot be read as GLB"),
    "notes.txt": (b"hello", "is no known mesh format"),
    "bare": (b"hello", "a name without an ending"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_get_one_clear_line(name: str, tmp_path: Path) -> None:
    content, message = BAD_FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        load_scan(tmp_path / name)
    assert name in caught.value.where and caught.value.remedy and "\n" not in str(caught.value)


def test_missing_file_folder_and_unknown_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_scan(tmp_path / "gone.stl")
    with pytest.raises(InputError, match="is a folder"):
        load_scan(tmp_path)
    with pytest.raises(InputError, match="unit 'furlong': is unknown; give one of mm"):
        load_scan(tmp_path / "gone.stl", "furlong")


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"vertices have shape \(3, 2\)"),
        (np.eye(3), np.zeros((0, 3), int), r"faces have shape \(0, 3\)"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "faces are of type float64"),
        (np.eye(3), [[0, 1, 3]], "face 0: refers to vertex 3"),
        (np.eye(3), [[0, 1, -1]], "refers to vertex -1"),
    ],
)
def test_bad_arrays(vertices: np.ndarray, faces: list, message: str) -> None:
    with pytest.raises(InputError, match=message):
        scan_from_arrays(vertices, np.array(faces))


def test_a_mutated_file_is_refused_or_read_never_crashes(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    rng = np.random.default_rng(5)
    read = refused = 0
    for kind in ("stl", "ply", "glb"):
        mesh.export(tmp_path / f"whole.{kind}")
        whole = (tmp_path / f"whole.{kind}").read_bytes()
        path = tmp_path / f"m.{kind}"
        for trial in range(40):
            data = bytearray(whole[: rng.integers(1, len(whole))] if trial % 2 else whole)
            for place in rng.integers(0, len(data), size=3):
                data[place] = rng.integers(0, 256)
            path.write_bytes(data)
            try:
                scan = load_scan(path)
            except InputError:
                refused += 1
                continue
            read += 1
            assert np.isfinite(scan.vertices).all() and scan.faces.min() >= 0
            assert scan.faces.max() < len(scan.vertices)
    assert refused > 60 and read > 5


# --- the real files ---------------------------------------------------------------------------------------------------

# What the name of each dirty file promises: (repairs that must be reported, the mesh must equal the clean crop).
DIRTY = {
    "00_clean_crop_8k.ply": ({}, True),
    "01_nan_vertices.ply": ({"not_finite_vertices": 5}, False),
    "02_dup_faces_10pct.ply": ({"duplicate_faces": 800}, True),
    "03_zero_area_500.ply": ({"degenerate_faces": 500}, True),
    "04_flipped_10pct.ply": ({"turned_faces": 800}, True),
    "05_all_inverted.ply": ({}, False),
    "06_nonmanifold_fins.ply": ({}, False),
    "07_metres.stl": ({"equal_vertices": 24000 - 4187}, False),
    "08_far_offset_1e5mm.stl": ({"equal_vertices": 24000 - 4187}, False),
    "09_noise_50um.ply": ({}, False),
    "10_cracked_soup.ply": ({"near_vertices": 24000 - 4187}, False),
    "11_holes_5pct.ply": ({"unused_vertices": 1}, False),
    "13_ascii.stl": ({"equal_vertices": 24000 - 4187}, False),
    "14_binary_solid_header.stl": ({"equal_vertices": 24000 - 4187}, True),
    "30_trimesh_busted.stl": ({}, False),
}
REFUSED = {
    "12_bad_index.ply": "face 8000: refers to vertex 4194",
    "15_truncated.stl": "claims 8000 triangles .* holds 5332",
    "16_empty.stl": "is empty",
}


@pytest.mark.parametrize("name", DIRTY)
def test_dirty_file_is_repaired_truthfully(name: str, data_dir: Path) -> None:
    expected, restored = DIRTY[name]
    scan = load_scan(data_dir / "dirty" / name)
    found = scan.report.to_dict()
    for fault, count in expected.items():
        assert (found[fault]["found"] if isinstance(found[fault], dict) else found[fault]) == count
    truth = load_scan(data_dir / "dirty" / "00_clean_crop_8k.ply")
    assert (scan.digest == truth.digest) == restored
    if name.startswith(("10", "13")):  # the same connectivity within the weld tolerance
        assert (scan.triangles, len(scan.vertices)) == (truth.triangles, len(truth.vertices))
        assert scan.report.boundary_edges == truth.report.boundary_edges
    left = edge_table(scan.faces)
    assert len(left.boundary) == found["boundary_edges"]["found"]
    assert left.non_manifold == found["non_manifold_edges"]["found"]
    assert vertex_components(scan.faces, len(scan.vertices))[0] == scan.report.components


@pytest.mark.parametrize("name", REFUSED)
def test_dirty_file_is_refused_with_place_and_remedy(name: str, data_dir: Path) -> None:
    with pytest.raises(InputError, match=REFUSED[name]) as caught:
        load_scan(data_dir / "dirty" / name)
    assert name in caught.value.where and caught.value.remedy


def test_no_dirty_file_is_forgotten(data_dir: Path) -> None:
    names = {path.name for path in (data_dir / "dirty").iterdir()}
    assert names <= DIRTY.keys() | REFUSED.keys()


def test_metres_read_as_mm_raise_a_question(data_dir: Path) -> None:
    path = data_dir / "dirty" / "07_metres.stl"
    assert any(
        "is the unit right?" in note and "m would make it 31.2 mm" in note for note in load_scan(path).report.notes
    )
    scan = load_scan(path, "m")
    assert scan.extent_mm == pytest.approx(31.18, abs=0.01) and scan.report.notes == ()


# Components, boundary and non-manifold edges as the manifest of the scans states them (found by another program).
MESHES = {
    "counter_machinepart_84k.stl": (6, 0, 0),
    "dental_ios_upper_100k.ply": (3, 1327, 27),
    "dental_model_chai3d_bottom.ply": (17, 0, 0),
    "dental_model_teeth_sofa_26k.ply": (32, 6, 0),
    "tooth_human_incisor_31k.ply": (1, 30, 1),
    "tooth_scan_molaR_10k.ply": (1, 107, 0),
}


@pytest.mark.parametrize("name", MESHES)
def test_counts_of_real_scans_agree_with_their_manifest(name: str, data_dir: Path) -> None:
    report = load_scan(data_dir / "meshes" / name).report
    assert (report.components, report.boundary_edges.found, report.non_manifold_edges.found) == MESHES[name]
