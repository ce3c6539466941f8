"""`hapticlod devices` and `hapticlod-station devices` through the real hidapi, behind the shim."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plate_bundle import station_program
from virtual_hid import VirtualDevice, patient_profile, shim_environment

import tuning.cli
from hapticlod.motion import load_motion


def both(folder: Path, *words: object) -> dict[str, subprocess.CompletedProcess[str]]:
    commands = {"python": [sys.executable, "-m", "tuning.cli"], "station": [str(station_program())]}
    return {
        name: subprocess.run(
            [*command, "devices", *map(str, words)], env=shim_environment(folder), capture_output=True, text=True,
            timeout=60, check=False, cwd=Path(__file__).resolve().parent.parent,
        )
        for name, command in commands.items()
    }  # fmt: skip


def test_nothing_is_there(tmp_path: Path) -> None:
    for result in both(tmp_path).values():
        assert result.returncode == 0, result.stderr
        assert "no HID device is there" in result.stdout


def test_both_list_the_same_devices(tmp_path: Path) -> None:
    with VirtualDevice(tmp_path), VirtualDevice(tmp_path, "hidraw4", "Ω-7") as other:
        (other.place / "ids").write_text("3 046d c626 0")
        (other.place / "product").write_text("SpaceNavigator")
        results = both(tmp_path, "--json")
        plain = both(tmp_path)
    rows = {name: json.loads(result.stdout) for name, result in results.items()}
    for row in (*rows["python"], *rows["station"]):
        row["profiles"] = [Path(path).name for path in row["profiles"]]
    assert rows["python"] == rows["station"]
    first, second = rows["python"]
    assert first["path"] == "/dev/hidraw0" and first["serial"] == "SIM1"
    assert (first["vendor_id"], first["usage_page"], first["usage"]) == (0x1209, 0xFF00, 1)
    assert first["profiles"] == ["native.toml"]
    assert second["serial"] == "Ω-7" and second["profiles"] == ["spacenavigator.toml"]
    for result in plain.values():
        assert "/dev/hidraw0  1209:0001  usage ff00/0001" in result.stdout


def test_a_hand_is_recorded_without_forces(tmp_path: Path) -> None:
    with VirtualDevice(tmp_path) as device:
        device.position_mm = (1.0, 2.0, 3.5)
        command = [sys.executable, "-m", "tuning.cli", "devices", "--profile", str(patient_profile(tmp_path))]
        result = subprocess.run(
            [*command, "--record", str(tmp_path / "hand.csv"), "--seconds", "0.3", "--watch"], check=False, text=True,
            env=shim_environment(tmp_path), capture_output=True, timeout=60,
            cwd=Path(__file__).resolve().parent.parent,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        assert "reports/s" in result.stdout
        assert device.good_forces == device.bad_forces == 0
    (motion,) = load_motion(tmp_path / "hand.csv", 1000.0)
    assert np.allclose(motion.position_mm, [1.0, 2.0, 3.5])
    assert 0.2 < motion.time_s[-1] < 30.0


def test_a_recording_that_could_not_be_kept_is_refused_before_the_hand_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, expected in (
        (["--seconds", "0"], "--seconds: is 0; give a length above 0"),
        (["--seconds", "-3"], "--seconds: is -3; give a length above 0"),
        (["--seconds", "nan"], "--seconds: is nan; give a length above 0"),
    ):
        assert tuning.cli.run(["devices", "--record", str(tmp_path / "hand.csv"), *words]) == 2
        assert expected in capsys.readouterr().err
    with VirtualDevice(tmp_path):
        command = [sys.executable, "-m", "tuning.cli", "devices", "--profile", str(patient_profile(tmp_path))]
        result = subprocess.run(
            [*command, "--record", str(tmp_path / "no" / "hand.csv"), "--seconds", "1000"], check=False, text=True,
            env=shim_environment(tmp_path), capture_output=True, timeout=60,
            cwd=Path(__file__).resolve().parent.parent,
        )  # fmt: skip
    assert result.returncode == 2
    assert "hand.csv: lies in a folder that is not there" in result.stderr


def test_watching_ends_with_ctrl_c(tmp_path: Path) -> None:
    with VirtualDevice(tmp_path) as device:
        device.position_mm = (1.0, 2.0, 3.5)
        command = [sys.executable, "-m", "tuning.cli", "devices", "--profile", str(patient_profile(tmp_path))]
        # A background job of a shell ignores Ctrl-C, and so would its children.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            watching = subprocess.Popen(
                [*command, "--watch"], env=shim_environment(tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                cwd=Path(__file__).resolve().parent.parent,
            )  # fmt: skip
        finally:
            signal.signal(signal.SIGINT, before)
        assert watching.stdout is not None
        seen = os.read(watching.stdout.fileno(), 65536)
        watching.send_signal(signal.SIGINT)
        rest, err = watching.communicate(timeout=60)
    assert (watching.returncode, err) == (0, b"")
    assert b"1.000     2.000     3.500 mm" in seen and rest.endswith(b"\n")


@pytest.mark.parametrize(("errno", "expected"), [("13", "cannot be opened; install the udev rule"), ("", "went away")])
def test_device_that_cannot_be_read(tmp_path: Path, errno: str, expected: str) -> None:
    with VirtualDevice(tmp_path) as device:
        if errno:
            (device.place / "errno").write_text(errno)
        command = [
            sys.executable,
            "-m",
            "tuning.cli",
            "devices",
            "--profile",
            str(patient_profile(tmp_path)),
            "--watch",
        ]
        process = subprocess.Popen(
            command, env=shim_environment(tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            cwd=Path(__file__).resolve().parent.parent,
        )  # fmt: skip
        if errno:
            process.wait(timeout=60)
        else:
            assert process.stdout is not None
            process.stdout.read(1)  # it watches
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert expected in err and len(err.splitlines()) == 1
