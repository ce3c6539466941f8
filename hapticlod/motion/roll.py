"""A ball that rolls over a surface: it goes where its centre can, not where the surface is.

A walk over the surface leads into gaps, holes and corners that a ball does not fit into, and out of them on the far
side; a contact point cannot follow. So the centre itself is moved on, and after every step brought to where the ball
rests. In a groove it rides on both flanks and climbs the second; where it fits no further it turns round.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion.surface import SEATED, Surface
from hapticlod.motion.walk import NEIGHBOURS, Path, cross, on_plane, steered, turned_back

Array = NDArray[np.float64]

_STEP_OF_RADIUS = 0.25  # a longer step could leave a gap that is a little too narrow on its far side
_SEATINGS = 24
_FITS = 0.9  # of its radius: with less room about it, a ball fits nowhere near
_HELD_STEPS = 6  # a corner may take so many steps to turn round in
_WEDGED_TURNS = 16  # in a row: all round
_HELD = 0.2  # of a step: a ball that gets on by less is held


def roll(
    surface: Surface,
    start_mm: Array,
    direction: Array,
    length_mm: float,
    step_mm: float,
    turn_rad: Callable[[float], float],
    radius_mm: float,
    *,
    crest: float = 0.0,
) -> Path:
    """Rolls a ball `length_mm` over the surface: places of its centre.

    Arguments as `walk`, but `start_mm` is the centre's, beside the surface; `radius_mm` is at least its spacing. The
    path is shorter where the ball is wedged, and a single place where it cannot move at all.
    """
    step_mm = min(step_mm, _STEP_OF_RADIUS * radius_mm)
    centre, distance, near = _seated(surface, np.array(start_mm), radius_mm)
    clear, normal = distance[0], _normal(surface, centre, distance, near)
    direction = on_plane(direction, normal)
    points, walked = [centre], [0.0]
    held = turns = 0
    if clear < _FITS * radius_mm:
        return Path(np.array(points), np.array(walked))
    for _ in range(int(3 * length_mm / step_mm) + 100):
        if walked[-1] >= length_mm or turns > _WEDGED_TURNS:
            break
        angle = turn_rad(walked[-1])
        if angle != 0.0:
            direction = np.cos(angle) * direction + np.sin(angle) * cross(normal, direction)
        ahead, distance, its_near = _seated(surface, centre + step_mm * direction, radius_mm)
        moved = ahead - centre
        length = float(np.sqrt(moved @ moved))
        held = held + 1 if length < _HELD * step_mm else 0
        if distance[0] < min(SEATED * radius_mm, clear) or held > _HELD_STEPS:  # it fits no further
            direction, held = on_plane(turned_back(direction, normal), normal), 0
            turns += 1
            continue
        centre, clear, near, turns = ahead, distance[0], its_near, 0
        points.append(centre)
        walked.append(walked[-1] + length)
        before, normal = normal, _normal(surface, centre, distance, near)
        direction = _carried(direction, before, normal)
        direction = steered(surface, near, direction, normal, crest)
    return Path(np.array(points), np.array(walked))


def _seated(surface: Surface, centre: Array, radius_mm: float) -> tuple[Array, Array, NDArray[np.intp]]:
    """`centre` (3,) moved straight from or to the nearest place of the surface until the ball rests.

    Also the distances from there to the nearest points of the surface, increasing, and these points, by index.
    """
    cloud = surface.points_mm
    distance, near = surface.nearest(centre, NEIGHBOURS)
    for _ in range(_SEATINGS):
        if abs(distance[0] - radius_mm) <= 0.5 * (1.0 - SEATED) * radius_mm or distance[0] == 0.0:
            break
        centre = cloud[near[0]] + (radius_mm / distance[0]) * (centre - cloud[near[0]])
        distance, near = surface.nearest(centre, NEIGHBOURS)
    return centre, distance, near


def _normal(surface: Surface, centre: Array, distance: Array, near: NDArray[np.intp]) -> Array:
    """The direction (3,) from the nearest points of the surface, so far away, to the centre."""
    away = (centre - surface.points_mm[near]) / np.maximum(distance, 1e-12)[:, None]
    weight = np.exp((distance[0] ** 2 - np.square(distance)) / surface.spacing_mm**2)
    blended = weight @ away
    size = np.sqrt(blended @ blended)
    return blended / size if size > 1e-6 else away[0]


def _carried(direction: Array, before: Array, after: Array) -> Array:
    """`direction`, turned as the normal turns: in a corner the way into the wall becomes the way up it."""
    cosine = float(before @ after)
    if cosine < -0.999:
        return direction
    axis = cross(before, after)
    return cosine * direction + cross(axis, direction) + (axis @ direction) / (1.0 + cosine) * axis
