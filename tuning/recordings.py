"""Recordings are cut into parts, in turn seen by the surrogate and kept apart to judge it.

Halves would be two tasks where a hand explores first and probes then. A part that began inside the body would have its
contact point there: a recording that has to be laid on the scan is cut before that, and every part approaches the
surface and leaves it; one that was made there is cut where the hand is farthest from the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hapticlod.errors import InputError
from hapticlod.motion import Motion, lay_on_scan, near_share
from hapticlod.motion.surface import Surface, surface_of
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool

PART_S = 6.0
_NEAR_MM, _NEAR_SHARE = 2.0, 0.2
_SHIFT = 0.4  # of a part: how far a cut may go in search of a hand in the air
_PULL_MM = 0.1  # that a cut must gain in height for every part's length that it is off
_LOOK_HZ = 100.0


def seen_and_apart(
    scan: Scan, station: Station, tool: Tool, given: Sequence[Motion], whole: bool = False
) -> tuple[list[Motion], list[Motion]]:
    """Parts of recordings in turn; with `whole`, one part of each recording is seen, and one kept apart: its halves.

    Those that are far from the scan are laid on it.

    Raises:
        InputError: a recording that does not move, or recordings that move in so few parts that none is left to judge.
    """
    seen: list[Motion] = []
    apart: list[Motion] = []
    surface = surface_of(scan)
    for motion in given:
        extent_mm = float(np.linalg.norm(np.ptp(motion.position_mm, axis=0)))
        scale = min(1.0, surface.extent_mm / extent_mm) if extent_mm > 0.0 else None
        pairs = 1 if whole else max(1, int(motion.seconds // (2.0 * PART_S)))
        near = lies_on(motion, scan, tool)
        cuts_s = _in_air(motion, surface, 2 * pairs) if near else np.linspace(0.0, motion.seconds, 2 * pairs + 1)
        parts = [motion.part(float(start), float(stop)) for start, stop in pairwise(cuts_s)]
        # Parts in which the hand rests are left out, unless it always does.
        moving = [part for part in parts if scale is None or np.ptp(part.position_mm, axis=0).any()]
        for i, part in enumerate(moving):
            if not near:
                part = lay_on_scan(
                    part, scan, tool=tool, stiffness_n_mm=station.stiffness_n_mm, max_force_n=station.max_force_n,
                    encoder_mm=station.encoder_mm, space_scale=scale, seed=len(seen) + len(apart),
                )  # fmt: skip
            (apart if i % 2 else seen).append(part)
    if not seen or not apart:
        raise InputError("motions", "move for too short a time to be parted in two", "give longer recordings")
    return seen, apart


def lies_on(motion: Motion, scan: Scan, tool: Tool) -> bool:
    """Whether a recording was made on this scan: much of it is near the surface."""
    return near_share(motion, scan, _NEAR_MM + tool.reference_radius_mm) > _NEAR_SHARE


def _in_air(motion: Motion, surface: Surface, parts: int) -> np.ndarray:
    """(parts + 1,) where to cut, s: near equal parts, but where the hand is farthest outside."""
    every = max(1, round(motion.loop_hz / _LOOK_HZ))
    at_s = np.arange(0, motion.ticks, every) / motion.loop_hz
    places, normals = surface.project(motion.position_mm[::every])
    height = np.einsum("ij,ij->i", motion.position_mm[::every] - places, normals)
    cuts_s, length_s = np.linspace(0.0, motion.seconds, parts + 1), motion.seconds / parts
    for i in range(1, parts):
        off = np.abs(at_s - cuts_s[i]) / length_s
        around = np.flatnonzero(off <= _SHIFT)
        if len(around):
            cuts_s[i] = at_s[around[np.argmax(height[around] - _PULL_MM * off[around])]]
    return cuts_s
