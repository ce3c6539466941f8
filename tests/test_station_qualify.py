"""`hapticlod-station qualify`, `doctor` and `calibrate`: what they say, and what their files hold."""

import hashlib
import json
import platform
from pathlib import Path
from typing import Any

import pytest
from plate_bundle import plate_parts, run_station

from hapticlod import load_station
from hapticlod.bundle import write_bundle


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    made = plate_parts(300)
    made["config"] = made["config"].copy()
    made["config"]["budget_us"] = 1000.0
    return made


def write(path: Path, parts: dict[str, Any], **changes: float) -> Path:
    config = parts["config"].copy()
    for name, value in changes.items():
        config[name] = value
    write_bundle(path, **{**parts, "config": config})
    return path


def test_what_was_tuned_elsewhere_qualifies_here(parts: dict[str, Any], tmp_path: Path) -> None:
    bundle = write(tmp_path / "plate.hlod", parts)
    result = run_station("qualify", bundle, "-o", tmp_path / "certificate.json")
    said = json.loads((tmp_path / "certificate.json").read_text())
    assert said["forces_equal"] and said["worst_force_difference_n"] == 0  # to the last bit
    assert said["ticks"] == 300 and said["budget_us"] == 1000.0
    # Which file, which program and which machine it is about.
    assert said["bundle_blake2b_256"] == hashlib.blake2b(bundle.read_bytes(), digest_size=32).hexdigest()
    assert said["host"] == platform.node() and said["kernel"].startswith(platform.release())
    assert said["program"] == run_station("--version").stdout.strip()
    assert 0 < said["cost_p50_us"] <= said["cost_p99_us"] <= said["cost_p999_us"] <= said["cost_max_us"]
    assert said["passed"] == said["in_time"] == (said["cost_p999_us"] <= 1000.0)  # a starved machine may fail: rightly
    assert result.returncode == (0 if said["passed"] else 1)
    assert "force difference, N" in result.stdout and ("passed" in result.stdout) == said["passed"]


def test_other_forces_do_not(parts: dict[str, Any], tmp_path: Path) -> None:
    bundle = write(tmp_path / "soft.hlod", parts, stiffness_n_mm=0.9)
    result = run_station("qualify", bundle, "--json")
    said = json.loads(result.stdout)
    assert result.returncode == 1
    assert not said["passed"] and not said["forces_equal"] and said["forces_off"] > 50
    assert said["worst_force_difference_n"] == pytest.approx(
        0.1 * abs(parts["golden_record"]["force_n"]).max(), rel=0.1
    )
    # Allowed that much, only the levels and contacts count.
    assert json.loads(run_station("qualify", bundle, "--json", "--tolerance-n", "1").stdout)["forces_off"] == 0


def test_too_slow_does_not(parts: dict[str, Any], tmp_path: Path) -> None:
    result = run_station("qualify", write(tmp_path / "tight.hlod", parts, budget_us=1e-3))
    assert result.returncode == 1
    assert "FAIL" in result.stdout.split("loop cost p99.9")[1]


def test_nothing_to_compare_with(parts: dict[str, Any], tmp_path: Path) -> None:
    bare = {k: v for k, v in parts.items() if not k.startswith("golden")}
    write_bundle(tmp_path / "bare.hlod", **bare, golden_motion=None, golden_record=None)
    result = run_station("qualify", tmp_path / "bare.hlod")
    assert result.returncode == 2
    assert "has no golden record" in result.stderr


def test_calibrated_station_is_a_station(tmp_path: Path) -> None:
    result = run_station("calibrate", "-o", tmp_path / "lab.toml", "--quick", "--name", 'the "lab"', "--rate", "2000")
    assert result.returncode == 0, result.stderr
    station = load_station(tmp_path / "lab.toml")
    assert station.name == 'the "lab"' and station.loop_hz == 2000.0 and station.budget_us == 300.0
    assert station.cost is not None and station.machine is not None
    assert station.cost.test_ns + station.cost.triangle_ns + station.cost.cell_ns > 0
    assert station.machine.wake_up_p50_us <= station.machine.wake_up_p999_us <= station.machine.wake_up_max_us
    assert result.stdout.count("of what was measured, p99.9 as") == 2


def test_calibrate_needs_a_place(tmp_path: Path) -> None:
    assert "--out: is missing" in run_station("calibrate").stderr
    result = run_station("calibrate", "-o", tmp_path / "no" / "lab.toml", "--quick")
    assert result.returncode == 2
    assert "lab.toml: cannot be written" in result.stderr.splitlines()[-1]


def test_doctor_speaks_both_ways() -> None:
    plain, said = run_station("doctor"), run_station("doctor", "--json")
    findings = json.loads(said.stdout)
    assert {"kernel", "real-time priority", "timer resolution"} <= {finding["what"] for finding in findings}
    assert all(finding["remedy"] for finding in findings if finding["health"] != "good")
    bad = any(finding["health"] == "bad" for finding in findings)
    assert plain.returncode == said.returncode == int(bad)
