"""Nested order of a union of balls: the first P balls describe the whole best, for every P.

Greedy coverage of sampled surface points: each step takes the worst-described point, and among the balls that reach
it the one that brings most points nearer. (Plain farthest-point order is within a factor 2 of the best worst gap,
Gonzalez 1985; taking the best of the balls at that point keeps the bound in practice and helps the mean.)
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[np.float64]

_MEETS_MM = 1e-9
_RIVALS = 16  # balls compared at the worst point
_COMPARED_STEPS = 256  # later steps change little: they take the ball at the worst point at once


def sphere_directions(count: int) -> Array:
    """`count` nearly uniform unit vectors, (count, 3): a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    rho = np.sqrt(1.0 - z * z)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1)


def union_surface(centres_mm: Array, radii_mm: Array, *, samples: int = 16_000) -> tuple[Array, NDArray[np.intp]]:
    """Points on the surface of a union of balls, (S, 3), and the ball each lies on, (S,).

    About `samples` points are laid on the balls, at least 24 on each; those inside another ball are dropped. A ball
    of radius 0 gives its centre.
    """
    per_ball = max(24, samples // len(radii_mm))
    directions = sphere_directions(per_ball)
    tree = KDTree(centres_mm)
    near = tree.query_ball_point(centres_mm, radii_mm + radii_mm.max() + _MEETS_MM)
    points: list[Array] = []
    owners: list[NDArray[np.intp]] = []
    for ball, neighbours in enumerate(near):
        own = centres_mm[ball] + radii_mm[ball] * (directions if radii_mm[ball] > 0 else np.zeros((1, 3)))
        others = np.array([j for j in neighbours if j != ball], dtype=np.intp)
        if len(others):
            depth = radii_mm[others] - np.linalg.norm(own[:, None] - centres_mm[others], axis=2)
            depth[:, others > ball] -= 2 * _MEETS_MM  # of equal balls the first keeps its points
            own = own[depth.max(axis=1) < _MEETS_MM]
        points.append(own)
        owners.append(np.full(len(own), ball, dtype=np.intp))
    return np.concatenate(points), np.concatenate(owners)


def nested_order(centres_mm: Array, radii_mm: Array, *, first: int = 0) -> NDArray[np.intp]:
    """A permutation of the balls that starts with `first`, (P,)."""
    count = len(radii_mm)
    points, owners = union_surface(centres_mm, radii_mm)
    gap = np.full(len(points), np.inf)
    order: list[int] = []
    left = np.ones(count, dtype=bool)

    def distance(ball: int) -> Array:
        return np.linalg.norm(points - centres_mm[ball], axis=1) - radii_mm[ball]

    ball = first
    while True:
        order.append(ball)
        left[ball] = False
        np.minimum(gap, distance(ball), out=gap)
        if len(order) == count:
            return np.array(order, dtype=np.intp)
        worst = int(np.argmax(gap))
        if gap[worst] <= 1e-6:  # the rest lies inside: largest first
            rest = np.flatnonzero(left)
            return np.concatenate([order, rest[np.argsort(-radii_mm[rest], kind="stable")]]).astype(np.intp)
        ball = int(owners[worst])
        if len(order) <= _COMPARED_STEPS:
            reach = np.linalg.norm(centres_mm - points[worst], axis=1) - radii_mm
            reach[~left] = np.inf
            rivals = np.argsort(reach, kind="stable")[:_RIVALS]
            rivals = rivals[reach[rivals] <= 0.25 * gap[worst]]
            gains = [float(np.maximum(gap - distance(int(rival)), 0.0).sum()) for rival in rivals]
            ball = int(rivals[int(np.argmax(gains))])


def worst_gaps_mm(centres_mm: Array, radii_mm: Array) -> Array:
    """Worst distance from the full union's surface to the union of the first P balls, for P = 1..count, (count,)."""
    points, _ = union_surface(centres_mm, radii_mm)
    gap = np.full(len(points), np.inf)
    worst = np.empty(len(radii_mm))
    for ball, (centre, radius) in enumerate(zip(centres_mm, radii_mm, strict=True)):
        np.minimum(gap, np.linalg.norm(points - centre, axis=1) - radius, out=gap)
        worst[ball] = gap.max()
    return np.where(worst > _MEETS_MM, worst, 0.0)
