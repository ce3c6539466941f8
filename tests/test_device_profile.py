"""Device profiles: Python and the station hold the same files to the same rules, and name the same places."""

import re
from pathlib import Path

import numpy as np
import pytest
from plate_bundle import run_station
from virtual_hid import REPORT

from hapticlod.device_list import shipped_profiles
from hapticlod.device_profile import SerialPantograph, load_device_profile
from hapticlod.errors import InputError
from hapticlod.shipped import shipped_config

NATIVE = shipped_config("devices/native.toml").read_text()
WOODEN = shipped_config("devices/woodenhaptics_8.toml").read_text()
SPACE = shipped_config("devices/spacenavigator.toml").read_text()

TURNING = NATIVE.replace("echo_seq = {", 'orientation = { offset = 40, type = "f32", count = 4 }\necho_seq = {')

# What is changed, and the field that both must name.
WRONG = [
    (NATIVE, 'type = "u32" }   ', 'type = "u64" }   ', "input.0.fields.seq.type"),
    (NATIVE, "offset = 8,", "offset = 6,", "input.0.fields.pos_mm"),  # overlaps t_us
    (NATIVE, "offset = 62,", "offset = 63,", "output.fields.crc16"),  # ends at byte 65 of 64
    (NATIVE, "count = 3 }", "count = 2 }", "input.0.fields.pos_mm"),
    (NATIVE, "offset = 0,", "offset = -1,", "input.0.fields.seq.offset"),
    (NATIVE, "bytes = 64", "bytes = 0", "input.0.bytes"),
    (NATIVE, "bytes = 64", "byte = 64", "input.0.byte"),
    (NATIVE, "vendor_id = 0x1209", "vendor_id = 0x11209", "device.match.vendor_id"),
    (NATIVE, "vendor_id = 0x1209", 'vendor_id = "0x1209"', "device.match.vendor_id"),
    (NATIVE, "product_id = 0x0001\n", "", "device.match.product_id"),
    (NATIVE, 'kind = "cartesian"', 'kind = "polar"', "kinematics.kind"),
    (NATIVE, "[1, 0, 0], [0, 1, 0]", "[1, 0, 0], [1, 1, 0]", "kinematics.axes"),
    (TURNING, "[1, 0, 0], [0, 1, 0]", "[-1, 0, 0], [0, 1, 0]", "kinematics"),
    (NATIVE, "max_force_n = 5.0\n", "", "limits.max_force_n"),
    (NATIVE, "max_force_n = 5.0", "max_force_n = nan", "limits.max_force_n"),
    (NATIVE, "damping_n_s_mm = 0.002", "", "limits.damping_n_s_mm"),
    (NATIVE, "watchdog_ms = 20.0", "", "timing.watchdog_ms"),
    (NATIVE, "rate_hz = 1000.0", "rate_hz = 0", "timing.rate_hz"),
    (NATIVE, "estop = 2", "estop = 32", "status_bits.estop"),
    (NATIVE, "estop = 2", "stop = 2", "status_bits.stop"),
    (NATIVE, 'pos_mm = { offset = 8, type = "f32", count = 3 }\n', "", "input"),
    (NATIVE, "schema = 1", "schema = 2", "schema"),
    (WOODEN, "sign = [1, 1, 1]", "sign = [1, 0.5, 1]", "kinematics.sign"),
    (WOODEN, "links_mm = [80.0, 205.0, 245.0]", "links_mm = [80.0, 205.0]", "kinematics.links_mm"),
    (WOODEN, "max_current_ma = 2000.0\n", "", "kinematics.max_current_ma"),
    (SPACE, "report_id = 3", "report_id = 1", "input"),
    (SPACE, "scale = 0.002857", "scale = 0.0", "input.0.fields.deflection.scale"),
]  # fmt: skip


def test_shipped_profiles_are_read_by_both() -> None:
    profiles = shipped_profiles()
    assert len(profiles) >= 5
    for path, _ in profiles:
        result = run_station("devices", "--profile", path)
        assert result.returncode == 0, result.stderr
        assert f"{path}: no fault in this profile (" in result.stdout


@pytest.mark.parametrize(("text", "old", "new", "field"), WRONG, ids=[case[3] + "=" + case[2][:12] for case in WRONG])
def test_wrong_profiles_are_refused_at_the_same_place(
    tmp_path: Path, text: str, old: str, new: str, field: str
) -> None:
    assert old in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as python:
        load_device_profile(path)
    station = run_station("devices", "--profile", path)
    assert station.returncode == 2
    assert len(station.stderr.splitlines()) == 1
    for line in (str(python.value), station.stderr):
        found = re.match(rf"{re.escape(str(path))}:(\d+):\d+: ([\w.]+): ", line)
        assert found is not None, line
        assert found[2].startswith(field) or field.startswith(found[2]), line
    places = [re.match(rf"{re.escape(str(path))}:(\d+):", line)[1] for line in (str(python.value), station.stderr)]  # type: ignore[index]
    missing = " missing" in station.stderr or new == ""
    assert missing or places[0] == places[1]  # what is not there has no line of its own


def test_syntax_error_names_its_line(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text("schema = 1\n[device\n")
    with pytest.raises(InputError, match=r"x\.toml:2:"):
        load_device_profile(tmp_path / "x.toml")
    assert "x.toml:2:" in run_station("devices", "--profile", tmp_path / "x.toml").stderr
    assert "cannot be read" in run_station("devices", "--profile", tmp_path / "none.toml").stderr


def test_native_report_is_read_as_it_was_packed() -> None:
    profile = load_device_profile(shipped_config("devices/native.toml"))
    report = REPORT.pack(7, 123456, 1.5, -2.0, 3.25, 0, 0, 0, 0x0102, 16, 6)
    assert profile.position_mm(report) == pytest.approx([1.5, -2.0, 3.25])
    assert profile.position_mm(report[:-1]) is None
    (layout,) = profile.input
    assert layout.values(report, "t_us") == [123456] and layout.values(report, "buttons") == [0x0102]


def test_pantograph_agrees_with_its_geometry() -> None:
    """Elbow by elbow: the body turns by a, the first link points b from the vertical, the second hangs by c."""
    profile = load_device_profile(shipped_config("devices/woodenhaptics_8.toml"))
    form = profile.kinematics
    assert isinstance(form, SerialPantograph)
    counts = np.array([150.0, 2100.0, 1200.0])
    turn = 2 * np.pi * (counts + form.home_counts) / 2000 * form.reduction
    radial = np.array([np.cos(turn[0]), np.sin(turn[0]), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    elbow = 80 * up + 205 * (np.cos(turn[1]) * up + np.sin(turn[1]) * radial)
    tip = elbow + 245 * (np.sin(turn[2]) * radial - np.cos(turn[2]) * up)
    assert form.position_mm(counts) == pytest.approx(tip - [220, 0, 80])
