"""Recordings in parts: what was made on the scan is cut in the air, what was made elsewhere is cut and then laid."""

import contact_shapes as shapes
import numpy as np
import pytest

from hapticlod.errors import InputError
from hapticlod.motion import Motion, synthesise
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station
from hapticlod.tool import ball
from tuning.recordings import PART_S, seen_and_apart

RADIUS_MM = 10.0
STATION, TOOL = load_station(shipped_config("stations/desktop_1khz.toml")), ball(1.0)
LOOP_HZ = STATION.loop_hz


@pytest.fixture(scope="module")
def globe() -> Scan:
    return scan_from_arrays(*shapes.sphere(RADIUS_MM, 4))


def elsewhere(seconds: float, rests: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """A hand that writes circles half a metre away, and rests in between."""
    time_s = np.arange(round(seconds * LOOP_HZ)) / LOOP_HZ
    moving_s = time_s - np.clip(time_s - rests[0], 0.0, rests[1] - rests[0])
    turn = 2.0 * np.pi * 0.8 * moving_s
    place = np.column_stack([500.0 + 4.0 * np.cos(turn), 4.0 * np.sin(turn), 0.3 * moving_s])
    return Motion(time_s, place, None, LOOP_HZ, "circles", {})


def clearance_mm(motion: Motion) -> np.ndarray:
    """(T,) of the ball from the globe; negative where it is pressed in."""
    return np.linalg.norm(motion.position_mm, axis=1) - RADIUS_MM - TOOL.reference_radius_mm


def test_a_recording_on_the_scan_is_cut_in_the_air(globe: Scan) -> None:
    hand = synthesise(globe, "probe", seconds=6.5 * PART_S, loop_hz=LOOP_HZ, seed=2, tool=TOOL)
    assert np.mean(clearance_mm(hand) < 0.0) > 0.5
    seen, apart = seen_and_apart(globe, STATION, TOOL, [hand])
    assert len(seen) == len(apart) == 3
    parts = [part for pair in zip(seen, apart, strict=True) for part in pair]
    # In turn, all of it, and nothing twice.
    assert np.array_equal(np.concatenate([part.position_mm for part in parts]), hand.position_mm)
    assert all(clearance_mm(part)[0] > 0.1 for part in parts)
    assert all(0.2 * hand.seconds / 6 <= part.seconds <= 1.8 * hand.seconds / 6 for part in parts)


def test_a_recording_from_elsewhere_is_cut_and_then_laid(globe: Scan) -> None:
    hand = elsewhere(30.0)
    seen, apart = seen_and_apart(globe, STATION, TOOL, [hand])
    assert len(seen) == len(apart) == 2
    speed_mm_s = np.linalg.norm(np.diff(hand.position_mm[:2], axis=0)) * LOOP_HZ
    for part in (*seen, *apart):
        assert part.provenance["laid_space_scale"] == pytest.approx(1.0)
        clearance = clearance_mm(part)
        assert clearance[0] > 0.5 and clearance[-1] > 0.5 and np.mean(clearance < 0.0) > 0.7
        slow = part.position_mm[1000:-1000:50]
        measured = np.median(np.linalg.norm(np.diff(slow, axis=0), axis=1)) * LOOP_HZ / 50
        assert measured == pytest.approx(speed_mm_s, rel=0.25)


def test_all_parts_of_one_recording_are_scaled_alike(globe: Scan) -> None:
    """The whole is larger than the scan, its parts are not."""
    time_s = np.arange(round(4 * PART_S * LOOP_HZ)) / LOOP_HZ
    far = Motion(time_s, np.column_stack([3.0 * time_s, 0 * time_s, 500 + 0 * time_s]), None, LOOP_HZ, "line", {})
    seen, apart = seen_and_apart(globe, STATION, TOOL, [far])
    scales = {part.provenance["laid_space_scale"] for part in (*seen, *apart)}
    (scale,) = scales
    assert scale == pytest.approx(2.0 * np.sqrt(3.0) * RADIUS_MM / (3.0 * time_s[-1]), rel=0.02)


def test_whole_recordings_are_one_motion_each(globe: Scan) -> None:
    seen, apart = seen_and_apart(globe, STATION, TOOL, [elsewhere(30.0), elsewhere(4.0)], whole=True)
    assert [round(part.seconds, 1) for part in seen] == [15.0, 2.0] == [round(part.seconds, 1) for part in apart]


def test_a_part_in_which_the_hand_rests_is_left_out(globe: Scan) -> None:
    seen, apart = seen_and_apart(globe, STATION, TOOL, [elsewhere(24.0, (5.0, 13.0))])
    assert len(seen) == 2 and len(apart) == 1


def test_a_hand_that_never_moves_is_refused(globe: Scan) -> None:
    still = Motion(np.arange(200) / LOOP_HZ, np.full((200, 3), 300.0), None, LOOP_HZ, "held", {})
    with pytest.raises(InputError, match="motion held: does not move"):
        seen_and_apart(globe, STATION, TOOL, [still])


def test_a_hand_that_moves_in_one_part_alone_is_refused(globe: Scan) -> None:
    with pytest.raises(InputError, match="motions: move for too short a time"):
        seen_and_apart(globe, STATION, TOOL, [elsewhere(24.0, (5.0, 24.0))])
