"""The station with a device behind the real hidapi: what arrives there, what ends it, how it says no."""

import json
import os
import pty
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from plate_bundle import plate_parts, run_station, station_program
from virtual_hid import VirtualDevice, patient_profile, shim_environment

from hapticlod.bundle import write_bundle
from hapticlod.motion import load_motion

PRESS = (0.3, 0.0, -0.4)  # below the plate, whose middle is the device's origin


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 Hz: a late wake-up of milliseconds is no fault."""
    parts = plate_parts(400)
    parts["config"] = parts["config"].copy()
    parts["config"]["loop_hz"], parts["config"]["budget_us"] = 200.0, 4000.0
    parts["config"]["max_slew_n_s"] = 0.0
    path = tmp_path_factory.mktemp("bundle") / "slow.hlod"
    write_bundle(path, **parts)
    return path


@pytest.fixture
def device(tmp_path: Path) -> Iterator[VirtualDevice]:
    with VirtualDevice(tmp_path) as made:
        yield made


def started(
    folder: Path, bundle: Path, *words: object, ahead: tuple[str, ...] = (), **options: Any
) -> subprocess.Popen[str]:
    """A station; `ahead`: a program that becomes the station."""
    command = [str(station_program()), "run", str(bundle), "--device", str(patient_profile(folder)), "--json", *words]
    return subprocess.Popen(
        [*ahead, *(str(word) for word in command)], env=shim_environment(folder), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, **{"stdin": subprocess.DEVNULL, **options},
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    out, err = process.communicate(timeout=60)
    return process.returncode, json.loads(out.splitlines()[-1]) if out else {}, err


def pressed(device: VirtualDevice) -> None:
    """Brings the hand from the air into the plate, and waits until the motors push back."""
    device.wait("self.enabled")
    for z in np.arange(1.0, PRESS[2] - 1e-9, -0.2):
        device.position_mm = (*PRESS[:2], float(z))
        time.sleep(0.02)
    device.position_mm = PRESS
    device.wait("self.force_n[2] > 0.2")


def test_forces_reach_the_device_and_everything_is_recorded(
    bundle: Path, device: VirtualDevice, tmp_path: Path
) -> None:
    device.position_mm = (0.3, 0.0, 1.0)
    process = started(tmp_path, bundle, "--record", tmp_path / "run.mcap")
    pressed(device)
    status = run_station("status", "--json", "--pid", process.pid)
    process.send_signal(signal.SIGINT)
    code, said, err = ended(process)
    assert code == 0, err
    assert said["device"] == "native Cartesian device"
    assert said["stopped_by"] == "signal" and said["fault"] == "none"
    assert device.bad_forces == 0
    assert device.force_n == (0.0, 0.0, 0.0) and not device.enabled  # a run never ends with a force
    assert said["round_trip_p50_us"] > 0
    seen = json.loads(status.stdout)
    assert seen["pid"] == process.pid and seen["state"] in ("RUN", "DEGRADED")
    assert seen["force_n"] > 0.1
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        ticks = [json.loads(message.data) for _, _, message in reader.iter_messages()]
    assert summary.statistics.message_count == len(ticks) == said["ticks"] + said["ticks_without_report"]
    assert next(iter(summary.channels.values())).topic == "/station/tick"
    assert max(tick["force_n"]["z"] for tick in ticks) == pytest.approx(said["max_force_n"], abs=0.1)
    assert ticks[-1]["position_mm"]["z"] == pytest.approx(20.0 + PRESS[2], abs=1e-5)
    (motion,) = load_motion(tmp_path / "run.mcap", 200.0)
    assert motion.position_mm[-1] == pytest.approx([0.3, 0.0, 20.0 + PRESS[2]], abs=1e-5)


def test_watching_cannot_disturb_the_loop(bundle: Path, device: VirtualDevice, tmp_path: Path) -> None:
    """`status` maps the loop's memory read-only, so freezing or killing it in the middle is nothing to the loop."""
    process = started(tmp_path, bundle)
    device.wait("self.enabled")
    leader, follower = pty.openpty()
    words = [str(station_program()), "status", "--pid", str(process.pid)]
    watcher = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=follower)
    try:
        shown = b""
        while b"rate" not in shown:
            shown += os.read(leader, 65536)
        maps = Path(f"/proc/{watcher.pid}/maps").read_text().splitlines()
        shared = [line.split()[1] for line in maps if f"/dev/shm/hapticlod-station.{process.pid}" in line]
        assert shared and set(shared) == {"r--s"}
        watcher.send_signal(signal.SIGSTOP)
        device.wait(f"self.good_forces > {device.good_forces + 50}")
    finally:  # nobody reads what it writes: it would not end by itself
        watcher.kill()
        watcher.wait()
    os.close(leader)
    os.close(follower)
    device.wait(f"self.good_forces > {device.good_forces + 50}")
    process.terminate()
    code, said, err = ended(process)
    assert code == 0, err
    assert said["fault"] == "none"


def test_killed_station_is_let_go_by_the_firmware(bundle: Path, device: VirtualDevice, tmp_path: Path) -> None:
    device.position_mm = (0.3, 0.0, 1.0)
    process = started(tmp_path, bundle)
    pressed(device)
    process.kill()  # SIGKILL: nobody writes a zero
    process.communicate(timeout=30)
    device.wait("self.tripped == 1")
    assert device.force_n == (0.0, 0.0, 0.0) and not device.enabled
    # And the way back: a new station clears the watchdog and runs.
    device.position_mm = (0.3, 0.0, 1.0)
    again = started(tmp_path, bundle)
    device.wait("self.enabled")
    again.terminate()
    assert ended(again)[0] == 0


def test_emergency_stop_by_signal_leaves_a_flight_recording(
    bundle: Path, device: VirtualDevice, tmp_path: Path
) -> None:
    device.position_mm = (0.3, 0.0, 1.0)
    process = started(tmp_path, bundle)
    pressed(device)
    process.send_signal(signal.SIGUSR1)
    code, said, err = ended(process)
    assert code == 1
    assert (said["state"], said["fault"], said["stopped_by"]) == ("SAFE", "operator_stop", "fault")
    device.wait("self.force_n == (0.0, 0.0, 0.0)")
    flight = Path(said["flight_recording"])
    assert str(flight) in err and flight.parent == tmp_path / "hapticlod"
    with flight.open("rb") as stream:
        ticks = [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages()]
    assert [tick["state"] for tick in ticks[-2:]] in (["RUN", "SAFE"], ["DEGRADED", "SAFE"])
    assert ticks[-1]["fault"] == "operator_stop" and ticks[-1]["force_n"]["z"] == 0
    assert ticks[-2]["force_n"]["z"] > 0.2


def test_any_key_is_an_emergency_stop(bundle: Path, device: VirtualDevice, tmp_path: Path) -> None:
    leader, follower = pty.openpty()
    process = started(tmp_path, bundle, stdin=follower, ahead=("setsid", "--ctty"))  # the terminal is the station's own
    device.wait("self.enabled")
    os.write(leader, b" ")
    code, said, _ = ended(process)
    os.close(leader)
    os.close(follower)
    assert code == 1 and said["fault"] == "operator_stop"


def test_unplugged_in_contact_waits_and_is_armed_again_by_hand(bundle: Path, tmp_path: Path) -> None:
    with VirtualDevice(tmp_path) as first:
        first.position_mm = (0.3, 0.0, 1.0)
        process = started(tmp_path, bundle, "--reconnect", stdin=subprocess.PIPE)
        pressed(first)
    assert process.stderr is not None and process.stdin is not None
    lines = [process.stderr.readline()]
    while "waiting" not in lines[-1]:
        lines.append(process.stderr.readline())
        assert lines[-1], lines
    assert any("SAFE (unplugged)" in line for line in lines)
    with VirtualDevice(tmp_path, "hidraw5", "SIM2") as other, VirtualDevice(tmp_path, "hidraw3") as same:
        while "press Enter" not in process.stderr.readline():
            pass
        assert not same.enabled  # back, and nobody has said that it may move
        process.stdin.write("\n")
        process.stdin.flush()
        same.wait("self.enabled")
        process.terminate()
        code, said, err = ended(process)
        assert other.good_forces == 0  # another serial number is another device
    assert code == 0, err
    assert said["fault"] == "none"


def refused(folder: Path, bundle: Path, *words: object, profile: Path | None = None) -> str:
    """The one line with which the station does not start."""
    chosen = profile or patient_profile(folder)
    command = [str(station_program()), "run", str(bundle), "--device", str(chosen), *map(str, words)]
    result = subprocess.run(
        command, env=shim_environment(folder), capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 2, result.stderr
    assert result.stdout == "" and len(result.stderr.splitlines()) == 1
    return result.stderr


def test_no_device_two_devices_and_choosing(bundle: Path, tmp_path: Path) -> None:
    assert "no device 1209:0001 (native Cartesian device) is there; plug it in" in refused(tmp_path, bundle)
    with VirtualDevice(tmp_path), VirtualDevice(tmp_path, "hidraw1", "SIM2") as second:
        line = refused(tmp_path, bundle)
        assert "2 devices match (/dev/hidraw0 serial SIM1, /dev/hidraw1 serial SIM2); choose one with --serial" in line
        assert "with serial SIM9 is there" in refused(tmp_path, bundle, "--serial", "SIM9")
        process = started(tmp_path, bundle, "--serial", "SIM2")
        second.wait("self.enabled")
        assert "/dev/hidraw1: is in use by another hapticlod-station" in refused(
            tmp_path, bundle, "--path", "/dev/hidraw1"
        )
        process.terminate()
        assert ended(process)[0] == 0


def test_no_permission_says_what_to_do(bundle: Path, tmp_path: Path) -> None:
    with VirtualDevice(tmp_path) as device:
        (device.place / "errno").write_text("13")
        line = refused(tmp_path, bundle)
    assert line.startswith("/dev/hidraw0: may not be opened (permission denied); install the udev rule")


def test_device_of_another_report_is_not_run(bundle: Path, device: VirtualDevice, tmp_path: Path) -> None:
    text = patient_profile(tmp_path).read_text().replace("bytes = 64", "bytes = 63", 1)
    (tmp_path / "other.toml").write_text(text)
    command = [str(station_program()), "run", str(bundle), "--device", str(tmp_path / "other.toml"), "--json"]
    result = subprocess.run(
        command, env=shim_environment(tmp_path), capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 1
    assert json.loads(result.stdout)["fault"] == "wrong_report"
    assert not device.enabled


def test_without_a_watchdog_it_must_be_accepted(bundle: Path, tmp_path: Path) -> None:
    text = patient_profile(tmp_path).read_text().replace("watchdog_ms = 300.0", "watchdog_ms = 0.0")
    (tmp_path / "no_dog.toml").write_text(text)
    line = refused(tmp_path, bundle, profile=tmp_path / "no_dog.toml")
    assert "has no watchdog" in line and "--accept-no-watchdog" in line
    # Accepted, it gets as far as looking for the device.
    assert "no device" in refused(tmp_path, bundle, "--accept-no-watchdog", profile=tmp_path / "no_dog.toml")


def test_stiffness_the_device_cannot_hold_is_lowered(device: VirtualDevice, tmp_path: Path) -> None:
    parts = plate_parts(400)
    parts["config"] = parts["config"].copy()
    parts["config"]["stiffness_n_mm"], parts["config"]["loop_hz"] = 50.0, 200.0
    write_bundle(tmp_path / "stiff.hlod", **parts)
    process = started(tmp_path, tmp_path / "stiff.hlod")
    device.wait("self.enabled")
    process.terminate()
    code, said, err = ended(process)
    assert code == 0, err
    limit = 0.02 / (0.5 / 200 + 1e-3)  # b / (T/2 + t_d)
    assert said["stiffness_limit_n_mm"] == pytest.approx(limit)
    assert said["stiffness_n_mm"] == pytest.approx(limit / 2)
    assert "is rendered as" in err


def test_damaged_bundle_is_refused(bundle: Path, device: VirtualDevice, tmp_path: Path) -> None:
    content = bytearray(bundle.read_bytes())
    content[-300] ^= 1
    (tmp_path / "damaged.hlod").write_bytes(content)
    assert "damaged.hlod" in refused(tmp_path, tmp_path / "damaged.hlod")
    assert device.good_forces == 0
