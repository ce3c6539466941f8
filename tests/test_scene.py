"""Scene files, ladders of scenes, and the runtime on several parts from Python."""

from pathlib import Path

import numpy as np
import pytest
from scene_shapes import TWO_PARTS, write_glb, write_scene

from hapticlod.bundle import read_bundle, write_bundle
from hapticlod.config import Level, LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder
from hapticlod.motion import Motion
from hapticlod.replay import DEFAULT_STATION, replay_levels, runtime_levels
from hapticlod.scene import Scene, rotation_matrix
from hapticlod.scene_file import load_scene
from hapticlod.scene_ladder import SceneRung, ladder_of
from hapticlod.tool import ball
from tuning.deliver import ladder_document


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write_scene(tmp_path_factory.mktemp("scene")))


@pytest.fixture(scope="module")
def ladder(scene: Scene) -> Ladder:
    return ladder_of(scene)


def press(onto: np.ndarray, outward: np.ndarray, ticks: int = 600) -> Motion:
    """From 3 mm above a place to 1 mm below it."""
    t = np.arange(ticks) / 1000.0
    height = np.maximum(3.0 - 10.0 * t, -1.0)
    return Motion(t, onto + height[:, None] * outward, None, 1000.0, "press", {})


def test_parts_lie_where_the_file_says(scene: Scene) -> None:
    ball_part, box = scene.parts
    assert [part.name for part in scene.parts] == ["ball", "the box"]
    assert scene.triangles == ball_part.scan.triangles + box.scan.triangles
    # Turned by 90 degrees about z, 8 x 10 x 6 mm is 10 x 8 x 6 mm.
    np.testing.assert_allclose(box.scan.vertices.min(axis=0), [7.0, -4.0, -3.0], atol=1e-5)
    np.testing.assert_allclose(box.scan.vertices.max(axis=0), [17.0, 4.0, 3.0], atol=1e-5)
    assert scene.face_materials is not None
    assert np.isnan(scene.face_materials[: ball_part.scan.triangles]).all()
    assert (scene.face_materials[ball_part.scan.triangles :, 0] == 0.5).all()


def test_quaternion_turns_as_its_axis_says() -> None:
    third = (0.5, 0.5, 0.5, 0.5)  # 120 degrees about (1, 1, 1): x -> y -> z -> x
    np.testing.assert_allclose(rotation_matrix(third) @ [1.0, 2.0, 3.0], [3.0, 1.0, 2.0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "place", "what"),
    [
        (("the box", "ball"), ":9:1: part.1.name: ", "names another part already"),
        (("box.stl", "bax.stl"), ":10:1: part.1.scan: ", "there is no file"),
        (("0.7071067811865476, 0.0, 0.0, 0.7", "0.9, 0.0, 0.0, 0.7"), ":13:1: part.1.orientation: ", "is no rotation"),
        (('"mm"\nposition', '"parsec"\nposition'), ":11:1: part.1.unit: ", "none of mm"),
        (("12.0, 0.0, 0.0", "12.0, 0.0"), ":12:1: part.1.position_mm", ""),
        (("stiffness_n_mm = 0.5", "stiffness_n_mm = -0.5"), ":14:14: part.1.material.stiffness_n_mm: ", ""),
        (("most_triangles = 400", "most_triangles = 50"), ":15:1: part.1.most_triangles: ", "less than least"),
        (("most_triangles = 400", "colour = 400"), ":15:1: part.1.colour: ", "unknown key"),
    ],
)
def test_faults_name_file_line_and_field(change: tuple[str, str], place: str, what: str, tmp_path: Path) -> None:
    assert change[0] in TWO_PARTS
    path = write_scene(tmp_path, TWO_PARTS.replace(*change))
    with pytest.raises(InputError) as error:
        load_scene(path)
    assert f"{path}{place}" in str(error.value)
    assert what in str(error.value)


def test_no_parts_is_no_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no part is given"):
        load_scene(write_scene(tmp_path, 'name = "empty"\n'))


def test_nodes_of_a_glb_become_parts(tmp_path: Path) -> None:
    vertices, _ = write_glb(tmp_path / "two.glb")
    path = tmp_path / "scene.toml"
    path.write_text('[[nodes]]\nscan = "two.glb"\n\n[[part]]\nname = "again"\nscan = "two.glb"\nnode = "right"\n')
    scene = load_scene(path)
    assert {part.name for part in scene.parts} == {"again", "left", "right"}
    for part in scene.parts:
        if part.name != "left":
            np.testing.assert_allclose(part.scan.vertices.min(axis=0), vertices.min(axis=0), atol=1e-4)
            np.testing.assert_allclose(part.scan.vertices.max(axis=0), vertices.max(axis=0), atol=1e-4)
    path.write_text('[[part]]\nname = "lost"\nscan = "two.glb"\nnode = "middle"\n')
    with pytest.raises(InputError, match="has no node 'middle' with a mesh; name one of left, right"):
        load_scene(path)


def test_rungs_show_one_share_of_every_part_within_its_bounds(ladder: Ladder) -> None:
    for rung in ladder.rungs:
        assert isinstance(rung, SceneRung)
        ball_rung, box_rung = rung.parts
        assert ball_rung.triangles + box_rung.triangles == rung.triangles == len(rung.faces)
        assert 98 <= ball_rung.triangles <= 1280
        assert 98 <= box_rung.triangles <= 400
        assert rung.faces.max() < len(rung.vertices)
    counts = [rung.triangles for rung in ladder.rungs]
    assert counts == sorted(counts, reverse=True)
    told = ladder_document(ladder)["rungs"]
    assert [rung["triangles"] for rung in told] == counts
    assert told[0]["area_part"] == 1.0 and all(0.9 < rung["area_part"] < 1.01 for rung in told)
    assert all(rung["components"] == 2 for rung in told)
    middle = ladder.at(700)
    assert 650 <= middle.triangles <= 700
    assert ladder.at(middle.triangles) is middle
    assert 0.0 < middle.rms_mm <= middle.hausdorff_mm < 2.0


def test_the_runtime_touches_what_is_shown(scene: Scene, ladder: Ladder) -> None:
    config = LodConfig(levels=(Level(triangles=ladder.rungs[0].triangles, cell_mm=2.0, balls=1),), blend_ms=0.0)
    levels = runtime_levels(config, ladder)
    motion = press(np.array([14.0, 0.0, 4.0]), np.array([0.0, 0.0, 1.0]))
    record = replay_levels(levels, config, scene.centre_mm, motion, ball(1.0), DEFAULT_STATION, 1)
    # On the box's upper side, which is half as stiff as the station.
    np.testing.assert_allclose(record.scp[-1], [14.0, 0.0, 4.0], atol=1e-4)
    np.testing.assert_allclose(record.force[-1], [0.0, 0.0, 0.5], atol=1e-4)
    from hapticlod import _runtime

    data = config.to_runtime(DEFAULT_STATION, ball(1.0), scene.centre_mm)
    renderer = _runtime.Renderer(levels, data.tobytes(), ball(1.0).rows)
    visible = np.full(motion.ticks, 3, dtype=np.uint64)
    visible[450:] = 1  # the box is hidden under the tool
    rows = np.frombuffer(renderer.replay(motion.time_s, motion.position_mm, visible=visible), dtype=record.rows.dtype)
    assert rows["contact"][449] == 1
    assert rows["contact"][-1] == 0
    assert (rows["force_n"][-1] == 0.0).all()


def test_a_bundle_keeps_parts(scene: Scene, ladder: Ladder, tmp_path: Path) -> None:
    counts = [ladder.rungs[0].triangles, ladder.rungs[2].triangles, ladder.rungs[-1].triangles]
    config = LodConfig(
        levels=tuple(Level(triangles=n, cell_mm=2.0 + k, balls=1) for k, n in enumerate(counts)),
        speeds_mm_s=(20.0, 60.0),
    )
    levels = runtime_levels(config, ladder)
    path = tmp_path / "scene.hlod"
    write_bundle(
        path, levels=levels, config=config.to_runtime(DEFAULT_STATION, ball(1.0), scene.centre_mm), tool=ball(1.0),
        manifest={}, parts=scene.parts,
    )  # fmt: skip
    held = read_bundle(path)
    assert [part.name for part in held.parts] == ["ball", "the box"]
    assert held.parts[1].position_mm == (12.0, 0.0, 0.0)
    assert len(held.levels) == sum(part.level_count for part in held.parts)
    for part, own in zip(held.parts, zip(*[level.parts for level in levels], strict=True), strict=True):
        for k, level in enumerate(own):
            stored = held.levels[part.first_level + min(k, part.level_count - 1)]
            assert stored.vertices.tobytes() == level.arrays()["vertices"]
    spoiled = bytearray(path.read_bytes())
    at = spoiled.index(b"the box")
    spoiled[at : at + 3] = b"\0\0\0"
    (tmp_path / "spoiled.hlod").write_bytes(spoiled)
    with pytest.raises(InputError):
        read_bundle(tmp_path / "spoiled.hlod")
