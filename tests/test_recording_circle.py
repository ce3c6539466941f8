"""A station records a hand, and the tuner tunes for that very hand: what is recorded is what was felt."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from plate_bundle import plate_parts, rendered, run_station

import tuning.cli
from benchmarks.bench_station import make_bundle
from hapticlod.bundle import read_bundle, write_bundle
from hapticlod.motion import load_motion
from hapticlod.motion.recording_mcap import recorded_ticks

TOOL = Path(__file__).resolve().parent.parent / "configs" / "tools" / "ball_1mm.toml"


def recorded(bundle: Path, recording: Path, seconds: float) -> None:
    words = ("run", bundle, "--device", "sim", "--seconds", seconds, "--virtual-time", "--record", recording)
    result = run_station(*words, "--accept-unsigned")
    assert result.returncode == 0, result.stderr


def test_replaying_a_recording_gives_the_forces_that_were_felt(tmp_path: Path) -> None:
    parts = plate_parts()
    write_bundle(tmp_path / "plate.hlod", **parts)
    recorded(tmp_path / "plate.hlod", tmp_path / "run.mcap", 2.0)
    ticks = list(recorded_ticks(tmp_path / "run.mcap"))
    (motion,) = load_motion(tmp_path / "run.mcap", 1000.0)
    assert motion.ticks == len(ticks) == 2000
    again = rendered(parts["levels"], parts["config"], parts["tool"], motion)
    felt_n = np.array([list(tick["force_n"].values()) for tick in ticks])
    running = np.array([tick["state"] == "RUN" for tick in ticks])
    assert np.flatnonzero(running)[0] == 9  # ten good readings
    assert np.linalg.norm(felt_n, axis=1).max() > 0.1
    assert again["force_n"][running] == pytest.approx(felt_n[running], abs=1e-5)  # recorded as float32
    assert [tick["level"] for tick in ticks] == again["level"].tolist()


@pytest.mark.skipif("HAPTICLOD_WHOLE" not in os.environ, reason="a whole tuning, a minute: make test-circle")
def test_a_bundle_is_tuned_from_what_its_station_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import trimesh

    from hapticlod.dentition import make_dentition

    monkeypatch.setenv("HAPTICLOD_CACHE", str(tmp_path / "cache"))
    scan = make_dentition(3000, 0)
    trimesh.Trimesh(scan.vertices, scan.faces, process=False).export(tmp_path / "jaw.stl")
    make_bundle(tmp_path / "first.hlod", 1000.0, triangles=3000)
    recorded(tmp_path / "first.hlod", tmp_path / "run.mcap", 4.0)
    words = ["tune", "jaw.stl", "--unit", "mm", "-o", "again.hlod", "--json", "again.json", "--levels", "1"]
    monkeypatch.chdir(tmp_path)
    status = tuning.cli.run([*words, "--tool", str(TOOL), "--budget-us", "500", "--motions", "run.mcap"])
    assert status == 0, capsys.readouterr().err
    told = json.loads((tmp_path / "again.json").read_text())
    assert told["feasible"] and told["measured"]["loop_cost_p999_us"] <= 500.0
    # The golden motion is the recorded hand: its second part, which was kept apart, from about the middle on.
    held = read_bundle(tmp_path / "again.hlod")
    (hand,) = load_motion(tmp_path / "run.mcap", 1000.0)
    golden = held.golden_motion
    assert golden is not None and golden.provenance["file"] == "run.mcap"
    begins = np.flatnonzero((hand.position_mm == golden.position_mm[0]).all(1))  # several: the hand may rest
    second = [k for k in begins if np.array_equal(hand.position_mm[k : k + golden.ticks], golden.position_mm)]
    assert second and second[-1] >= 0.3 * hand.ticks - 1
    # And the new bundle runs.
    result = run_station("run", "again.hlod", "--device", "sim", "--seconds", "2", "--virtual-time", "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["contact_share"] > 0.2
