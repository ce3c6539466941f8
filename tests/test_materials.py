"""Materials of a scan: PLY properties and material maps in, cleaning, the ladder, and what is wrong with bad ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from hapticlod import load_materials
from hapticlod.config import Level, LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import build_ladder
from hapticlod.material import material_lines, means, transferred
from hapticlod.motion import Motion
from hapticlod.replay import replay
from hapticlod.scan import Scan, load_scan, scan_from_arrays
from hapticlod.shipped import shipped_config
from hapticlod.tool import point

SOFT, HARD = (0.4, 0.3, 0.2), (2.0, 0.1, 0.05)
ENAMEL, GUM = (240, 235, 220), (226, 120, 130)


def flat(cells: int = 20, half_mm: float = 10.0, shake: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A square in z = 0; `shake` moves its inner vertices by that part of the pitch, within the plane."""
    axis = np.linspace(-half_mm, half_mm, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    inner = (np.abs(x) < half_mm) & (np.abs(y) < half_mm)
    moved = shake * (axis[1] - axis[0]) * np.random.default_rng(0).uniform(-1, 1, (2, *x.shape)) * inner
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    vertices = np.column_stack(((x + moved[0]).ravel(), (y + moved[1]).ravel(), np.zeros(x.size)))
    return vertices, np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))


def middles(scan: Scan) -> np.ndarray:
    return scan.vertices[scan.faces].mean(axis=1)


def write_ply(
    path: Path, vertices: np.ndarray, faces: np.ndarray, properties: dict[str, np.ndarray], *, text: bool = False
) -> Path:
    """A PLY file with float properties of its faces."""
    names = "".join(f"property float {name}\n" for name in properties)
    head = (
        f"ply\nformat {'ascii' if text else 'binary_little_endian'} 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{names}end_header\n"
    )
    if text:
        columns = [np.asarray(column, dtype=np.float32) for column in properties.values()]
        lines = [" ".join(map(repr, map(float, row))) for row in vertices]
        lines += [
            " ".join(["3", *map(str, face), *(repr(float(column[i])) for column in columns)])
            for i, face in enumerate(faces.tolist())
        ]
        path.write_text(head + "\n".join(lines) + "\n")
        return path
    rows = np.zeros(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3), *((name, "<f4") for name in properties)])
    rows["n"], rows["corners"] = 3, faces
    for name, column in properties.items():
        rows[name] = column
    path.write_bytes(head.encode() + vertices.astype("<f8").tobytes() + rows.tobytes())
    return path


# --- PLY ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("name", ["stiffness", "stiffness_n_mm"])
def test_ply_properties_stay_with_their_faces(tmp_path: Path, name: str, text: bool) -> None:
    """Through welding, dropping and sorting: every face keeps what it had, told by where it is."""
    vertices, faces = flat()
    soup, corners = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    left = soup[corners].mean(axis=1)[:, 0] < 0.0
    row = np.where(left[:, None], SOFT, HARD)
    # A needle, a repeated face and one on NaN go away, with their values.
    soup = np.concatenate([soup, [[np.nan, 0, 0], [0, 0, 0], [5, 0, 0], [10, 0, 0]]])
    n = len(soup)
    corners = np.concatenate([[[n - 4, 0, 1]], corners, [[n - 3, n - 2, n - 1]], corners[:3]])
    row = np.concatenate([[[9.0, 9.0, 9.0]], row, [[8.0, 8.0, 8.0]], np.full((3, 3), 7.0)])
    path = write_ply(
        tmp_path / "a.ply", soup, corners, dict(zip((name, "friction_static", "friction_dynamic"), row.T, strict=True)),
        text=text,
    )  # fmt: skip
    scan = load_scan(path)
    assert scan.triangles == len(faces) and scan.report.duplicate_faces.found == 3
    assert scan.face_materials is not None
    expected = np.where(middles(scan)[:, :1] < 0.0, SOFT, HARD)
    assert np.abs(scan.face_materials - expected).max() < 1e-6


def test_a_mended_cap_takes_the_material_of_what_it_covers(tmp_path: Path) -> None:
    """A face without area on a long edge: flipped into its neighbour, it is made of what the neighbour is."""
    vertices = np.array([[0, 0, 0], [4, 0, 0], [2, 0, 0], [2, 3, 0], [2, -3, 0]], dtype=np.float64)
    faces = np.array([[0, 1, 3], [0, 2, 1], [0, 4, 2], [2, 4, 1]])
    scan = scan_from_arrays(vertices, faces, face_materials=np.array([SOFT, (9, 9, 9), HARD, HARD], dtype=np.float64))
    assert scan.face_materials is not None
    assert np.allclose(scan.face_materials, np.where(middles(scan)[:, 1:2] > 0.0, SOFT, HARD))


def test_what_a_ply_leaves_out_is_the_stations(tmp_path: Path) -> None:
    vertices, faces = flat(4)
    some = np.where(np.arange(len(faces)) < 10, 0.5, np.nan)
    scan = load_scan(write_ply(tmp_path / "a.ply", vertices, faces, {"stiffness": some}))
    assert scan.face_materials is not None
    assert np.isnan(scan.face_materials[:, 1:]).all() and np.isnan(scan.face_materials[:, 0]).sum() == len(faces) - 10
    none = load_scan(write_ply(tmp_path / "b.ply", vertices, faces, {"quality": some}))
    assert none.face_materials is None and none.vertex_materials is None
    nothing = load_scan(write_ply(tmp_path / "c.ply", vertices, faces, {"stiffness": np.full(len(faces), np.nan)}))
    assert nothing.face_materials is None and nothing.digest == none.digest


@pytest.mark.parametrize(
    ("properties", "fault"),
    [
        ({"stiffness": 1, "stiffness_n_mm": 1}, "both stiffness_n_mm and stiffness"),
        ({"friction_static": 0.2}, "friction_static without friction_dynamic"),
        ({"friction_dynamic": 0.2}, "friction_dynamic without friction_static"),
        ({"stiffness": -1}, r"face 3: stiffness -1 N/mm is not above 0"),
        ({"stiffness": np.inf}, "face 3: stiffness inf"),
        ({"friction_static": -0.1, "friction_dynamic": 0}, "face 3: static friction -0.1"),
        ({"friction_static": 0.1, "friction_dynamic": 0.2}, "face 3: dynamic friction 0.2 exceeds"),
        ({"friction_static": 0.1, "friction_dynamic": np.nan}, "face 3: has one coefficient"),
    ],
)
def test_impossible_properties_are_refused(tmp_path: Path, properties: dict[str, float], fault: str) -> None:
    vertices, faces = flat(2)
    usual = {"stiffness": 1.0, "stiffness_n_mm": 1.0, "friction_static": 0.2, "friction_dynamic": 0.1}
    columns = {name: np.full(len(faces), usual[name]) for name in properties}
    for name, value in properties.items():
        columns[name][3] = value
    with pytest.raises(InputError, match=fault):
        load_scan(write_ply(tmp_path / "bad.ply", vertices, faces, columns))


def test_properties_of_polygons_are_refused(tmp_path: Path) -> None:
    """A square is read as two triangles: which of its neighbours' values would be whose is not guessed."""
    path = tmp_path / "quads.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nproperty float stiffness\nend_header\n"
        "0 0 0\n5 0 0\n5 5 0\n0 5 0\n9 2 0\n4 0 1 2 3 0.5\n3 1 4 2 0.7\n"
    )
    with pytest.raises(InputError, match="stiffness has 2 values for 3 triangles; split its polygons"):
        load_scan(path)


def test_digest_and_arrays() -> None:
    vertices, faces = flat(3)
    plain = scan_from_arrays(vertices, faces)
    soft = plain.with_materials(np.tile(SOFT, (len(faces), 1)))
    assert plain.digest == scan_from_arrays(vertices, faces).digest
    assert len({plain.digest, soft.digest, plain.with_materials(np.tile(HARD, (len(faces), 1))).digest}) == 3
    assert soft.vertex_materials is not None and np.allclose(soft.vertex_materials, SOFT)
    with pytest.raises(InputError, match="shape"):
        plain.with_materials(np.zeros((3, 2)))
    with pytest.raises(InputError, match="one row"):
        scan_from_arrays(vertices, faces, face_materials=np.zeros((2, 3)))


# --- material maps --------------------------------------------------------------------------------------------------


def two_parts() -> Scan:
    """A sphere of 320 faces and one of 80, apart."""
    big, small = trimesh.creation.icosphere(2, 5.0), trimesh.creation.icosphere(1, 2.0)
    small.apply_translation([20.0, 0.0, 0.0])
    vertices = np.concatenate([small.vertices, big.vertices])
    return scan_from_arrays(vertices, np.concatenate([small.faces, big.faces + len(small.vertices)]), "two")


def coloured(path: Path, by_face: bool) -> Scan:
    """A square, gum on the left and enamel on the right, saved with its colours by trimesh."""
    vertices, faces = flat()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if by_face:
        side = vertices[faces].mean(axis=1)[:, 0] < 0.0
        mesh.visual.face_colors = np.where(side[:, None], GUM, ENAMEL)  # pyright: ignore
    else:
        mesh.visual.vertex_colors = np.where(vertices[:, :1] < 0.0, GUM, ENAMEL)  # pyright: ignore
    mesh.export(path)
    return load_scan(path)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "map.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("by_face", [False, True])
def test_shipped_map_by_colour(tmp_path: Path, by_face: bool) -> None:
    scan = coloured(tmp_path / "jaw.ply", by_face)
    made = load_materials(shipped_config("materials/enamel_gingiva.toml")).applied(scan)
    assert made.face_materials is not None
    x = middles(made)[:, 0]
    # By vertex: a face goes with most of its corners, so only those at the border are in question.
    sure = np.abs(x) > (0.0 if by_face else 1.0)
    expected = np.where(x[:, None] < 0.0, (0.35, 0.4, 0.3), (5.0, 0.15, 0.1))
    assert np.array_equal(made.face_materials[sure], expected[sure])
    assert len(np.unique(made.face_materials, axis=0)) == 2


def test_shipped_map_by_component() -> None:
    scan = two_parts()
    made = load_materials(shipped_config("materials/largest_is_bone.toml")).applied(scan)
    assert made.face_materials is not None
    bone = middles(made)[:, 0] < 10.0
    assert np.array_equal(made.face_materials, np.where(bone[:, None], (3.0, 0.2, 0.15), (0.5, 0.4, 0.3)))
    lines = material_lines(made, 1.0)
    assert any("stiffness_n_mm 0.5 to 3 on 100 %" in line for line in lines)
    assert any("is stiffer than the station's 1 N/mm" in line for line in lines)


def test_every_shipped_map_loads() -> None:
    folder = shipped_config("materials/enamel_gingiva.toml").parent
    assert len([load_materials(path) for path in sorted(folder.glob("*.toml"))]) >= 2


def test_the_rest_is_the_stations_and_a_map_replaces_what_was_there(tmp_path: Path) -> None:
    scan = two_parts().with_materials(np.tile(HARD, (400, 1)))
    made = load_materials(written(tmp_path, "[[material]]\ncomponent = 1\nstiffness_n_mm = 0.5\n")).applied(scan)
    assert made.face_materials is not None
    assert np.isnan(made.face_materials[:, 1:]).all()
    assert np.array_equal(np.isnan(made.face_materials[:, 0]), middles(made)[:, 0] < 10.0)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", r"map.toml:1:1: material: the map is empty"),
        ("[[material]]\ncomponent = 0\n", r"map.toml:1:1: material.0.stiffness_n_mm: no property is given"),
        ("[[material]]\ncomponent = 0\nstiffness_n_mm = -1\n", r":3:1: material.0.stiffness_n_mm: .*greater than 0"),
        ("[[material]]\nstiffness_n_mm = 1\n", r"material.0.component: give component or colour"),
        (
            "[[material]]\ncomponent = 0\ncolour = [1, 2, 3]\nstiffness_n_mm = 1\n",
            r":3:1: material.0.colour: give component or colour",
        ),
        ("[[material]]\ncolour = [1, 2, 300]\nstiffness_n_mm = 1\n", r":2:17: material.0.colour.2: .*less than"),
        ("[[material]]\ncomponent = 0\ntolerance = 3\nstiffness_n_mm = 1\n", r":3:1: material.0.tolerance: belongs"),
        (
            "[default]\nfriction_static = 0.1\nfriction_dynamic = 0.2\n",
            r":3:1: default.friction_dynamic: must not exceed friction_static",
        ),
        ("[default]\nfriction_static = 0.1\n", r"default.friction_dynamic: missing: friction_static is given"),
        ("[default]\nfriction_dynamic = 0.1\n", r"default.friction_static: missing: friction_dynamic is given"),
        ("[default]\nstifness_n_mm = 1\n", r":2:1: default.stifness_n_mm: unknown key; did you mean stiffness_n_mm\?"),
        (
            "[[material]]\ncomponent = 0\nstiffness_n_mm = 1\n[[material]]\ncomponent = 0\nstiffness_n_mm = 2\n",
            r"material: component 0 has two materials",
        ),
    ],
)
def test_faulty_maps(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        load_materials(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("component = 2\nstiffness_n_mm = 1\n", r"map.toml:2:1: there is no component 2: two has 2 components, 0 to 1"),
        ("colour = [1, 2, 3]\nstiffness_n_mm = 1\n", r"map.toml:2:1: two has no colours; name components"),
    ],
)
def test_maps_that_do_not_fit_the_scan(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        load_materials(written(tmp_path, "[[material]]\n" + text)).applied(two_parts())


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            "[[material]]\ncolour = [0, 0, 255]\nstiffness_n_mm = 1\n",
            r":2:1: nothing on jaw has the colour \[0, 0, 255\] within 8; its commonest are \[226, 120, 130\]",
        ),
        (
            "[[material]]\nname = 'a'\ncolour = [226, 120, 130]\nstiffness_n_mm = 1\n"
            "[[material]]\ncolour = [230, 125, 130]\ntolerance = 20\nstiffness_n_mm = 2\n",
            r":6:1: material 1 and material 0 \(a\) both match .* corners; lower a tolerance",
        ),
        (
            "[[material]]\ncolour = [226, 120, 130]\nstiffness_n_mm = 1\n"
            "[[material]]\ncomponent = 0\nstiffness_n_mm = 2\n",
            r":2:1: material 0 and material 1 both apply to .* faces; narrow one",
        ),
    ],
)
def test_colours_that_are_not_there_or_not_clear(tmp_path: Path, text: str, fault: str) -> None:
    scan = coloured(tmp_path / "jaw.ply", True)
    with pytest.raises(InputError, match=fault):
        load_materials(written(tmp_path, text)).applied(scan)


# --- the ladder -----------------------------------------------------------------------------------------------------


def test_means_follow_area_and_majority() -> None:
    values = np.array([[1.0, np.nan, np.nan], [4.0, 0.4, 0.2], [np.nan, 0.2, 0.1]])
    got = means(values, np.array([2.0, 1.0, 1.0]), np.zeros(3, dtype=int), 2)
    assert np.allclose(got[0], [2.0, 0.3, 0.15])
    assert np.isnan(got[1]).all()
    few = means(values, np.array([3.0, 1.0, 1.0]), np.zeros(3, dtype=int), 1)
    assert np.isnan(few[0, 1:]).all() and few[0, 0] == 1.75
    assert np.allclose(means(values[:2], np.zeros(2), np.zeros(2, dtype=int), 1)[0, 0], 2.5)


def test_a_vertex_that_nothing_maps_to_takes_the_nearest() -> None:
    values = np.array([SOFT, HARD])
    place = np.array([[0.0, 0, 0], [10.0, 0, 0], [9.0, 0, 0], [1.0, 0, 0]])
    got = transferred(values, np.ones(2), np.array([0, 1]), place)
    assert np.array_equal(got, [SOFT, HARD, HARD, SOFT])


def halves(cells: int, seed_shake: float = 0.3) -> Scan:
    vertices, faces = flat(cells, shake=seed_shake)
    made_of = np.where(vertices[faces].mean(axis=1)[:, :1] < 0.0, SOFT, HARD)
    return scan_from_arrays(vertices, faces, "halves", face_materials=made_of)


def test_rung_zero_is_the_mean_of_the_faces_around() -> None:
    scan = halves(20, 0.0)
    values = build_ladder(scan, rungs=1).rungs[0].materials
    assert values is not None
    x = scan.vertices[:, 0]
    assert np.allclose(values[x < -0.5], SOFT) and np.allclose(values[x > 0.5], HARD)
    border = np.abs(x) < 1e-9
    inner = border & (np.abs(scan.vertices[:, 1]) < 9.5)
    assert np.allclose(values[inner], 0.5 * (np.array(SOFT) + HARD))
    assert border.sum() == 21


@pytest.mark.parametrize("ratio", [4, 20, 60])
def test_a_border_stays_where_it_is_within_an_edge(ratio: int) -> None:
    """On coarse rungs of a flat square: beyond a mean edge from x = 0 every place is the one material or the other."""
    scan = halves(80)
    rung = build_ladder(scan, rungs=2, coarsest_ratio=ratio).rungs[-1]
    assert rung.materials is not None and rung.triangles < 1.5 * scan.triangles / ratio
    assert np.isfinite(rung.materials).all()
    rng = np.random.default_rng(1)
    weights = rng.dirichlet([1, 1, 1], (rung.triangles, 20))
    corners = rung.vertices[rung.faces]
    x = np.einsum("fsk,fk->fs", weights, corners[:, :, 0]).ravel()
    stiffness = np.einsum("fsk,fk->fs", weights, rung.materials[rung.faces][:, :, 0]).ravel()
    middle = 0.5 * (SOFT[0] + HARD[0])
    wrong = np.where(x < 0.0, stiffness > middle, stiffness < middle)
    assert np.abs(x[wrong]).max(initial=0.0) < rung.mean_edge_mm
    far = np.abs(x) > 2.0 * rung.mean_edge_mm
    assert far.any()
    share = np.mean(np.abs(stiffness - np.where(x < 0.0, SOFT[0], HARD[0]))[far] < 1e-9)
    assert share > 0.99


def test_replay_feels_the_materials_on_every_rung() -> None:
    scan = halves(60)
    ladder = build_ladder(scan, rungs=3, coarsest_ratio=30)
    t = np.arange(600) / 1000.0
    hip = np.zeros((600, 3))
    hip[:, 2] = np.where(np.arange(600) < 5, 0.1, -0.3)
    for x in (-6.0, 6.0):
        hip[:, 0], hip[:, 1] = x, 0.37
        motion = Motion(t, hip.copy(), None, 1000.0, "press", {})
        for rung in ladder.rungs:
            config = LodConfig(levels=(Level(triangles=rung.triangles, cell_mm=4.0 * rung.mean_edge_mm),))
            record = replay(config, ladder, motion, point())
            stiffness = min(1.0, SOFT[0] if x < 0 else HARD[0])
            assert record.force[-1, 2] == pytest.approx(0.3 * stiffness, abs=1e-4)
            assert record.level_bytes[0] > 0


def test_a_ladder_without_materials_has_none() -> None:
    vertices, faces = flat(20)
    ladder = build_ladder(scan_from_arrays(vertices, faces), rungs=2, coarsest_ratio=4)
    assert [rung.materials for rung in ladder.rungs] == [None, None]
