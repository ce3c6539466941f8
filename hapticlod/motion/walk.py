"""A walk over a surface: straight ahead as a geodesic goes, turned by the hand, kept from open borders."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.motion.surface import SEATED, Surface

Array = NDArray[np.float64]

NEIGHBOURS = 6
_STEPS_PER_S = 250.0


@dataclass(frozen=True)
class Path:
    """Points (K, 3) mm of a walk and the distance walked up to each, (K,) mm."""

    points_mm: Array
    walked_mm: Array


def step_for(surface: Surface, length_mm: float, seconds: float) -> float:
    """A step, mm, fine enough for a hand that goes `length_mm` in `seconds`, not much finer than the surface is."""
    wanted = length_mm / (seconds * _STEPS_PER_S)
    return float(np.clip(wanted, 0.5 * surface.spacing_mm, 0.02 * surface.extent_mm))


def start_on(surface: Surface, rng: np.random.Generator, radius_mm: float = 0.0) -> tuple[Array, Array]:
    """A place (3,) mm of a ball's centre on a good-sized piece of the surface, off its borders, and a tangent (3,).

    Half of the usual surface round it is enough: most of it lies round crests and thin walls, and a hand that set out
    there would go along them. A ball begins where it fits, if it does anywhere.
    """
    share = surface.weights / surface.weights.sum()
    tries = rng.choice(len(share), size=48, p=share)
    radius = 0.03 * surface.extent_mm
    around = surface.tree.query_ball_point(surface.points_mm[tries], radius, return_length=True)
    room = np.minimum(surface.border_mm[tries], surface.margin_mm) / surface.margin_mm
    good = np.minimum(around / (0.5 * np.median(around)), 1.0) + room
    good += 1e-3 * rng.random(len(tries))
    centres = surface.points_mm[tries]
    if surface.carries(radius_mm):
        centres = centres + radius_mm * surface.normals[tries]
        good += 10.0 * np.minimum(surface.clearance_mm(centres) / radius_mm, SEATED)
    place = int(np.argmax(good))
    best = tries[place]
    normal = surface.normals[best]
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return centres[place], np.cos(angle) * across + np.sin(angle) * np.cross(normal, across)


def walk(
    surface: Surface,
    start_mm: Array,
    direction: Array,
    length_mm: float,
    step_mm: float,
    turn_rad: Callable[[float], float],
    *,
    crest: float = 0.0,
) -> Path:
    """Walks `length_mm` over the surface.

    Args:
        surface: where.
        start_mm: (3,) a place on it; direction: (3,) unit, tangent there.
        length_mm: how far; step_mm: in steps of.
        turn_rad: walked distance (mm) -> angle to turn by before the next step; never asked to go back.
        crest: 0 to 1, how strongly to follow ridges and grooves.
    """
    points = [np.array(start_mm)]
    walked = [0.0]
    place, normal = np.array(start_mm), _normal_at(surface, start_mm)
    cloud, normals = surface.points_mm, surface.normals
    reach = 2.5 * surface.spacing_mm + step_mm
    most_steps = int(3 * length_mm / step_mm) + 100
    for _ in range(most_steps):
        if walked[-1] >= length_mm:
            break
        angle = turn_rad(walked[-1])
        if angle != 0.0:
            direction = np.cos(angle) * direction + np.sin(angle) * cross(normal, direction)
        ahead = place + step_mm * direction
        distance, near = surface.nearest(ahead, NEIGHBOURS)
        if distance[0] > reach:  # over an edge with nothing beyond: turn on the spot
            direction = turned_back(direction, normal)
            place = cloud[near[0]]
            points.append(place)
            walked.append(walked[-1] + step_mm)
            continue
        seen = normals[near]
        weight = np.exp(-np.square(distance / (1.5 * surface.spacing_mm))) * (seen @ normal > -0.3)
        total = weight.sum()
        if total < 1e-12:  # only the far side of a wall is near: go round it
            weight, total = np.ones(len(near)), float(len(near))
        weight /= total
        blended = weight @ seen
        size = np.sqrt(blended @ blended)
        normal = blended / size if size > 1e-6 else seen[0]
        new = ahead - ((ahead - weight @ cloud[near]) @ normal) * normal
        moved = new - place
        walked.append(walked[-1] + float(np.sqrt(moved @ moved)))
        place = new
        points.append(place)
        direction = steered(surface, near, direction, normal, crest)
    return Path(np.array(points), np.array(walked))


def turned_back(direction: Array, normal: Array) -> Array:
    """The direction of a turn on the spot: back, and somewhat aside, so that turn after turn looks all round."""
    back = -direction + 0.7 * cross(normal, direction)
    return back / np.linalg.norm(back)


def steered(surface: Surface, near: NDArray[np.intp], direction: Array, normal: Array, crest: float) -> Array:
    """The next `direction`, tangent: kept from open borders, else leaning along crests; `near`: by index."""
    if surface.border_mm[near[0]] < surface.margin_mm:
        direction = _from_border(surface, int(near[0]), direction)
    elif crest > 0.0:
        direction = _along_crest(direction, normal, surface.normals[near], crest)
    return on_plane(direction, normal)


def on_plane(direction: Array, normal: Array) -> Array:
    """The unit vector (3,) along `direction` in the plane across `normal`; any in it where there is none."""
    flat = direction - (direction @ normal) * normal
    size = np.sqrt(flat @ flat)
    if size < 1e-6:
        flat = cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        size = np.sqrt(flat @ flat)
    return flat / size


def _from_border(surface: Surface, near: int, direction: Array) -> Array:
    """`direction` at point `near` of the surface, bent away from the open border that is within the margin."""
    away = surface.border_away[near]
    near_border = 1.0 - surface.border_mm[near] / surface.margin_mm
    outward = -(direction @ away)
    if outward > -0.4:  # halfway into the margin nothing of the outward part is left
        return direction + (0.6 * near_border + max(outward, 0.0) * min(1.0, 2.0 * near_border)) * away
    return direction


def _along_crest(direction: Array, normal: Array, seen: Array, crest: float) -> Array:
    """Leans toward the tangent along which the normals near by change least, where that is clear."""
    spread = seen - seen.mean(axis=0)
    values, vectors = np.linalg.eigh(spread.T @ spread)
    if values[2] < 0.02:  # flat: no crest
        return direction
    along = cross(normal, vectors[:, 2])
    clear = (values[2] - values[1]) / values[2]
    return direction + (0.3 * crest * clear * np.sign(along @ direction)) * along


def _normal_at(surface: Surface, place: Array) -> Array:
    _, nearest = surface.tree.query(place)
    return surface.normals[int(nearest)]


def cross(a: Array, b: Array) -> Array:
    # np.cross costs ten times as much for single vectors
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
