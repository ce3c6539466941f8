"""hapticlod-station as a user meets it: run, replay, inspect, and what it says about bad input.

No latency and no deadline is asserted: on a busy machine wake-ups are late by milliseconds. What must be repeatable is
run in simulated time.
"""

import csv
import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plate_bundle import plate_motion, plate_parts, rendered, run_station, station_program

import tuning.cli
from hapticlod.bundle import write_bundle
from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import load_motion, save_motion
from hapticlod.motion.recording_mcap import recorded_ticks

AXES = "xyz"


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    return plate_parts()


@pytest.fixture(scope="module")
def bundle_path(parts: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bundle") / "plate.hlod"
    write_bundle(path, **parts)
    return path


def last_line(output: str) -> dict[str, Any]:
    return json.loads(output.splitlines()[-1])


def read_record(path: Path) -> np.ndarray:
    """A record CSV as rows of RECORD_DTYPE: shortest round-trip digits give the same bits."""
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    rows = np.zeros(len(lines), dtype=RECORD_DTYPE)
    for name, unit in (("hip", "_mm"), ("scp", "_mm"), ("force", "_n"), ("torque", "_n_mm")):
        rows[name + unit] = [[float(line[f"{name}_{axis}{unit}"]) for axis in AXES] for line in lines]
    for name in RECORD_DTYPE.names or ():
        if name in lines[0]:
            kind = float if RECORD_DTYPE[name].kind == "f" else int
            rows[name] = [kind(line[name]) for line in lines]
    return rows


def without_cost(rows: np.ndarray) -> bytes:
    same = rows.copy()
    same["cost_ns"] = 0
    return same.tobytes()


def test_replay_equals_python_bit_for_bit(parts: dict[str, Any], bundle_path: Path, tmp_path: Path) -> None:
    save_motion(tmp_path / "motion.csv", plate_motion(1200))
    motion = load_motion(tmp_path / "motion.csv", 1000.0)[0]
    result = run_station("replay", bundle_path, tmp_path / "motion.csv", tmp_path / "record.csv")
    assert result.returncode == 0, result.stderr
    assert "1200 ticks" in result.stdout
    station = read_record(tmp_path / "record.csv")
    python = rendered(parts["levels"], parts["config"], parts["tool"], motion)
    assert without_cost(station) == without_cost(python)
    assert station["contact"].sum() > 500
    assert station["cost_ns"].min() > 0
    assert {0, 1} == set(station["level"])


def test_replay_of_the_golden_motion_is_the_golden_record(
    parts: dict[str, Any], bundle_path: Path, tmp_path: Path
) -> None:
    motion = parts["golden_motion"]
    with (tmp_path / "golden.csv").open("w") as file:
        file.write("t_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n")
        for row in np.column_stack([motion.time_s, motion.position_mm, motion.orientation]).tolist():
            file.write(",".join(map(repr, row)) + "\n")
    assert run_station("replay", bundle_path, tmp_path / "golden.csv", tmp_path / "out.csv").returncode == 0
    assert without_cost(read_record(tmp_path / "out.csv")) == without_cost(parts["golden_record"])


def test_replay_resamples_and_says_so(bundle_path: Path, tmp_path: Path) -> None:
    t = np.arange(50) / 100.0
    rows = "\n".join(f"{a},{np.sin(a)},0.5,{20.2 - a}" for a in t)
    (tmp_path / "slow.csv").write_text("t_s,x_mm,y_mm,z_mm\n" + rows + "\n")
    result = run_station("replay", bundle_path, tmp_path / "slow.csv", tmp_path / "out.csv")
    assert result.returncode == 0
    assert "slow.csv: resampled to the bundle's 1000 Hz" in result.stderr
    record = read_record(tmp_path / "out.csv")
    assert len(record) == 491
    assert np.abs(record["hip_mm"][:, 0] - np.sin(record["time_s"])).max() < 1e-4


def test_recordings_are_converted_before_they_are_replayed(bundle_path: Path, tmp_path: Path) -> None:
    recording, motion, out = tmp_path / "run.mcap", tmp_path / "motion.csv", tmp_path / "out.csv"
    words = ("run", bundle_path, "--device", "sim", "--seconds", "0.2", "--virtual-time")
    assert run_station(*words, "--record", recording).returncode == 0
    for refused in (("replay", bundle_path, recording, out), (*words, "--motion", recording)):
        result = run_station(*refused)
        assert result.returncode == 2 and result.stdout == ""
        assert "run.mcap: is a recording (MCAP), not a motion CSV; convert it: " in result.stderr
        assert len(result.stderr.splitlines()) == 1
    remedy = result.stderr.split("convert it: hapticlod ")[1].split()
    assert remedy == ["recording", str(recording), "--motion", "--out", "motion.csv"]
    assert tuning.cli.run([*remedy[:-1], str(motion)]) == 0
    assert run_station("replay", bundle_path, motion, out).returncode == 0
    hand = np.array([list(tick["position_mm"].values()) for tick in recorded_ticks(recording)])
    assert len(hand) == 200
    assert np.array_equal(read_record(out)["hip_mm"], hand)


def test_run_in_simulated_time(bundle_path: Path) -> None:
    words = ("run", bundle_path, "--device", "sim", "--seconds", "3", "--virtual-time")
    result = run_station(*words)
    assert result.returncode == 0, result.stderr
    assert "loop cost" in result.stdout
    said = last_line(result.stdout)
    assert said["ticks"] == 3000
    assert said["seconds"] == pytest.approx(3.0, abs=2e-3)
    assert said["fault"] == "none" and said["state"] == "RUN" and said["stopped_by"] == "time"
    assert said["loop_cost_p50_us"] <= said["loop_cost_p99_us"] <= said["loop_cost_max_us"]
    assert said["loop_cost_p50_us"] > 0
    fine, coarse = said["levels"]
    assert fine["ticks"] + coarse["ticks"] == 3000
    assert coarse["ticks"] > 50
    assert coarse["mean_speed_mm_s"] > fine["mean_speed_mm_s"]  # levels follow speed
    assert said["switches"] >= 2
    assert said["mapping_miss"] == 0
    assert 0.2 < said["contact_share"] < 1
    assert 0.05 < said["max_force_n"] <= 4.0
    # The same again, apart from what a clock measured: simulated time is repeatable.
    again = last_line(run_station(*words, "--json").stdout)
    for measured in [key for key in said if key.startswith("loop_cost_")]:
        del said[measured], again[measured]
    assert again == said


def test_run_in_real_time(bundle_path: Path) -> None:
    result = run_station("run", bundle_path, "--device", "sim", "--seconds", "1.5", "--json")
    assert len(result.stdout.splitlines()) == 1
    said = last_line(result.stdout)
    # A machine that starves the loop for 20 ticks in a row ends it, and says so: also right.
    assert result.returncode == (0 if said["fault"] == "none" else 1)
    assert said["fault"] in ("none", "overruns")
    if said["fault"] == "none":
        assert said["ticks"] + said["skipped_ticks"] == 1500
        assert said["seconds"] == pytest.approx(1.5, abs=0.1)
    assert said["wake_up_max_us"] > 0
    for right, phrase in ((said["fifo"], "SCHED_FIFO"), (said["memory_locked"], "memory is not locked")):
        assert right or phrase in result.stderr  # what could not be had is said, once
        assert result.stderr.count(phrase) <= 1


def test_run_follows_a_given_motion(bundle_path: Path, tmp_path: Path) -> None:
    rows = "\n".join(f"{t},0,0,{30 + t}" for t in (0, 0.5, 1, 1.5))  # far above the plate
    (tmp_path / "air.csv").write_text("t_s,x_mm,y_mm,z_mm\n" + rows)
    words = ("--device", "sim", "--seconds", "1", "--motion", tmp_path / "air.csv", "--virtual-time", "--json")
    said = last_line(run_station("run", bundle_path, *words).stdout)
    assert said["contact_share"] == 0
    assert said["max_force_n"] == 0
    # 1 mm/s, eased in over 0.2 s: 0.9 mm in the first second, less what the device's friction (0.05 N) stretches the
    # hand's spring (0.5 N/mm)
    assert said["levels"][0]["mean_speed_mm_s"] == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_in_order(bundle_path: Path, number: int) -> None:
    command = [str(station_program()), "run", str(bundle_path), "--device", "sim"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        time.sleep(0.5)
        process.send_signal(number)
        output, _ = process.communicate(timeout=10)
    said = last_line(output)
    if said["fault"] == "none":  # else the machine starved it before the signal came
        assert process.returncode == 0
        assert said["stopped_by"] == "signal"
    assert said["ticks"] > 0


def test_stiffness_is_capped_for_the_device(parts: dict[str, Any], tmp_path: Path) -> None:
    config = parts["config"].copy()
    config["stiffness_n_mm"] = 5.0
    write_bundle(tmp_path / "stiff.hlod", **{**parts, "config": config})
    result = run_station("run", tmp_path / "stiff.hlod", "--device", "sim", "--seconds", "1", "--virtual-time")
    assert result.returncode == 0
    said = last_line(result.stdout)
    assert said["bundle_stiffness_n_mm"] == 5.0
    assert said["stiffness_limit_n_mm"] == pytest.approx(0.005 / 0.0015)  # b / (T/2 + one period of delay)
    assert said["stiffness_n_mm"] == pytest.approx(0.5 * said["stiffness_limit_n_mm"])
    assert "stiffness 5 N/mm is rendered as 1.67 N/mm" in result.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "BUNDLE"], "--device: is missing; give sim, a profile's name, or a profile's TOML file"),
        (["run", "BUNDLE", "--device", "falcon"], "--device: 'falcon' is not known; give one of sim, native"),
        (["run", "BUNDLE", "--device", "sim", "--seconds", "-1"], "--seconds: is '-1'; give a number"),
        (["run", "BUNDLE", "--device", "sim", "--seconds", "soon"], "--seconds: is 'soon'; give a number"),
        (["run", "BUNDLE", "--device", "sim", "--motion", "no.csv"], "no.csv: cannot be opened"),
        (["run", "BUNDLE", "--device", "sim", "--virtual-time"], "--virtual-time: would never end"),
        (["run", "BUNDLE", "--devize", "sim"], "--devize: is no option"),
        (["run"], "BUNDLE: is missing"),
        (["run", "no.hlod", "--device", "sim"], "no.hlod: cannot be opened"),
        (["replay", "BUNDLE", "no.csv", "out.csv"], "no.csv: cannot be opened"),
        (["replay", "BUNDLE", "BUNDLE", "out.csv"], "plate.hlod"),
        (["inspect", "no.hlod"], "no.hlod: cannot be opened"),
        (["inspect", "."], ".: is not a regular file"),
        (["tune"], "tune: is no command; see hapticlod-station --help"),
    ],
)
def test_bad_input_is_one_line_and_status_2(bundle_path: Path, words: list[str], expected: str) -> None:
    result = run_station(*(str(bundle_path) if word == "BUNDLE" else word for word in words))
    assert result.returncode == 2
    assert expected in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "motion.csv: is empty"),
        ("0,1,2,3\n0.1,1,2,3\n", "motion.csv:1: has no header"),
        ("t_s,x_mm,y_mm,z_mm\n0,1,2,3\n0.001,nan,2,3\n", "motion.csv:3: x_mm is not finite ('nan')"),
        ("t_s,x_mm,y_mm,z_mm\n0,1,2,3\n0.001,1;2,2,3\n", "motion.csv:3: x_mm is not a number ('1;2')"),
        ("t_s,x_mm,y_mm,z_mm\n0,1,2,3\n0,1,2,3\n", "motion.csv:3: t_s does not increase"),
        ("seg,t_s,x_mm,y_mm,z_mm\n0,0,1,2,3\n0,1,1,2,3\n1,2,1,2,3\n", "motion.csv:4: a second segment begins"),
    ],
)
def test_bad_motions_leave_no_output(bundle_path: Path, tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "motion.csv").write_text(content)
    result = run_station("replay", bundle_path, tmp_path / "motion.csv", tmp_path / "out.csv")
    assert result.returncode == 2
    assert expected in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["motion.csv"]


def test_output_that_cannot_be_written_is_named(bundle_path: Path, tmp_path: Path) -> None:
    save_motion(tmp_path / "motion.csv", plate_motion(20))
    result = run_station("replay", bundle_path, tmp_path / "motion.csv", tmp_path / "no" / "out.csv")
    assert result.returncode == 2
    assert "out.csv: cannot be written" in result.stderr


def test_help_and_version() -> None:
    help_text = run_station("--help")
    assert help_text.returncode == 0
    assert "replay BUNDLE MOTION.csv OUT.csv" in help_text.stdout
    assert run_station("--version").stdout.startswith("hapticlod-station ")
    assert run_station().returncode == 2
