"""Fast, turning and colliding tools on closed bodies: no ball ever gets to the other side."""

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

NOT_CONVERGED, TURN_HELD = 1 << 3, 1 << 10
SLACK_MM = 1e-3


def around_sphere(rng: np.random.Generator, low_mm: float, high_mm: float, count: int = 400) -> np.ndarray:
    """(count, 3) anchors in all directions, the first well clear."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    anchors = direction * rng.uniform(low_mm, high_mm, count)[:, None]
    anchors[0] = direction[0] * (high_mm + 2.0)
    return anchors


def face_heights(mesh: shapes.Mesh, points: np.ndarray) -> np.ndarray:
    """(n,) greatest signed height over the faces of a convex body: negative inside, exactly its polyhedron."""
    corners = mesh[0].astype(np.float64)[mesh[1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    return np.concatenate([(part @ normal.T - offset).max(axis=1) for part in np.array_split(points, 40)])


def box_heights(points: np.ndarray, half_mm: float, thickness_mm: float) -> np.ndarray:
    """(n,) signed distance (inside exact) to a plate whose upper side is z = 0."""
    return (np.abs(points + [0.0, 0.0, 0.5 * thickness_mm]) - [half_mm, half_mm, 0.5 * thickness_mm]).max(axis=1)


def random_turns(rng: np.random.Generator, ticks: int, step_rad: float = 0.01) -> np.ndarray:
    """(ticks, 4) random walk of the orientation, identity first."""
    walk = np.cumsum(np.concatenate([np.zeros((1, 4)), rng.normal(size=(ticks - 1, 4)) * step_rad]), axis=0)
    q = walk + [1.0, 0.0, 0.0, 0.0]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(n, 3) v turned by each unit quaternion of q (n, 4)."""
    u = q[:, 1:]
    t = 2.0 * np.cross(u, v)
    return v + q[:, :1] * t + np.cross(u, t)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("speed_mm_s", [30.0, 300.0])
@pytest.mark.parametrize("shape", ["sphere", "plate"])
def test_turning_points_never_get_inside(shape: str, speed_mm_s: float, seed: int) -> None:
    """Five points 0.8 mm out: nothing but the sweep of the turn stands between them and the other side."""
    rng = np.random.default_rng(seed)
    ticks = 6000
    arms = rng.normal(size=(5, 3))
    arms *= 0.8 / np.linalg.norm(arms, axis=1, keepdims=True)
    if shape == "sphere":
        mesh, anchors = shapes.sphere(10.0, 3), around_sphere(rng, 7.0, 14.0)
    else:
        mesh = shapes.plate(0.3)
        anchors = np.column_stack([rng.uniform(-7.0, 7.0, (400, 2)), rng.uniform(-3.0, 3.0, 400)])
        anchors[0] = [0.0, 0.0, 4.0]
    turns = random_turns(rng, ticks)
    hip = shapes.wander(anchors, speed_mm_s, ticks)
    rows = Core([mesh], np.column_stack([arms, np.zeros(5)])).replay(hip, turns)
    held = (rows["errors"] & TURN_HELD) != 0
    used = turns[np.maximum.accumulate(np.where(held, 0, np.arange(ticks)))]
    assert rows["contact"].mean() > 0.3
    assert held.mean() < 0.01
    for arm in arms:
        at = rows["scp_mm"] + rotated(used, arm)
        height = face_heights(mesh, at) if shape == "sphere" else box_heights(at, 10.0, 0.3)
        assert height.min() > -SLACK_MM
        if shape == "plate":
            # Thinner than a tick's travel: nor may a point appear on the other side without going round the border.
            over = np.abs(at[:, :2]).max(axis=1) < 9.0
            changes = np.diff(np.sign(at[:, 2] + 0.15)) != 0
            assert not (changes & over[1:] & over[:-1]).any()


FELL_THROUGH_MM = [
    [-1.463, 4.834, -9.318], [-1.294, 4.920, -9.436], [-1.267, 4.934, -9.454], [-1.256, 4.922, -9.436],
    [-1.186, 4.850, -9.320], [-1.014, 4.673, -9.035], [-0.715, 4.365, -8.542], [-0.281, 3.917, -7.824],
    [0.286, 3.332, -6.886], [0.973, 2.624, -5.751], [1.756, 1.817, -4.455], [2.608, 0.938, -3.046],
    [3.495, 0.024, -1.579], [4.382, -0.891, -0.113], [5.233, -1.769, 1.296], [6.017, -2.577, 2.592],
    [6.704, -3.285, 3.727], [7.271, -3.870, 4.665],
]  # fmt: skip


def test_a_stretched_slide_stays_behind_its_planes() -> None:
    """1 m/s through a sphere of 10 mm: the stretched slide once left the planes it had touched (commit 45df2fb)."""
    mesh = shapes.sphere(10.0, 4)
    rows = Core([mesh], point_or_ball(0.0)).replay(np.array(FELL_THROUGH_MM))
    assert rows["contact"][6:].all()
    assert face_heights(mesh, rows["scp_mm"]).min() > -SLACK_MM


@pytest.mark.parametrize("loop_hz", [1000.0, 4000.0])
@pytest.mark.parametrize("radius_mm", [0.0, 0.5])
def test_fast_and_deep_on_a_sphere(radius_mm: float, loop_hz: float) -> None:
    """1 m/s on a way that leads up to 3 mm deep between its ends, and deeper on it."""
    rng = np.random.default_rng(45)
    mesh = shapes.sphere(10.0, 3)
    anchors = around_sphere(rng, 7.0 + radius_mm, 14.0 + radius_mm, 2000)
    hip = shapes.wander(anchors, 1000.0, 12_000, loop_hz)
    rows = Core([mesh], point_or_ball(radius_mm), loop_hz=loop_hz).replay(hip)
    assert rows["contact"].mean() > 0.3
    assert ((rows["errors"] & NOT_CONVERGED) != 0).mean() < 1e-3
    inflated = face_heights(mesh, rows["scp_mm"]) if radius_mm == 0.0 else np.linalg.norm(rows["scp_mm"], axis=1)
    least = 0.0 if radius_mm == 0.0 else inner_radius(mesh) + radius_mm
    assert inflated.min() > least - SLACK_MM


def inner_radius(mesh: shapes.Mesh) -> float:
    """Radius of the largest ball about the origin within a convex body, mm."""
    return float(-face_heights(mesh, np.zeros((40, 3)))[0])


@pytest.mark.parametrize("shape", ["plate", "groove"])
@pytest.mark.parametrize("radius_mm", [0.0, 0.1])
def test_thin_plate_and_groove_hold_at_500_mm_s(shape: str, radius_mm: float) -> None:
    rng = np.random.default_rng(9)
    mesh = shapes.plate(0.3) if shape == "plate" else shapes.groove()
    anchors = np.column_stack([rng.uniform(-6.0, 6.0, (400, 2)), rng.uniform(-4.0, 1.0, 400)])
    anchors[0] = [0.0, 0.0, 12.0]
    rows = Core([mesh], point_or_ball(radius_mm)).replay(shapes.wander(anchors, 500.0, 10_000))
    scp = rows["scp_mm"]
    surface = np.abs(scp[:, 0]) if shape == "groove" else 0.0
    across = np.sqrt(2.0) if shape == "groove" else 1.0
    assert rows["contact"].mean() > 0.3
    assert ((scp[:, 2] - surface) / across).min() > radius_mm - SLACK_MM
