"""`make scans-table`: rows are kept, one scan's end is not the others', and figures are those of the process."""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

import pytest

import benchmarks.scans_table
from benchmarks.measured_process import Taken, run_measured
from benchmarks.scans_table import scans_table_command
from hapticlod.errors import InputError


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for name in ("dirty/a.stl", "dirty/b.stl", "meshes/c.ply"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    return tmp_path


def answers(**of_scan: Taken) -> Any:
    """A `run_measured` that says what was agreed for the scan named in the command."""

    def run(command: list[str], limit_s: float, environment: dict[str, str]) -> Taken:
        assert "HAPTICLOD_CACHE" in environment
        return next(taken for name, taken in of_scan.items() if any(f"/{name}." in word for word in command))

    return run


def test_one_scans_failure_is_a_row_and_the_rest_goes_on(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = {
        "a": Taken(2, 0.5, 0.4, 60.0, "", f"{data}/dirty/a.stl: is odd; mend it\n"),
        "b": Taken(-9, 3.0, 2.0, 9000.0, "", "load and clean the scan ...\n"),
        "c": Taken(None, 9.0, 2.0, 100.0, "", ""),
    }
    monkeypatch.setattr(benchmarks.scans_table, "run_measured", answers(**said))
    assert scans_table_command(data=data, out=data / "out") == 1
    text = capsys.readouterr().out
    assert "| a.stl | refused | 0.5 | a.stl: is odd; mend it |" in text
    assert "| b.stl | FAILED | 3.0 | status -9: load and clean the scan ... |" in text
    assert "| c.ply | FAILED | 9.0 | stopped after 9 s |" in text
    assert (data / "out/scans.md").read_text() == text
    assert len((data / "out/scans.csv").read_text().splitlines()) == 4

    def again(*args: object) -> Taken:
        raise AssertionError("measured again")

    monkeypatch.setattr(benchmarks.scans_table, "run_measured", again)
    assert scans_table_command(data=data, out=data / "out") == 1  # all rows are there
    (data / "dirty/a.stl").write_bytes(b"another scan")
    with pytest.raises(AssertionError, match="measured again"):
        scans_table_command(data=data, out=data / "out")


def test_rows_of_another_program_are_made_again(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = Taken(2, 0.5, 0.4, 60.0, "", "x: is odd; mend it\n")
    monkeypatch.setattr(benchmarks.scans_table, "run_measured", answers(a=taken, b=taken, c=taken))
    assert scans_table_command(data=data, out=data / "out", only=("a.stl",)) == 0
    (row,) = (data / "out/rows").iterdir()
    row.write_text(json.dumps(json.loads(row.read_text()) | {"code": "older", "message": "of old"}))
    scans_table_command(data=data, out=data / "out", only=("a.stl",), keep=True)
    assert "of old" in (data / "out/scans.md").read_text()
    scans_table_command(data=data, out=data / "out", only=("a.stl",))
    assert "of old" not in (data / "out/scans.md").read_text()


def test_a_folder_without_scans_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no folder dirty"):
        scans_table_command(data=tmp_path, out=tmp_path / "out")


def test_a_process_is_measured_and_stopped() -> None:
    work = "import sys; a = bytearray(80_000_000); print(len(a)); print('last', file=sys.stderr); sys.exit(3)"
    taken = run_measured([sys.executable, "-c", work], 60.0, {})
    assert (taken.status, taken.out, taken.last_line) == (3, "80000000\n", "last")
    ours_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    assert 80.0 < taken.peak_mb < max(160.0, 1.1 * ours_mb) and 0.0 < taken.processor_s < 60.0
    assert run_measured([sys.executable, "-c", "import time; time.sleep(60)"], 0.3, {}).status is None
