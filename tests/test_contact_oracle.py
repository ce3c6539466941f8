"""The runtime's SCP against the independent float64 solver of contact_oracle.py, tick by tick."""

from pathlib import Path

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball
from contact_oracle import Oracle
from oracle_comparison import AGREE_MM, Comparison, compare_with

SPEEDS_MM_S = (40.0, 500.0)


def compare(mesh: shapes.Mesh, radius_mm: float, hip_mm: np.ndarray, crack_mm: float = 0.0) -> Comparison:
    """One ball along a path. Over a crack it may sink by a part of the crack's width: there depth is not judged."""
    tool = point_or_ball(radius_mm)
    rows = Core([mesh], tool, crack_mm=crack_mm).replay(hip_mm)
    return compare_with(Oracle(mesh[0], mesh[1], tool, crack_mm), rows, hip_mm, judge_depth=crack_mm == 0.0)


def over(half_mm: float, low_mm: float, high_mm: float, seed: int, count: int = 12) -> np.ndarray:
    """(count, 3) points above and below a square; the first one clear of it."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-half_mm, half_mm, (count, 2)), rng.uniform(low_mm, high_mm, count)])
    points[0, 2] = high_mm + 6.0
    return points


@pytest.mark.parametrize("speed_mm_s", SPEEDS_MM_S)
@pytest.mark.parametrize("radius_mm", [0.0, 0.1, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("shape", ["plane", "groove", "plate"])
def test_simple_shapes(shape: str, radius_mm: float, speed_mm_s: float) -> None:
    mesh = {"plane": shapes.plane, "groove": shapes.groove, "plate": shapes.plate}[shape](cells=24)
    lift = radius_mm * (1.4 if shape == "groove" else 1.0)
    path = over(6.0, -1.0 + lift, (3.0 if shape == "groove" else 0.4) + lift, seed=3)
    path[0] = path[1] * [1.0, 1.0, 0.0] + [0.0, 0.0, 10.0 + lift]
    hip = shapes.wander(path, speed_mm_s, 40_000)
    hip = hip[np.argmax(hip[:, 2] < 4.5 + lift) :][:150]
    result = compare(mesh, radius_mm, hip)
    assert result.touching > 10
    assert result.differ == 0
    assert result.deepest_mm > -AGREE_MM


@pytest.mark.parametrize("speed_mm_s", SPEEDS_MM_S)
@pytest.mark.parametrize("radius_mm", [0.0, 0.5, 3.0])
def test_sphere(radius_mm: float, speed_mm_s: float) -> None:
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(20, 3)) * 0.3 + [0.0, 0.0, 1.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    path = direction * (10.0 + radius_mm + rng.uniform(-1.5, 0.2, 20))[:, None]
    path[0] = direction[0] * (11.0 + radius_mm)
    result = compare(
        shapes.sphere(10.0, 4), radius_mm, shapes.wander(path, speed_mm_s, 150 if speed_mm_s < 100.0 else 90)
    )
    assert result.touching > 50
    assert result.differ == 0
    assert result.deepest_mm > -AGREE_MM


@pytest.mark.parametrize(("gap_um", "bridge_um"), [(1, 0), (1, 1), (10, 0), (10, 10), (50, 0), (50, 50), (50, 100)])
def test_cracks(gap_um: int, bridge_um: int) -> None:
    """A gap up to the stated width holds the point: through ten strokes it stays in contact, near the plane."""
    path = over(4.0, -1.0, -0.5, seed=2)
    path[0] = [0.3, 0.3, 1.0]
    hip = shapes.wander(path, 200.0, 250)
    mesh = shapes.cracked_plane(gap_um * 1e-3)
    result = compare(mesh, 0.0, hip, crack_mm=bridge_um * 1e-3)
    assert result.differ == 0
    if bridge_um:
        pressed = hip[:, 2] < 0.0  # the path ends above the plane
        rows = Core([mesh], point_or_ball(0.0), crack_mm=bridge_um * 1e-3).replay(hip)[pressed]
        assert rows["contact"].all()
        # Steep planes: at the equal width the SCP sinks by 0.29 gaps in a crack, by 0.71 where two cross, sqrt(2) gaps
        # from corner to corner. float32 vertices round a gap by up to 1 um.
        assert rows["scp_mm"][:, 2].min() > -0.72e-3 * (gap_um + 1)


@pytest.fixture(scope="module")
def crop(data_dir: Path) -> shapes.Mesh:
    """8000 triangles of a real tooth surface."""
    from hapticlod.scan import load_scan

    scan = load_scan(data_dir / "dirty" / "00_clean_crop_8k.ply")
    return (scan.vertices - scan.centre_mm).astype(np.float32), scan.faces


@pytest.mark.parametrize("speed_mm_s", [20.0, 500.0])
@pytest.mark.parametrize("radius_mm", [0.0, 0.1, 0.5, 1.0, 3.0])
def test_real_crop(crop: shapes.Mesh, radius_mm: float, speed_mm_s: float) -> None:
    """Between bumps there are several local minima: on the same way the same one is reached, even at 0.9 mm a tick."""
    vertices, faces = crop
    corners = vertices.astype(np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rng = np.random.default_rng(11)
    at = rng.integers(0, len(faces), 40)
    path = corners[at].mean(axis=1) + normal[at] * (radius_mm + rng.uniform(-0.8, 0.2, 40))[:, None]
    path[0] = path[1] + normal[at[1]] * 2.0
    # A large ball has hundreds of triangles near, the more the faster it goes.
    ticks = 120 if radius_mm < 3.0 else 60 if speed_mm_s < 100.0 else 40
    result = compare(crop, radius_mm, shapes.wander(path, speed_mm_s, ticks))
    assert result.touching > 5
    assert result.differ == 0
    assert result.wrong == 0
    assert result.deepest_mm > -AGREE_MM
