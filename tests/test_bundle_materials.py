"""Materials through the bundle: written by Python, read by both readers, rendered by the station, checked by all."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plate_bundle import CELLS_MM, plate, plate_config, plate_motion, plate_tool, rendered, run_station
from test_bundle import changed, refusal, sections_of
from test_station_program import read_record, without_cost

from hapticlod import _runtime
from hapticlod.bundle import read_bundle, write_bundle
from hapticlod.bundle.format import SectionType
from hapticlod.bundle.write import container
from hapticlod.motion import load_motion, save_motion


def two_materials(vertices: np.ndarray) -> np.ndarray:
    """(n, 3) float32, -1 where it is the station's: the right third."""
    x = vertices[:, :1]
    return np.where(x < -2, (0.4, 0.3, 0.2), np.where(x < 2, (0.8, 0.1, 0.1), (-1, -1, -1))).astype(np.float32)


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    """Arguments of `write_bundle`: the plate of two levels, made of two materials."""
    meshes = [plate(squares) for squares in (6, 3)]
    levels = [_runtime.Level(v, f, cell, two_materials(v)) for (v, f), cell in zip(meshes, CELLS_MM, strict=True)]
    config, tool, motion = plate_config(levels), plate_tool(), plate_motion(600)
    return {
        "levels": levels, "config": config, "tool": tool, "manifest": {"scan": "plate"}, "golden_motion": motion,
        "golden_record": rendered(levels, config, tool, motion),
    }  # fmt: skip


@pytest.fixture
def bundle_path(parts: dict[str, Any], tmp_path: Path) -> Path:
    path = tmp_path / "plate.hlod"
    write_bundle(path, **parts)
    return path


def test_round_trip(parts: dict[str, Any], bundle_path: Path) -> None:
    bundle = read_bundle(bundle_path)
    for level, original in zip(bundle.levels, parts["levels"], strict=True):
        assert level.materials is not None
        assert level.materials.tobytes() == original.arrays()["materials"]
        assert level.materials["stiffness_n_mm"].tolist() == two_materials(level.vertices)[:, 0].tolist()
        assert level.bytes == original.bytes
    again = [
        _runtime.Level(x.vertices, x.faces, x.cell_mm, x.materials.view("<f4").reshape(-1, 3))
        for x in bundle.levels
        if x.materials is not None
    ]
    assert bundle.golden_motion is not None
    rows = rendered(again, bundle.config, bundle.tool, bundle.golden_motion)
    assert without_cost(rows) == without_cost(parts["golden_record"])


def test_a_bundle_without_materials_has_no_such_section(parts: dict[str, Any], tmp_path: Path) -> None:
    levels = [_runtime.Level(*plate(n), cell) for n, cell in zip((6, 3), CELLS_MM, strict=True)]
    path = tmp_path / "plain.hlod"
    write_bundle(path, **{**parts, "levels": levels})
    bundle = read_bundle(path)
    assert SectionType.MATERIALS not in {section.type for section in bundle.sections}
    assert [level.materials for level in bundle.levels] == [None, None]
    assert "with materials" not in run_station("inspect", path).stdout


def test_the_station_renders_them(parts: dict[str, Any], bundle_path: Path, tmp_path: Path) -> None:
    said = json.loads(run_station("inspect", bundle_path, "--json").stdout)
    assert [level["materials"] for level in said["levels"]] == [True, True]
    assert [level["bytes"] for level in said["levels"]] == [level.bytes for level in parts["levels"]]
    assert "with materials" in run_station("inspect", bundle_path).stdout
    save_motion(tmp_path / "motion.csv", parts["golden_motion"])
    motion = load_motion(tmp_path / "motion.csv", 1000.0)[0]
    result = run_station("replay", bundle_path, tmp_path / "motion.csv", tmp_path / "out.csv")
    assert result.returncode == 0, result.stderr
    rows = rendered(parts["levels"], parts["config"], parts["tool"], motion)
    station = read_record(tmp_path / "out.csv")
    # The two readers scale the file's quaternions to unit length each in its own way: the last bit may differ.
    for field in ("scp_mm", "force_n", "torque_n_mm"):
        np.testing.assert_allclose(station[field], rows[field], rtol=0, atol=1e-12)
    assert (station["level"] == rows["level"]).all()
    plain = [_runtime.Level(*plate(n), cell) for n, cell in zip((6, 3), CELLS_MM, strict=True)]
    stiff = rendered(plain, parts["config"], parts["tool"], motion)
    assert np.abs(rows["force_n"] - stiff["force_n"]).max() > 0.05


def test_both_readers_judge_wrong_materials_alike(parts: dict[str, Any], bundle_path: Path) -> None:
    write_bundle(bundle_path, **{**parts, "golden_motion": None, "golden_record": None})
    sections = sections_of(bundle_path)
    values = [np.nan, np.inf, -np.inf, -0.5, 0.0, 2e6, 1e6, 11.0, 0.05, -1.0]
    verdicts = []
    for column in range(3):
        for value in values:

            def put(content: bytearray, column: int = column, value: float = value) -> None:
                content[24 + 4 * column : 28 + 4 * column] = np.float32(value).tobytes()

            bundle_path.write_bytes(container(changed(sections, SectionType.MATERIALS, 1, put)))
            result = run_station("inspect", bundle_path)
            assert result.returncode in (0, 2)
            if result.returncode == 2:
                assert "level 1: a material's" in result.stderr
                assert "level 1: a material's" in refusal(bundle_path, bundle_path.read_bytes())
            else:
                read_bundle(bundle_path)
            verdicts.append(result.returncode == 0)
    assert 5 <= sum(verdicts) <= 15

    def shorten(content: bytearray) -> None:
        del content[-12:]

    wrong = container(changed(sections, SectionType.MATERIALS, 0, shorten))
    assert "level 0, materials and vertices differ in number" in refusal(bundle_path, wrong).replace(": ", ", ")
    assert "materials and vertices differ in number" in run_station("inspect", bundle_path).stderr


def test_every_flipped_byte_is_refused(bundle_path: Path) -> None:
    file = bytearray(bundle_path.read_bytes())
    for section in read_bundle(bundle_path).sections:
        if section.type == SectionType.MATERIALS and section.level == 1:
            for place in range(section.offset, section.offset + section.length, 5):
                file[place] ^= 0x10
                assert "MATERIALS of level 1, is damaged" in refusal(bundle_path, file).replace(": ", ", ")
                file[place] ^= 0x10


def test_a_newer_version_is_refused_by_name(bundle_path: Path) -> None:
    """Without its materials a bundle would feel like another: they are not optional."""
    newer = container(sections_of(bundle_path), section_version={(SectionType.MATERIALS, 0): 2})
    assert "MATERIALS of level 0: is needed and has version 2" in refusal(bundle_path, newer)
    assert "MATERIALS of level 0: is needed and has version 2" in run_station("inspect", bundle_path).stderr
