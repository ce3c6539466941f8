"""The paper's experiments: meshes with its numbers, a loop that is late as a late loop is, figures by the command."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tuning.cli
from hapticlod.config import LodConfig, load_config
from hapticlod.motion import Motion
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import point
from tuning.experiments.meshes import PLANE_TRIANGLES, SPHERE_VERTICES, mesh_level, plane, sphere
from tuning.experiments.old_machine import Loop, run_late, slowdown_of, without_short_way
from tuning.experiments.slides import DEPTH_MM, slide_on_plane, slide_on_sphere
from tuning.report.plots import forces_over_time
from tuning.report.style import svg_of

pytest.importorskip("matplotlib", reason="hapticlod[report] is not installed")


def test_the_papers_meshes_have_its_triangles_and_sizes() -> None:
    flat = [plane(count) for count in PLANE_TRIANGLES]
    assert [scan.triangles for scan in flat] == [80000, 5000, 800]
    assert all(np.ptp(scan.vertices, axis=0) == pytest.approx([100.0, 100.0, 0.0]) for scan in flat)
    corner = [flat[2].vertices[flat[2].faces[:, k]] for k in range(3)]
    assert (np.cross(corner[1] - corner[0], corner[2] - corner[0])[:, 2] > 0).all()
    ball = sphere(SPHERE_VERTICES[2])
    assert (len(ball.vertices), ball.triangles) == (511, 1018)
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 50.0)
    a, b, c = (ball.vertices[ball.faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    assert 0.97 < volume / (4 / 3 * np.pi * 50.0**3) < 1.0  # closed, facing outward, inscribed
    assert [2 * n - 4 for n in SPHERE_VERTICES] == [101870, 10028, 1018]  # the paper's table 3


@pytest.mark.parametrize("mean_mm_s", [20.0, 130.0])
def test_slides_have_the_speed_that_was_asked_for_and_stay_on_the_surface(mean_mm_s: float) -> None:
    flat, round_ = slide_on_plane(mean_mm_s, 6.0), slide_on_sphere(mean_mm_s, 6.0)
    for motion in (flat, round_):
        way_mm = np.linalg.norm(np.diff(motion.position_mm[::20], axis=0), axis=1).sum()  # 20 ticks: past the encoder
        assert way_mm / 6.0 == pytest.approx(mean_mm_s, rel=0.06)
    assert np.abs(flat.position_mm[:, 2] + DEPTH_MM).max() < 0.013 and np.abs(flat.position_mm[:, :2]).max() < 31.0
    assert np.abs(np.linalg.norm(round_.position_mm, axis=1) - 49.0).max() < 0.03


def constant_cost(station: Station, ns: float) -> Station:
    """Every tick costs so much, whatever it counts."""
    nothing = dict.fromkeys(("cell_ns", "triangle_ns", "test_ns", "iteration_ns", "ball_ns", "mapping_cell_ns"), 0.0)
    return station.adjusted(cost={"base_ns": ns, **nothing, "cache_gain": 0.0})


def test_a_loop_that_runs_late_gives_old_forces_and_skips_periods() -> None:
    """A tick of 2.5 ms: begun at 0, 2.5, 5 ms...; what is felt at t is the force of the last tick that was ready."""
    scan = plane(800)
    level = mesh_level(scan, scan.centre_mm, 20.0)
    config = LodConfig.model_validate({"levels": [{"triangles": 800, "cell_mm": 20.0}]})
    station = constant_cost(load_station(shipped_config("stations/paper_2009.toml")), 2500.0)
    slow = station.adjusted(slowdown=1000.0, slowdown_reason="test")
    ticks = 200
    depth = 0.5 + 0.4 * np.sin(0.05 * np.arange(ticks))
    hip = np.column_stack([0.02 * np.arange(ticks), np.zeros(ticks), -depth])
    motion = Motion(np.arange(ticks) / 1000.0, hip, None, 1000.0, "press", {})
    loop = run_late([level], config, scan.centre_mm, motion, point(), slow)
    assert loop.rate_hz == pytest.approx(400.0) and loop.late_share == 1.0
    np.testing.assert_allclose(loop.started_s, 0.0025 * np.arange(len(loop.started_s)))
    for t in range(60, ticks):  # past the soft start
        ready = [k for k, at in enumerate(loop.started_s) if at + 0.0025 <= t / 1000.0 + 1e-9]
        seen = int(loop.started_s[ready[-1]] * 1000.0 + 1e-6)
        assert loop.felt_n[t, 2] == pytest.approx(depth[seen], abs=2e-3), t
    # A last tick that never comes back is part of the rate: 3 ticks in 2.002 s.
    stuck = Loop(loop.rows[:3], np.array([0.0, 0.001, 0.002]), np.array([500.0, 500.0, 2e6]), loop.felt_n)
    assert stuck.rate_hz == pytest.approx(3 / 2.002)
    # In time, it is the replay of every period, one period late at most.
    quick = run_late([level], config, scan.centre_mm, motion, point(), constant_cost(station, 100.0))
    assert len(quick.rows) == ticks and quick.late_share == 0.0
    np.testing.assert_allclose(quick.felt_n[61:, 2], depth[60:-1], atol=2e-3)


def test_the_old_machine_just_misses_where_it_was_assumed_to() -> None:
    from tuning.experiments.old_machine import MISSED_MM_S, cost_ns

    station, tool = load_station(shipped_config("stations/paper_2009.toml")), without_short_way(point())
    slow = station.adjusted(slowdown=slowdown_of(station, tool), slowdown_reason="test")
    scan, config = plane(80000), load_config(shipped_config("levels/paper_plane_80000.toml"))
    level = mesh_level(scan, scan.centre_mm, config.levels[0].cell_mm)
    from hapticlod.replay import replay_levels

    means_us = []
    for speed in (0.5 * MISSED_MM_S, MISSED_MM_S, 2.0 * MISSED_MM_S):
        motion = slide_on_plane(speed, 2.0, seed=5)
        rows = replay_levels([level], config, scan.centre_mm, motion, tool, slow, 1, cut_short=False).rows
        near = np.abs(motion.speed_mm_s() - speed) < 0.2 * speed
        means_us.append(float(1e-3 * slow.slowdown * cost_ns(rows[near], [level.bytes], slow).mean()))
    assert means_us[0] < 900.0 < means_us[1] < 1100.0 < means_us[2]


def test_cut_short_the_tool_stays_behind_where_the_loop_breaks_down() -> None:
    """80 000 triangles at 200 mm/s: solved to the end a plane pushes straight up, however late; cut short it drags."""
    config = load_config(shipped_config("levels/paper_plane_80000.toml"))
    scan = plane(80000)
    level = mesh_level(scan, scan.centre_mm, config.levels[0].cell_mm)
    slow = load_station(shipped_config("stations/paper_2009.toml")).adjusted(slowdown=800.0, slowdown_reason="test")
    along = {}
    for cut_short in (False, True):
        motion = slide_on_plane(200.0, 1.5)
        loop = run_late([level], config, scan.centre_mm, motion, without_short_way(point()), slow, cut_short=cut_short)
        assert loop.rate_hz < 100.0
        along[cut_short] = np.abs(loop.felt_n[:, :2]).max()
    assert along[False] < 1e-6 and along[True] > 1.0


def test_jumps_are_drawn_on_the_first_machine_that_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """80 000 triangles at 55 mm/s: from where nothing jumps upward in tenths, until the plane resists the hand."""
    from tuning.experiments import beginning
    from tuning.experiments.outcome import Outcome

    still = load_station(shipped_config("stations/paper_2009.toml")).adjusted(slowdown=1376.0, slowdown_reason="test")
    medium, slow = beginning.Slide(80000, "medium", 55.0), beginning.Slide(80000, "slow", 20.0)
    asked: list[tuple[float, bool]] = []
    judged = beginning.dragged

    def watched(config: LodConfig, surface: Any, motion: Motion, station: Station, tool: Any) -> bool:
        asked.append((station.slowdown / 1376.0, judged(config, surface, motion, station, tool)))
        return asked[-1][1]

    monkeypatch.setattr(beginning, "dragged", watched)
    out = Outcome()
    beginning.draw_beginning(out, medium, slow, still, without_short_way(point()), 3.0)
    factors, found = zip(*asked, strict=True)
    assert list(factors) == pytest.approx(1.0 + 0.1 * np.arange(len(factors)))
    assert len(found) >= 2 and list(found) == [False] * (len(found) - 1) + [True]
    jumps, stays = out.rows
    assert jumps["slower"] == stays["slower"] == pytest.approx(factors[-1])
    assert max(jumps["old_force_range_n"][:2]) > 1.0 and max(stays["old_force_range_n"]) < 0.01
    assert list(out.figures) == ["plane-80000-medium-slower"]
    assert f"{factors[-1]:g} times slower" in out.figures["plane-80000-medium-slower"].get_suptitle()
    monkeypatch.setattr(beginning, "MOST", 1.0)
    none = Outcome()
    beginning.draw_beginning(none, medium, slow, still, without_short_way(point()), 3.0)
    assert none.rows == [] and none.figures == {}


def test_the_command_draws_figures_and_writes_their_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["experiment", "sphere", "--seconds", "1", "--slowdown", "500"]
    assert tuning.cli.run([*words, "-o", str(tmp_path / "once")]) == 0
    assert "level 2 alone" in capsys.readouterr().out
    found = sorted(path.name for path in (tmp_path / "once").iterdir())
    assert "sphere-lod-paper.svg" in found and "sphere.json" in found and len(found) == 9
    told = json.loads((tmp_path / "once" / "sphere.json").read_text())
    assert told["assumed"]["slowdown"] == 500.0 and told["runs"][0]["run"] == "level 0 alone"
    rows = {row["run"]: row for row in told["runs"]}
    assert rows["level 0 alone"]["felt_error_jnd"] == 0.0
    assert rows["ours"]["switches_per_s"] < rows["the paper's rule"]["switches_per_s"]
    picture = (tmp_path / "once" / "sphere-level0.svg").read_text()
    assert picture.lstrip().startswith("<?xml") and "force (N)" in picture and "time (s)" in picture


def test_the_same_figure_gives_the_same_bytes() -> None:
    at = np.arange(4000) / 1000.0
    force = np.column_stack([np.sin(at), np.cos(at), at])
    drawn = [
        svg_of(forces_over_time(at, force, 100.0 * at, 1.0 + at, title="chatter", level=np.arange(4000) % 3))
        for _ in range(2)
    ]
    assert drawn[0] == drawn[1] and "chatter" in drawn[0]
    assert len(drawn[0]) < 300_000


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["cube", "-o", "x"], "cube"),
        (["plane", "-o", "x", "--seconds", "0.2"], "--seconds"),
        (["plane", "-o", "x", "--scan", "jaw.stl"], "goes with dentition"),
        (["plane", "-o", "x", "--slowdown", "-3"], "--slowdown"),
        (["plane", "-o", "file.txt"], "is not a folder"),
        (["plane", "-o", "nowhere/x"], "does not exist"),
        (["dentition", "-o", "x", "--scan", "absent.stl"], "absent.stl"),
    ],
)
def test_bad_input(
    words: list[str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file.txt").touch()
    assert tuning.cli.run(["experiment", *words]) == 2
    shown = capsys.readouterr()
    assert expected in shown.err and len(shown.err.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"file.txt"}
