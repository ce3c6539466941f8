"""The way of a tool's reference ball over a surface, before anyone follows it at any speed."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hapticlod.motion.roll import roll
from hapticlod.motion.surface import Surface
from hapticlod.motion.walk import Path, start_on, walk

Array = NDArray[np.float64]


def track_over(
    surface: Surface,
    length_mm: float,
    step_mm: float,
    turn_rad: Callable[[float], float],
    radius_mm: float,
    rng: np.random.Generator,
    *,
    crest: float = 0.0,
) -> tuple[Path, Array]:
    """Places of the ball's centre from some place on, evenly spaced, with their own length; and contact normals.

    A ball rolls; a point, a ball below the spacing at which the surface is known, and one that fits nowhere walk.
    Arguments as `walk`.
    """
    begin, direction = start_on(surface, rng, radius_mm)
    if surface.carries(radius_mm):
        rolled = roll(surface, begin, direction, length_mm, step_mm, turn_rad, radius_mm, crest=crest)
        if rolled.walked_mm[-1] > min(radius_mm, 0.5 * length_mm):
            centres, normals = surface.seated(_evenly(rolled), radius_mm)
            return _measured(centres), normals
        begin = surface.project(begin[None])[0][0]  # it fits nowhere: its hand goes over the surface all the same
    walked = walk(surface, begin, direction, length_mm, step_mm, turn_rad, crest=crest)
    places, normals = surface.project(_evenly(walked))
    return _measured(places + radius_mm * normals), normals


def _evenly(path: Path) -> Array:
    """Places (K, 3) along a path, twice as dense as its steps."""
    fine_mm = 0.5 * path.walked_mm[-1] / max(len(path.walked_mm) - 1, 1)
    keep = np.concatenate([[True], np.diff(path.walked_mm) > 0.02 * fine_mm])
    curve = CubicSpline(path.walked_mm[keep], path.points_mm[keep])
    return np.asarray(curve(np.arange(0.0, path.walked_mm[-1], fine_mm)))


def _measured(places: Array) -> Path:
    return Path(places, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))]))
