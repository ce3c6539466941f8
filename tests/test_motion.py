"""Recorded motions: resampling, and every fault with its file and line."""

import json
from pathlib import Path

import numpy as np
import pytest

from hapticlod.errors import InputError
from hapticlod.motion import Motion, load_motion

HEADER = "t_s,x_mm,y_mm,z_mm\n"


def written(folder: Path, text: str) -> Path:
    (folder / "m.csv").write_text(text)
    return folder / "m.csv"


def test_recording_is_resampled_without_overshoot(tmp_path: Path) -> None:
    at_s = np.array([0.0, 0.02, 0.05, 0.06, 0.11])
    step = np.array([0.0, 0.0, 1.0, 1.0, 1.0])
    rows = "".join(f"{t + 7.5},{x},{-x},{2 * x}\n" for t, x in zip(at_s, step, strict=True))
    (motion,) = load_motion(written(tmp_path, "# a comment\n" + HEADER + rows), 1000.0)
    assert motion.ticks == 111 and motion.seconds == pytest.approx(0.111)
    np.testing.assert_allclose(motion.time_s, np.arange(111) / 1000.0, atol=1e-12)
    assert motion.position_mm[:, 0].min() >= -1e-12 and motion.position_mm[:, 0].max() <= 1 + 1e-12
    np.testing.assert_allclose(motion.position_mm[[0, 20, 50, 60, 110], 0], step, atol=1e-9)
    np.testing.assert_allclose(motion.position_mm, motion.position_mm[:, :1] * [1, -1, 2], atol=1e-9)
    assert motion.provenance["source_hz"] == pytest.approx(1 / 0.025)
    assert motion.provenance["comments"] == ["a comment"] and not motion.provenance["planar"]
    json.dumps(motion.provenance)


def test_a_smooth_motion_survives_resampling_at_any_rate(tmp_path: Path) -> None:
    at_s = np.arange(0.0, 2.0, 0.004)
    places = np.column_stack([at_s, 20 * np.sin(4 * at_s), 20 * np.cos(4 * at_s), 3 * at_s])
    path = written(tmp_path, HEADER + "".join(",".join(map(repr, map(float, row))) + "\n" for row in places))
    for loop_hz in (100.0, 1000.0, 4000.0, 10_000.0):
        (motion,) = load_motion(path, loop_hz)
        t = motion.time_s
        truth = np.column_stack([20 * np.sin(4 * t), 20 * np.cos(4 * t), 3 * t])
        assert np.abs(motion.position_mm - truth).max() < 2e-3
        assert motion.loop_hz == loop_hz


def test_segments_tabs_planar_and_further_columns(tmp_path: Path) -> None:
    rows = [f"{seg}\t{k * 0.01}\t{k}\t{-k}\tnote" for seg in ("a", "b") for k in range(6)]
    motions = load_motion(written(tmp_path, "\n".join(["seg\tt_s\tx_mm\ty_mm\tremark", *rows])), 500.0)
    assert [motion.name for motion in motions] == ["m:a", "m:b"]
    assert all(motion.provenance["planar"] and motion.provenance["ignored_columns"] == ["remark"] for motion in motions)
    assert all((motion.position_mm[:, 2] == 0).all() for motion in motions)


def test_orientation_is_resampled_on_the_short_way(tmp_path: Path) -> None:
    angle = np.linspace(0, 3.0, 31)
    sign = np.where(np.arange(31) % 2, -1.0, 1.0)  # q and -q are the same turn
    rows = [
        f"{0.02 * k},0,0,0,{s * np.cos(a / 2)},0,0,{s * np.sin(a / 2)}"
        for k, (a, s) in enumerate(zip(angle, sign, strict=True))
    ]
    (motion,) = load_motion(written(tmp_path, HEADER.strip() + ",qw,qx,qy,qz\n" + "\n".join(rows)), 1000.0)
    assert motion.orientation is not None
    turned = 2 * np.arctan2(motion.orientation[:, 3], motion.orientation[:, 0])
    np.testing.assert_allclose(turned, motion.time_s * 5.0, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(motion.orientation, axis=1), 1.0, atol=1e-12)


def test_time_scale_slows_the_hand_and_says_so(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER + "".join(f"{0.1 * k},{k},0,0\n" for k in range(11)))
    (motion,) = load_motion(path, 1000.0, time_scale=4.0)
    assert motion.time_s[-1] == pytest.approx(4.0) and motion.provenance["time_scale"] == 4.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "m.csv: is empty; "),
        (HEADER, "m.csv: holds a header and no rows; "),
        ("0,1,2,3\n1,2,3,4\n", "m.csv:1: numbers where the header should be; put the line t_s,x_mm,y_mm,z_mm on top"),
        ("t_s,x,y,z\n0,1,2,3\n", "m.csv:1: the header lacks x_mm, y_mm (it has t_s, x, y, z); "),
        ("t_s,x_mm,y_mm,x_mm\n0,1,2,3\n", "m.csv:1: the header names x_mm twice; "),
        ("t_s,x_mm,y_mm,qw,qx\n0,1,2,1,0\n", "m.csv:1: of the orientation only qw, qx is given; "),
        (HEADER + "0,0,0,0\n0.1,nan,0,0\n", "m.csv:3: x_mm is not finite; "),
        (HEADER + "0,0,0,0\n0.1,0,inf,0\n", "m.csv:3: y_mm is not finite; "),
        (HEADER + "0,0,0,0\n\n# c\n0.1,0,abc,0\n", "m.csv:5: y_mm is 'abc', not a number; "),
        (HEADER + "0,0,0,0\n0.1,0,0\n", "m.csv:3: 3 values under 4 columns; "),
        (
            HEADER + "0,0,0,0\n0.1,0,0,0\n0.1,0,0,0\n0.2,0,0,0\n",
            "m.csv:4: t_s goes from 0.1 to 0.1: time does not advance; ",
        ),
        (HEADER + "0,0,0,0\n0.1,0,0,0\n0.05,0,0,0\n0.2,0,0,0\n", "m.csv:4: t_s goes from 0.1 to 0.05: time does not"),
        (HEADER + "0,0,0,0\n0.1,0,0,0\n0.2,0,0,0\n", "m.csv:2: only 3 rows; give at least 4"),
        (HEADER + "0,0,0,0\n1e-7,0,0,0\n2e-7,0,0,0\n3e-7,0,0,0\n", "m.csv:2: 3e-07 s make 1 ticks at 1000 Hz; "),
        (HEADER + "0,0,0,0\n1e9,0,0,0\n2e9,0,0,0\n3e9,0,0,0\n", "m.csv:2: 3e+09 s make 3000000000001 ticks"),
        ("seg," + HEADER + "0,0,0,0,0\n0,1,0,0,0\n", "m.csv:2: only 2 rows in segment 0; "),
        (
            HEADER.strip() + ",qw,qx,qy,qz\n" + "".join(f"{k},0,0,0,{k},0,0,0\n" for k in range(4)),
            "m.csv:2: a quaternion of length 0; give unit quaternions",
        ),
    ],
)
def test_faults_name_file_and_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_motion(written(tmp_path, text), 1000.0)
    assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(message)


def test_unreadable_recordings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_motion(tmp_path / "none.csv", 1000.0)
    with pytest.raises(InputError, match="is a folder"):
        load_motion(tmp_path, 1000.0)
    (tmp_path / "b.csv").write_bytes(b"\x00\xff\xfe")
    with pytest.raises(InputError, match=r"not text \(byte 1\)"):
        load_motion(tmp_path / "b.csv", 1000.0)
    with pytest.raises(InputError, match="loop_hz"):
        load_motion(written(tmp_path, HEADER), 0.0)


def test_a_part_of_a_motion_starts_at_0_again() -> None:
    at_s = np.arange(100) / 100.0
    whole = Motion(at_s, np.column_stack([at_s, at_s, at_s]), None, 100.0, "m", {"kind": "recorded"})
    part = whole.part(0.25, 0.75)
    assert part.ticks == 50 and part.time_s[0] == 0.0 and part.position_mm[0, 0] == pytest.approx(0.25)
    assert part.provenance == {"kind": "recorded", "part_s": [0.25, 0.75]}
    assert part.digest != whole.digest == whole.part(0.0, 2.0).digest
    for wrong in (np.zeros((99, 3)), np.zeros((100, 2))):
        with pytest.raises(ValueError, match="do not fit"):
            Motion(at_s, wrong, None, 100.0, "m", {})
