"""Units: what the user says wins, then what the file says, then a guess that says what it rests on."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hapticlod.dentition import make_dentition
from hapticlod.errors import InputError
from hapticlod.scan import load_scan
from hapticlod.scan_unit import UNITS_MM, guess_unit


def ball(path: Path) -> Path:
    """A sphere of 40 units across."""
    trimesh.creation.icosphere(subdivisions=2, radius=20.0).export(path)
    return path


def edited(path: Path, old: bytes, new: bytes) -> Path:
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    return path


def as_3mf(path: Path, unit: str) -> Path:
    ball(path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data.replace(b'unit="millimeter"', f'unit="{unit}"'.encode()))
    return path


def files(folder: Path) -> dict[str, tuple[Path, str]]:
    stl = ball(folder / "header.stl")
    stl.write_bytes(b"exported by a CAD UNITS=in".ljust(80, b" ") + stl.read_bytes()[80:])
    obj = ball(folder / "comment.obj")
    obj.write_bytes(b"# 3ds Max exporter\n# File units = centimeters\n" + obj.read_bytes())
    return {
        "glb": (ball(folder / "standard.glb"), "m"),
        "3mf": (as_3mf(folder / "named.3mf", "inch"), "in"),
        "3mf default": (as_3mf(folder / "default.3mf", "millimeter"), "mm"),
        "stl": (stl, "in"),
        "obj": (obj, "cm"),
        "ply": (edited(ball(folder / "comment.ply"), b"comment", b"comment unit: um\ncomment"), "um"),
    }


@pytest.mark.parametrize("which", ["glb", "3mf", "3mf default", "stl", "obj", "ply"])
def test_what_the_file_says(which: str, tmp_path: Path) -> None:
    path, unit = files(tmp_path)[which]
    scan = load_scan(path, None)
    assert scan.unit == unit
    assert np.ptp(scan.vertices[:, 0]) == pytest.approx(40.0 * UNITS_MM[unit], rel=1e-6)
    assert any(note.startswith(f"unit {unit}: ") for note in scan.report.notes)
    # The user wins, and is told what the file had said.
    asked = load_scan(path, "mm")
    assert np.ptp(asked.vertices[:, 0]) == pytest.approx(40.0, rel=1e-6)
    assert any("read in mm" in note for note in asked.report.notes) == (unit != "mm")


@pytest.mark.parametrize("unit", ["mm", "m", "in"])
def test_a_guess_recovers_a_dentition(unit: str, tmp_path: Path) -> None:
    scan = make_dentition(30_000)
    trimesh.Trimesh(scan.vertices / UNITS_MM[unit] + 1e3, scan.faces, process=False).export(tmp_path / "jaw.ply")
    found = load_scan(tmp_path / "jaw.ply", None)
    assert found.unit == unit
    assert found.extent_mm == pytest.approx(scan.extent_mm, rel=0.01)
    assert any("guess from the size" in note and "--unit" in note for note in found.report.notes)


def test_guesses_at_the_limits() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2]])
    assert guess_unit(triangle * 20.0, faces).name == "mm"
    assert guess_unit(triangle * 1e30, faces).name == "um"  # nothing fits: the nearest, and the size is noted anyway
    assert guess_unit(triangle * 1e300, faces).name == "mm"
    assert guess_unit(triangle * np.nan, faces).name == "mm"
    assert guess_unit(triangle * 0.0, faces).name == "mm"


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"PK\x03\x04 cut short", "is no 3MF archive"), (b"solid words", "is no 3MF archive")],
)
def test_bad_3mf(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "bad.3mf").write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_scan(tmp_path / "bad.3mf", None)


def test_an_archive_that_claims_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = as_3mf(tmp_path / "big.3mf", "millimeter")
    monkeypatch.setattr("hapticlod.scan_file._MOST_UNPACKED", 100)
    with pytest.raises(InputError, match="claims to unpack"):
        load_scan(path)


def test_metres_are_found_out(data_dir: Path) -> None:
    scan = load_scan(data_dir / "dirty" / "07_metres.stl", None)
    assert scan.unit == "m" and scan.extent_mm == pytest.approx(31.18, abs=0.01)
