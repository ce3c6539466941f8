"""Hands that slide to and fro over a plane and around a sphere, at a wanted mean speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion import Motion
from hapticlod.motion.strokes import min_jerk
from tuning.experiments.meshes import SPHERE_MM

Array = NDArray[np.float64]
DEPTH_MM = 1.0  # the HIP below the surface: 1 N at 1 N/mm
ENCODER_MM = 0.023  # position steps of the paper's Phantom Desktop


def slide_on_plane(mean_mm_s: float, seconds: float, loop_hz: float = 1000.0, seed: int = 0) -> Motion:
    """Straight strokes of 60 mm to and fro over the middle of the plane, each turned a little against the last."""
    along = _travelled(mean_mm_s, 60.0, seconds, loop_hz)
    angle = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.2, 1 + int(along.max() // 60.0 + 1)))
    stroke, part = np.divmod(along, 60.0)
    number = stroke.astype(int)
    reach = np.where(number % 2 == 0, part - 30.0, 30.0 - part)
    # The way from one direction to the next lies in the turning point, off the centre: strokes are blended over.
    smooth = np.interp(along / 60.0, np.arange(len(angle)) + 0.5, angle)
    position = np.column_stack([reach * np.cos(smooth), reach * np.sin(smooth), np.full(len(along), -DEPTH_MM)])
    return _motion(position, loop_hz, f"slide {mean_mm_s:g} mm/s", mean_mm_s)


def slide_on_sphere(mean_mm_s: float, seconds: float, loop_hz: float = 1000.0) -> Motion:
    """Around the sphere on a tilted circle, in strokes of 120 mm with a stop between: slow and fast in turns."""
    along = _travelled(mean_mm_s, 120.0, seconds, loop_hz)
    radius = SPHERE_MM / 2 - DEPTH_MM
    angle = along / (SPHERE_MM / 2)
    tilt = 0.35
    flat = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    turn = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    return _motion(radius * flat @ turn.T, loop_hz, f"around {mean_mm_s:g} mm/s", mean_mm_s)


def _travelled(mean_mm_s: float, stroke_mm: float, seconds: float, loop_hz: float) -> Array:
    """Distance at every tick: minimum-jerk strokes one after the other, of which the speed is 1.875 times the mean."""
    at = np.arange(round(seconds * loop_hz)) / loop_hz * mean_mm_s / stroke_mm
    whole = np.floor(at)
    return stroke_mm * (whole + min_jerk(at - whole))


def _motion(position: Array, loop_hz: float, name: str, mean_mm_s: float) -> Motion:
    stepped = np.round(position / ENCODER_MM) * ENCODER_MM
    about = {"kind": "slide", "mean_mm_s": mean_mm_s, "encoder_mm": ENCODER_MM}
    return Motion(np.arange(len(stepped)) / loop_hz, stepped, None, loop_hz, name, about)
