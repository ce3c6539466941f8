"""Fills a profile curve, turned about a straight or curved axis, with balls.

A ball that touches the surface from inside without crossing it is a medial ball; their union is the shape (Blum
1967). In the plane of axis and profile they are found by shrinking a big ball at each outline point until it crosses
the outline no more (Ma, Bae and Choi 2012). Those centred on the axis serve the whole turn, the others become rings.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from hapticlod.ball_order import nested_order
from hapticlod.toml import TomlModel

Array = NDArray[np.float64]

_OUTLINE_POINTS = 1500
_CROSSING = 0.004  # of the greatest radius: what a ball may stick out, or every vertex would need tiny balls
_SMALLEST = 0.03  # of the greatest radius: corners sharper than this are rounded


class Blades(TomlModel):
    """Cutting edges: ridges of balls that wind about the axis and reach the profile; the core stays below it."""

    count: int = Field(ge=1, le=64)
    height_mm: float = Field(gt=0, description="how far they stand out of the core")
    radius_mm: float = Field(gt=0, description="radius of a ridge's balls")
    twist_deg_mm: float = 0.0


def fill_profile(
    profile_mm: Sequence[tuple[float, float]],
    balls: int,
    *,
    axis_mm: Sequence[tuple[float, float, float]] = (),
    blades: Blades | None = None,
) -> tuple[Array, Array]:
    """At most `balls` balls inside the turned profile: centres (P, 3) and radii (P,), mm, the tip's ball first.

    `profile_mm` rows are (distance along the axis, radius); `axis_mm` as in a tool file, straight +z when empty.
    """
    profile = np.array(profile_mm, dtype=np.float64)
    core = profile.copy()
    if blades is not None:
        tip_mm = np.minimum(core[:, 1], 2 * blades.radius_mm)  # blades start where the profile can carry them
        core[:, 1] = np.maximum(core[:, 1] - blades.height_mm, tip_mm)
    along, off, radii = _medial_balls(core)
    place = _axis_frame(axis_mm)
    centres, sizes = _rings(along, off, radii, place)
    share = balls if blades is None else max(1, min(len(sizes), balls // 6))
    if len(sizes) > share:
        chosen = nested_order(centres, sizes)[:share]
        centres, sizes = centres[chosen], sizes[chosen]
    if blades is not None and balls > len(sizes):
        ridge_centres, ridge_radii = _ridges(profile, blades, balls - len(sizes), place)
        centres, sizes = np.concatenate([centres, ridge_centres]), np.concatenate([sizes, ridge_radii])
    return centres, sizes


def axis_length_mm(axis_mm: Sequence[tuple[float, float, float]]) -> float:
    """Arc length of the smooth curve through `axis_mm`, mm."""
    return float(_axis_curve(axis_mm)[0][-1])


def _medial_balls(profile: Array) -> tuple[Array, Array, Array]:
    """Along-axis place, distance from the axis and radius of the medial balls, the tip's first; all (M,).

    A wide tip is flat; the far end, which touches nothing, is rounded.
    """
    corners = profile if profile[0, 1] == 0 else np.vstack([[profile[0, 0], 0.0], profile])
    points, normals = _outline(corners)
    mirrored = np.vstack([points, points * [1.0, -1.0]])
    tree = KDTree(mirrored)
    widest = float(profile[:, 1].max())
    allowed = _CROSSING * widest
    radii = np.full(len(points), float(np.ptp(profile[:, 0])) + widest)
    for _ in range(40):
        distance, nearest = tree.query(points + radii[:, None] * normals)
        crossing = distance < radii - allowed
        if not crossing.any():
            break
        step = points - mirrored[nearest]
        lean = np.maximum(-np.einsum("ij,ij->i", step, normals), 1e-12)
        smaller = np.einsum("ij,ij->i", step, step) / (2.0 * lean)
        radii = np.where(crossing, np.minimum(smaller, 0.999 * radii), radii)
    centres = points + radii[:, None] * normals
    along, off = centres[:, 0], np.abs(centres[:, 1])
    keep = (radii >= _SMALLEST * widest) & (along <= profile[-1, 0])
    along, off, radii = along[keep], off[keep], radii[keep]
    off[off < 0.05 * radii] = 0.0
    order = np.lexsort((along, off > 0))  # those on the axis first, from the tip
    return _thinned(along[order], off[order], radii[order], allowed)


def _thinned(along: Array, off: Array, radii: Array, allowed: float) -> tuple[Array, Array, Array]:
    """Drops balls so near a kept one that the surface between them sinks by less than about `allowed` / 4."""
    kept: list[int] = []
    for ball in range(len(radii)):
        apart = np.hypot(along[ball] - along[kept], off[ball] - off[kept])
        same_kind = (off[kept] > 0) == (off[ball] > 0)
        reach = np.sqrt(2.0 * allowed * np.minimum(radii[ball], radii[kept]))
        if not (same_kind & (apart + np.abs(radii[ball] - radii[kept]) < reach)).any():
            kept.append(ball)
    return along[kept], off[kept], radii[kept]


def _outline(corners: Array) -> tuple[Array, Array]:
    """Points spread evenly over the segments of an outline and their inward normals, both (N, 2)."""
    spans = np.diff(corners, axis=0)
    lengths = np.linalg.norm(spans, axis=1)
    counts = np.maximum(3, np.round(_OUTLINE_POINTS * lengths / lengths.sum()).astype(int))
    points: list[Array] = []
    normals: list[Array] = []
    for start, span, length, count in zip(corners[:-1], spans, lengths, counts, strict=True):
        points.append(start + ((np.arange(count) + 0.5) / count)[:, None] * span)
        normals.append(np.tile(np.array([span[1], -span[0]]) / length, (count, 1)))
    return np.concatenate(points), np.concatenate(normals)


class _Frame:
    """Places (along, off, angle) about an axis curve; its cross directions turn as little as possible along it."""

    def __init__(self, lengths: Array, points: Array) -> None:
        self.lengths, self.points = lengths, points
        tangents = np.gradient(points, lengths, axis=0, edge_order=2)
        self.tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
        first = np.cross(self.tangents[0], np.eye(3)[int(np.argmin(np.abs(self.tangents[0])))])
        across = [first / np.linalg.norm(first)]
        for tangent in self.tangents[1:]:
            turned = across[-1] - np.dot(across[-1], tangent) * tangent
            across.append(turned / np.linalg.norm(turned))
        self.across = np.array(across)

    def __call__(self, along: Array, off: Array, angle: Array) -> Array:
        def at(values: Array) -> Array:
            return np.stack([np.interp(along, self.lengths, values[:, k]) for k in range(3)], axis=1)

        tangent, across = at(self.tangents), at(self.across)
        beyond = along - np.clip(along, self.lengths[0], self.lengths[-1])
        centre = at(self.points) + beyond[:, None] * tangent
        side = np.cross(tangent, across)
        return centre + off[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * side)


def _axis_curve(axis_mm: Sequence[tuple[float, float, float]]) -> tuple[Array, Array]:
    knots = np.array(axis_mm, dtype=np.float64)
    chords = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    points = CubicSpline(chords, knots)(np.linspace(0.0, chords[-1], 2000))
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]), points


def _axis_frame(axis_mm: Sequence[tuple[float, float, float]]) -> _Frame:
    if len(axis_mm) == 0:
        return _Frame(np.array([0.0, 0.5, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 1.0]]))
    return _Frame(*_axis_curve(axis_mm))


def _rings(along: Array, off: Array, radii: Array, place: _Frame) -> tuple[Array, Array]:
    """One ball per centre on the axis, a ring of overlapping balls for the others."""
    counts = np.where(off > 0, np.ceil(2 * np.pi * off / (0.8 * radii)).astype(int), 1)
    which = np.repeat(np.arange(len(along)), counts)
    turn = np.concatenate([np.arange(count) / count for count in counts])
    return place(along[which], off[which], 2 * np.pi * turn), radii[which]


def _ridges(profile: Array, blades: Blades, balls: int, place: _Frame) -> tuple[Array, Array]:
    """Balls spread evenly along the blades, where the profile is wide enough to carry them."""
    along = np.linspace(profile[0, 0], profile[-1, 0], 4001)
    radius = np.interp(along, profile[:, 0], profile[:, 1])
    off = radius - blades.radius_mm
    angle = np.deg2rad(blades.twist_deg_mm) * along
    steps = np.sqrt(np.diff(along) ** 2 + np.diff(off) ** 2 + (off[1:] * np.diff(angle)) ** 2)
    carried = np.concatenate([[0.0], np.cumsum(np.where(off[1:] > blades.radius_mm, steps, 0.0))])
    if carried[-1] == 0.0 or balls < blades.count:
        return np.empty((0, 3)), np.empty(0)
    each = balls // blades.count
    at = np.interp((np.arange(each) + 0.5) / each * carried[-1], carried, along)
    off_at = np.interp(at, along, off)
    starts = 2 * np.pi * np.arange(blades.count) / blades.count
    centres = [place(at, off_at, start + np.deg2rad(blades.twist_deg_mm) * at) for start in starts]
    return np.concatenate(centres), np.full(each * blades.count, blades.radius_mm)
