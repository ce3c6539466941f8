"""A hand that leads the whole tool: where its shaft would go through the body, the hand yields.

A hand is laid on a surface by its tip. Where nobody asks for the rest of the tool, its shaft is swept through
neighbouring walls, whose far side a contact point then cannot leave: the tool hangs there, dragged by millimetres,
on one level of detail and not on the next. No hand feels 10 N and goes on. So the tool is followed along its way as a
rigid body that gives way by shifting: it is pushed out of what its balls sink into and drifts back to the planned way.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hapticlod.motion.surface import Surface
from hapticlod.tool import Tool

Array = NDArray[np.float64]

_MOST_BALLS = 64  # of the tool's nested order: they outline it
_PUSHES = 12  # per place: against one wall one suffices, in a corner they alternate
_NEARLY = 0.05  # the nearest point may be farther than the nearest by this share
_SPARSE = 0.25  # of the median ball's radius: so far apart may points be that balls are asked against
_RETURN = 0.15  # of the shift is taken back from place to place


def yielded(surface: Surface, tip_mm: Array, turn: Array, tool: Tool, allowed_mm: Array) -> Array:
    """Shifts (K, 3) mm that keep every ball of a tool from sinking in deeper than it is pressed.

    Args:
        surface: what is in the way.
        tip_mm: (K, 3) planned places of the reference ball's centre, one after the other in time.
        turn: (K, 4) unit quaternions w x y z of the tool.
        tool: its first balls are asked for.
        allowed_mm: (K,) how deep balls may sink in.
    """
    centres, radii = tool.centres_mm[:_MOST_BALLS], tool.radii_mm[:_MOST_BALLS]
    body = _Body(surface, _SPARSE * float(np.median(radii)))
    arms = _turned(turn, centres)  # (K, P, 3)
    limit = allowed_mm + surface.spacing_mm
    planned = tip_mm[:, None] + arms
    # What is farther from the surface has not just sunk in; not to look further is what makes looking affordable.
    reach = np.full(len(tip_mm), radii.max())
    sunk = np.any(body.depth(planned, radii, float(reach[0]))[0] > limit[:, None], axis=1)
    reach[1:] = np.maximum(reach[1:], np.linalg.norm(np.diff(planned, axis=0), axis=2).max(axis=1))
    shift = np.zeros_like(tip_mm)
    now = np.zeros(3)
    for k in range(len(tip_mm)):
        if not sunk[k] and not now.any():
            continue
        now = (1.0 - _RETURN) * now
        if now @ now < (0.1 * surface.spacing_mm) ** 2:
            now = np.zeros(3)
        for _ in range(_PUSHES):
            depth, nearest = body.depth(planned[k] + now, radii, reach[k])
            worst = int(np.argmax(depth))
            if depth[worst] <= limit[k]:
                break
            now = now + (depth[worst] - limit[k]) * body.normals[nearest[worst]]
        shift[k] = now
    return shift


class _Body:
    """The surface's points, no denser than asked for."""

    def __init__(self, surface: Surface, spacing_mm: float) -> None:
        every = max(1, int((spacing_mm / surface.spacing_mm) ** 2))
        self.points_mm, self.normals = surface.points_mm[::every], surface.normals[::every]
        self._tree = KDTree(self.points_mm) if every > 1 else surface.tree

    def depth(self, centres: Array, radii: Array, reach_mm: float) -> tuple[Array, NDArray[np.intp]]:
        """How deep (..., P) balls sink in, -inf beyond reach, and the nearest points, by index."""
        distance, nearest = self._tree.query(centres, eps=_NEARLY, distance_upper_bound=reach_mm)
        seen = np.isfinite(distance)
        nearest = np.where(seen, nearest, 0)
        height = ((centres - self.points_mm[nearest]) * self.normals[nearest]).sum(axis=-1)
        return np.where(seen, radii - height, -np.inf), nearest


def _turned(turn: Array, arms: Array) -> Array:
    """`arms` (P, 3), turned by every quaternion (K, 4): (K, P, 3)."""
    w, axis = turn[:, None, :1], turn[:, None, 1:]
    twice = 2.0 * np.cross(axis, arms[None])
    return arms[None] + w * twice + np.cross(axis, twice)
