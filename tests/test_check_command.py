"""`hapticlod check`: the diagnosis of a scan, for people and as JSON."""

import json
from pathlib import Path

import pytest

import tuning.cli

# A tetrahedron, a face of it twice, one without area, and a vertex that is nowhere.
DIRTY = "OFF\n6 6 0\n0 0 0\n10 0 0\n0 10 0\n0 0 10\n5 0 0\nnan 0 0\n"
DIRTY += "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n3 2 1 0\n3 0 4 1\n"


@pytest.fixture
def dirty(tmp_path: Path) -> Path:
    path = tmp_path / "dirty.off"
    path.write_text(DIRTY)
    return path


def test_says_what_is_wrong(dirty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tuning.cli.run(["check", str(dirty)]) == 0
    shown = capsys.readouterr().out
    assert "10 x 10 x 10 mm, read in mm" in shown
    assert "duplicate faces: 1 found, fixed" in shown
    assert "degenerate faces: 1 found, fixed" in shown
    assert shown.splitlines()[-1] == "usable after repair"


def test_json_counts_every_defect(dirty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tuning.cli.run(["check", str(dirty), "--json", "--unit", "cm"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert held["needs_repair"] is True
    assert held["most_mm"] == [100.0, 100.0, 100.0]
    assert held["report"]["duplicate_faces"] == {"found": 1, "fixed": 1}
    assert held["report"]["degenerate_faces"] == {"found": 1, "fixed": 1}
    assert held["report"]["triangles"] == 4


def test_strict_refuses_what_needs_repair(dirty: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["check", str(dirty)], ["tune", str(dirty), "-o", str(tmp_path / "out.hlod")]):
        assert tuning.cli.run([*command, "--strict"]) == 2
        assert "needs repair (" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out.hlod").exists()


def test_a_scan_that_cannot_be_read_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty.stl").touch()
    assert tuning.cli.run(["check", str(tmp_path / "empty.stl"), "--json"]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "is empty (0 bytes)" in shown.err
