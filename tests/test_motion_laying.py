"""Recordings laid on a scan that they were not made on."""

import json
from pathlib import Path

import numpy as np
import pytest
from motion_shapes import Mesh, plate

from hapticlod.errors import InputError
from hapticlod.motion import Motion, lay_on_scan, load_motion, near_share


@pytest.fixture(scope="module")
def plate_mesh() -> Mesh:
    return plate()


def circle(loop_hz: float = 1000.0) -> Motion:
    """Two turns a second on a circle of 5 mm, far away, tilted: 62.8 mm/s throughout."""
    at_s = np.arange(0.0, 4.0, 1.0 / loop_hz)
    angle = 4.0 * np.pi * at_s
    position = np.column_stack([900 + 5 * np.cos(angle), 5 * np.sin(angle), 0.0 * at_s])
    tilt = np.array([[1, 0, 0], [0, np.cos(0.7), -np.sin(0.7)], [0, np.sin(0.7), np.cos(0.7)]])
    return Motion(at_s, position @ tilt.T, None, loop_hz, "circle", {"kind": "recorded"})


def test_laid_recording_keeps_speed_and_bend(plate_mesh: Mesh) -> None:
    source = circle()
    assert near_share(source, plate_mesh, 5.0) == 0.0
    laid = lay_on_scan(source, plate_mesh, force_n=0.5, encoder_mm=0.0)
    assert near_share(laid, plate_mesh, 5.0) == 1.0
    middle = slice(1000, 3000)
    assert np.median(laid.speed_mm_s()[middle]) == pytest.approx(62.8, rel=0.03)
    span = np.ptp(laid.position_mm[1000:1500, :2], axis=0)  # one turn
    np.testing.assert_allclose(span, 10.0, rtol=0.1)
    assert laid.position_mm[middle, 2].max() < 0.0  # in contact
    assert laid.provenance["laid_space_scale"] == 1.0 and laid.provenance["source_digest"] == source.digest
    json.dumps(laid.provenance)


def test_laid_recording_is_scaled_as_said(plate_mesh: Mesh) -> None:
    slow = lay_on_scan(circle(), plate_mesh, time_scale=4.0, space_scale=2.0)
    assert slow.seconds == pytest.approx(16.0, abs=0.01)
    assert np.median(slow.speed_mm_s()[4000:12000]) == pytest.approx(31.4, rel=0.05)
    huge = circle()
    huge = Motion(huge.time_s, 100 * huge.position_mm, None, 1000.0, "huge", {})
    fitted = lay_on_scan(huge, plate_mesh)
    assert fitted.provenance["laid_space_scale"] < 0.2
    with pytest.raises(InputError, match="does not move"):
        lay_on_scan(Motion(huge.time_s, 0 * huge.position_mm, None, 1000.0, "still", {}), plate_mesh)
    with pytest.raises(InputError, match="time_scale"):
        lay_on_scan(circle(), plate_mesh, time_scale=0.0)


def test_real_recordings_load_and_lie_on_a_real_scan(data_dir: Path, small_dentition) -> None:
    for path in sorted((data_dir / "motion").glob("*.csv")):
        motions = load_motion(path, 1000.0)
        assert motions and all(np.isfinite(motion.position_mm).all() for motion in motions)
    (probe,) = load_motion(data_dir / "motion" / "tracked_probe_watertank.csv", 1000.0)
    part = probe.part(0.0, 10.0)
    laid = lay_on_scan(part, small_dentition)
    told, kept = (np.quantile(motion.speed_mm_s(8.0), [0.5, 0.9]) for motion in (part, laid))
    np.testing.assert_allclose(kept, told, rtol=0.25, atol=2.0)
