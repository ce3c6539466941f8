"""The command line: what users type, what they read, and what a fault looks like to them."""

import io
import json
import os
import signal
import struct
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

import tuning.cli
from hapticlod.bundle import read_bundle
from hapticlod.dentition import make_dentition
from hapticlod.metrics import METRIC_KEYS
from hapticlod.scan import Scan

SPHERE_OFF = "OFF\n4 4 0\n0 0 0\n10 0 0\n0 10 0\n0 0 10\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a command that must be refused, and return the one line it printed under its stages."""
    status = tuning.cli.run([str(word) for word in words])
    shown = capsys.readouterr()
    assert status == 2
    assert shown.out == ""
    assert "Traceback" not in shown.err
    lines = shown.err.splitlines()
    stages = [line for line in lines[:-1] if not (line.endswith(" ...") or line.startswith("    "))]
    assert stages == [], shown.err
    return lines[-1]


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    path = tmp_path / "tetrahedron.off"
    path.write_text(SPHERE_OFF)
    return path


def write_stl(path: Path, scan: Scan, claimed: int | None = None) -> None:
    """Binary STL of a scan; `claimed` is the face count that its header states."""
    corners = scan.vertices[scan.faces].astype("<f4")
    rows = b"".join(struct.pack("<3f", 0, 0, 0) + corner.tobytes() + b"\0\0" for corner in corners)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", claimed or len(corners)) + rows)


def test_help_and_version_load_neither_jax_nor_a_mesh_reader() -> None:
    code = (
        "import sys, tuning.cli\n"
        "assert tuning.cli.run(['--help']) == 0 and tuning.cli.run(['--version']) == 0\n"
        "assert tuning.cli.run(['tune', '--help']) == 0\n"
        "print(sorted({'jax', 'trimesh', 'scipy'} & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[-1] == "[]"
    assert "--budget-us" in shown.stdout


def test_unknown_commands_and_options_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert "tun" in refused(capsys, "tun")
    assert "--output" in refused(capsys, "tune", "scan.stl")
    assert "--colour" in refused(capsys, "tune", "scan.stl", "-o", "x.hlod", "--colour", "red")
    assert "--seed" in refused(capsys, "tune", "scan.stl", "-o", "x.hlod", "--seed", "lucky")


@pytest.mark.parametrize("levels", ["0", "0-2", "3-2", "1-6", "two", "1-", ""])
def test_level_ranges_that_make_no_sense(levels: str, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--levels" in refused(capsys, "tune", scan_file, "-o", scan_file.parent / "x.hlod", f"--levels={levels}")


class TestScans:
    def tune(self, capsys: pytest.CaptureFixture[str], scan: Path, *options: object) -> str:
        output = scan.parent / "out.hlod"
        before = set(scan.parent.iterdir())
        line = refused(capsys, "tune", scan, "-o", output, "--json", scan.parent / "out.json", *options)
        assert set(scan.parent.iterdir()) == before, "a refused job left files behind"
        return line

    def test_missing(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "absent.stl" in self.tune(capsys, tmp_path / "absent.stl")

    def test_a_folder(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "scans").mkdir()
        assert "scans" in self.tune(capsys, tmp_path / "scans")

    def test_empty(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "empty.stl").touch()
        assert "empty.stl" in self.tune(capsys, tmp_path / "empty.stl")

    def test_truncated(self, tmp_path: Path, small_dentition: Scan, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "cut.stl"
        write_stl(path, small_dentition)
        path.write_bytes(path.read_bytes()[:-12_345])
        line = self.tune(capsys, path)
        assert "cut.stl" in line

    def test_no_faces(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "points.off").write_text("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n")
        assert "points.off" in self.tune(capsys, tmp_path / "points.off")

    def test_bad_index(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "index.off").write_text("OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 1 2 99\n")
        assert "index.off" in self.tune(capsys, tmp_path / "index.off")

    def test_unknown_unit(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "furlong" in self.tune(capsys, scan_file, "--unit", "furlong")


class TestOtherFiles:
    @pytest.mark.parametrize(
        ("name", "text", "named"),
        [
            ("headless.csv", "0.0,1.0,2.0,3.0\n0.001,1.0,2.0,3.0\n", "headless.csv"),
            ("nan.csv", "t_s,x_mm,y_mm,z_mm\n0.0,1,2,3\n0.1,1,nan,3\n0.2,1,2,3\n", "nan.csv:3"),
            ("empty.csv", "", "empty.csv"),
        ],
    )
    def test_motions(
        self, name: str, text: str, named: str, scan_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        motion = scan_file.parent / name
        motion.write_text(text)
        assert named in refused(capsys, "tune", scan_file, "-o", motion.with_suffix(".hlod"), "--motions", motion)

    def test_a_station_with_a_typo(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        station = scan_file.parent / "desk.toml"
        station.write_text('name = "desk"\nloop_hz = 1000.0\nbudgget_us = 200.0\n')
        line = refused(capsys, "tune", scan_file, "-o", station.with_suffix(".hlod"), "--station", station)
        assert "desk.toml:3" in line and "budgget_us" in line

    def test_a_station_file_that_is_something_else(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        for text, named in (
            ('name = "ball"\nkind = "ball"\nradius_mm = 1.0\n', "kind"),
            ("[robot]\nhz = 1\n", "robot"),
        ):
            station = scan_file.parent / "other.toml"
            station.write_text(text)
            line = refused(capsys, "tune", scan_file, "-o", station.with_suffix(".hlod"), "--station", station)
            assert "other.toml" in line and named in line

    def test_a_tool_that_is_no_toml(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        tool = scan_file.parent / "burr.toml"
        tool.write_text("name = \n")
        assert "burr.toml:1" in refused(capsys, "tune", scan_file, "-o", tool.with_suffix(".hlod"), "--tool", tool)

    def test_materials_that_cannot_be(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        made_of = scan_file.parent / "map.toml"
        for text, named in (
            ("[default]\nstiffness_n_mm = 0\n", "map.toml:2:1: default.stiffness_n_mm"),
            ("[[material]]\ncomponent = 1\nstiffness_n_mm = 1\n", "map.toml:2:1: there is no component 1"),
            ("[[material]]\ncolour = [1, 2, 3]\nstiffness_n_mm = 1\n", "map.toml:2:1: tetrahedron has no colours"),
        ):
            made_of.write_text(text)
            line = refused(capsys, "tune", scan_file, "-o", scan_file.parent / "x.hlod", "--materials", made_of)
            assert named in line

    @pytest.mark.parametrize(
        "option", ["--budget-us=0", "--budget-us=1e9", "--budget-us=-5", "--loop-hz=0", "--budget-us=nan"]
    )
    def test_stations_that_cannot_be(self, option: str, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        line = refused(capsys, "tune", scan_file, "-o", scan_file.with_suffix(".hlod"), option)
        assert option.split("=")[0].strip("-").replace("-", "_") in line

    def test_an_output_folder_that_does_not_exist(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "nowhere" in refused(capsys, "tune", scan_file, "-o", scan_file.parent / "nowhere" / "x.hlod")

    def test_an_output_that_would_overwrite_the_scan(self, scan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "tetrahedron.off" in refused(capsys, "tune", scan_file, "-o", scan_file)
        assert scan_file.read_text() == SPHERE_OFF


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A folder in which `hapticlod tune` was typed, and what it printed. Its motions are short; the cache is empty."""
    from tuning import own_hands

    folder = tmp_path_factory.mktemp("tuned")
    write_stl(folder / "jaw.stl", make_dentition(triangles=10_000, seed=0))
    words = ["tune", "jaw.stl", "-o", "jaw.hlod", "--json", "jaw.json", "--levels", "2-2", "--budget-us", "500"]
    out, notes = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("COLUMNS", "80"), ("HAPTICLOD_CACHE", str(folder / "cache"))):
            patch.setenv(name, value)
        for name in ("SEEN_S", "APART_S", "SWITCH_S"):
            patch.setattr(own_hands, name, (2.5,))
        for name, few in (("SCREENED", 8), ("STARTS", 3)):
            patch.setattr(f"tuning.search.{name}", few)
        patch.chdir(folder)
        with redirect_stdout(out), redirect_stderr(notes):
            assert tuning.cli.run(words) == 0, notes.getvalue()
    return SimpleNamespace(folder=folder, out=out.getvalue(), notes=notes.getvalue())


@pytest.mark.slow
class TestTuning:
    """One small run, from a file to a bundle, and what a user does with the result."""

    KEYS: ClassVar = {
        "levels", "speeds_mm_s", "hysteresis", "l_in_mm", "l_out_mm", "blend_ms", "filter_hz", "predicted", "measured",
        "baselines", "stages_s", "population", "sensitivities", "repair", "ladder",
    }  # fmt: skip

    def test_json_holds_the_configuration_and_its_numbers(self, tuned: SimpleNamespace) -> None:
        told = json.loads((tuned.folder / "jaw.json").read_text())
        assert told.keys() >= self.KEYS
        assert 1 <= len(told["levels"]) <= 2 and len(told["speeds_mm_s"]) == len(told["levels"]) - 1
        for level in told["levels"]:
            assert 1 <= level["triangles"] <= 10_100 and level["cell_mm"] > 0
        assert told["predicted"].keys() == told["measured"].keys() == set(METRIC_KEYS)
        assert set(told["baselines"]) == {"finest_only", "coarsest_only", "paper"}
        assert told["measured"]["loop_cost_p999_us"] <= 500.0
        assert told["feasible"] is True and told["explanation"]
        assert {"residual", "reliable", "budget_us", "memory_mb"} == told["sensitivities"].keys()
        assert told["population"] == {"over": "pooled"}
        rungs = told["ladder"]["rungs"]
        assert rungs[0]["triangles"] == told["repair"]["triangles"] and rungs[0]["hausdorff_mm"] == 0.0
        assert all(0.5 < rung["area_part"] < 1.5 and rung["components"] >= 1 for rung in rungs)
        assert all(seconds >= 0 for seconds in told["stages_s"].values()) and "optimise" in told["stages_s"]

    def test_the_table_shows_every_column_at_80_characters(self, tuned: SimpleNamespace) -> None:
        lines = tuned.out.splitlines()
        assert max(map(len, lines)) <= 80 and "…" not in tuned.out
        rule = next(i for i, line in enumerate(lines) if "──" in line)
        heads = " ".join(" ".join(lines[rule - 2 : rule]).split())
        for word in ("loop cost", "p99.9 us", "felt error", "JND", "nuity 1/s", "switches", "memory", "feasible"):
            assert word in heads, heads
        names = ("finest only", "coarsest only", "the paper's", "tuned")
        rows = [next(line for line in lines if line.strip().startswith(name)) for name in names]
        assert all(row.split()[-1] in ("yes", "no") for row in rows)
        assert rows[-1].split()[-1] == "yes"

    def test_every_stage_is_shown(self, tuned: SimpleNamespace) -> None:
        for stage in ("ladder", "motions", "optimise", "verify", "baselines", "bundle"):
            assert stage in tuned.notes

    def test_what_fits_whole_is_not_searched(
        self,
        tuned: SimpleNamespace,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        """With one level allowed the full scan is the answer at once: nothing feels better."""
        from tuning import own_hands

        for name in ("SEEN_S", "APART_S", "SWITCH_S"):
            monkeypatch.setattr(own_hands, name, (2.5,))
        monkeypatch.setenv("HAPTICLOD_CACHE", str(tuned.folder / "cache"))
        bundle = tmp_path / "whole.hlod"
        assert tuning.cli.run(["tune", str(tuned.folder / "jaw.stl"), "-o", str(bundle), "--budget-us", "500"]) == 0
        shown = capsys.readouterr()
        assert "optimise" not in shown.err and "One level, the full scan" in shown.out
        levels = read_bundle(bundle).levels
        assert [level.triangles for level in levels] == [
            json.loads((tuned.folder / "jaw.json").read_text())["repair"]["triangles"]
        ]

    def test_the_bundle_reads_back(self, tuned: SimpleNamespace) -> None:
        told = json.loads((tuned.folder / "jaw.json").read_text())
        held = read_bundle(tuned.folder / "jaw.hlod")
        assert [level.triangles for level in held.levels] == [level["triangles"] for level in told["levels"]]
        assert held.manifest["measured"] == told["measured"]
        assert held.golden_motion is not None and held.golden_record is not None

    def test_inspect_says_what_it_holds(self, tuned: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
        assert tuning.cli.run(["inspect", str(tuned.folder / "jaw.hlod")]) == 0
        shown = capsys.readouterr().out
        assert "all digests match" in shown and "point" in shown and "jaw.stl" in shown

    def test_nothing_else_is_left(self, tuned: SimpleNamespace) -> None:
        assert {path.name for path in tuned.folder.iterdir()} - {"cache"} == {"jaw.stl", "jaw.hlod", "jaw.json"}

    def test_ctrl_c_leaves_nothing_half_written(self, tuned: SimpleNamespace) -> None:
        folder = tuned.folder
        before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir() if path.is_file()}
        words = ["tune", "jaw.stl", "-o", "other.hlod", "--json", "other.json", "--seed", "1"]
        running = command(folder, words)
        assert running.stderr is not None
        notes = ""
        for line in running.stderr:  # until replays are under way
            notes += line
            if "motions" in line:
                break
        running.send_signal(signal.SIGINT)
        out, rest = running.communicate(timeout=60)
        assert running.returncode == 130, notes + rest
        assert out == "" and "Traceback" not in rest
        assert rest.splitlines()[-1] == "interrupted; nothing was written"
        assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir() if path.is_file()} == before


def command(folder: Path, words: list[str]) -> subprocess.Popen[str]:
    """`hapticlod` in a folder, with a cache of its own: nothing comes from runs before."""
    environment = {**os.environ, "HAPTICLOD_CACHE": str(folder / "cache")}
    # A shell's background job ignores Ctrl-C, and so would what the tests start in one: what is ignored is inherited.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "tuning.cli", *words], cwd=folder, env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    finally:
        signal.signal(signal.SIGINT, before)
