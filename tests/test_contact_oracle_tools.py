"""The runtime against the float64 solver of contact_oracle.py: tools of several balls, turned and turning, and a skull.

test_contact_oracle.py has single balls on simple shapes, cracks and a crop of a jaw.
"""

from pathlib import Path

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball
from contact_oracle import Oracle
from oracle_comparison import AGREE_MM, Comparison, compare_with
from test_contact_motion import random_turns, rotated

TURN_HELD, NOT_CONVERGED = 1 << 10, 1 << 3

TOOLS = {
    "bar": np.array([[x, 0.0, 0.0, r] for x, r in ((-0.8, 0.3), (-0.4, 0.1), (0.0, 0.3), (0.4, 0.0), (0.8, 0.2))]),
    "jack": np.array([[0.0, 0.0, 0.0, 0.5], [0.9, 0.0, 0.0, 0.1], [-0.5, 0.7, 0.0, 0.0], [0.0, -0.3, 0.8, 0.2]]),
}


def compare(mesh: shapes.Mesh, tool: np.ndarray, turn: np.ndarray, hip_mm: np.ndarray) -> Comparison:
    """A tool in one orientation (4,) along a path, against the oracle with turned balls."""
    rows = Core([mesh], tool).replay(hip_mm, np.tile(turn, (len(hip_mm), 1)))
    return compare_with(Oracle(*mesh, turned_tool(tool, turn)), rows, hip_mm)


def turned_tool(tool: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return np.column_stack([rotated(np.tile(turn, (len(tool), 1)), tool[:, :3]), tool[:, 3]])


def a_turn(seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=4)
    return q / np.linalg.norm(q)


def lowest(tool: np.ndarray, turn: np.ndarray) -> float:
    """How far below its reference point the turned tool reaches, mm."""
    balls = turned_tool(tool, turn)
    return float((balls[:, 3] - balls[:, 2]).max())


@pytest.mark.parametrize("speed_mm_s", [40.0, 500.0])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", TOOLS)
@pytest.mark.parametrize("shape", ["plane", "groove", "plate"])
def test_turned_tools_on_simple_shapes(shape: str, name: str, seed: int, speed_mm_s: float) -> None:
    mesh = {"plane": shapes.plane, "groove": shapes.groove, "plate": shapes.plate}[shape](cells=16)
    tool, turn = TOOLS[name], a_turn(seed)
    rng = np.random.default_rng(7 + seed)
    lift = lowest(tool, turn)
    path = np.column_stack([rng.uniform(-5.0, 5.0, (12, 2)), rng.uniform(-0.8, 0.3, 12) + lift])
    path[0] = path[1] * [1.0, 1.0, 0.0] + [0.0, 0.0, 9.0 + lift]
    hip = shapes.wander(path, speed_mm_s, 40_000)
    near = 3.0 if shape == "groove" else 0.6
    hip = hip[np.argmax(hip[:, 2] < near + abs(hip[:, 0]).max() * (shape == "groove") + lift) :][:90]
    result = compare(mesh, tool, turn, hip)
    assert result.touching > 8
    # Several balls in a groove have several resting places.
    assert result.differ == 0
    assert result.wrong == 0
    assert result.deepest_mm > -AGREE_MM


def from_near(hip_mm: np.ndarray, oracle: Oracle, ticks: int) -> np.ndarray:
    """(ticks, 3) of a path from its last tick in the air on: flying there costs the oracle time and shows nothing."""
    speed = np.linalg.norm(np.diff(hip_mm, axis=0), axis=1).max()
    first = next(k for k, hip in enumerate(hip_mm) if oracle.clearance(hip, 2.0 * speed + 0.1) < speed + 0.02)
    return hip_mm[max(first - 1, 0) :][:ticks]


@pytest.mark.parametrize("radius_mm", [0.1, 1.0])
@pytest.mark.parametrize("speed_mm_s", [40.0, 500.0])
def test_more_balls_on_a_sphere(speed_mm_s: float, radius_mm: float) -> None:
    mesh, tool = shapes.sphere(10.0, 3), point_or_ball(radius_mm)
    hip = from_near(on_sphere(radius_mm, speed_mm_s, 1000), Oracle(*mesh, tool), 80)
    result = compare(mesh, tool, a_turn(2), hip)
    assert result.touching > 30
    assert result.differ == 0
    assert result.deepest_mm > -AGREE_MM


def on_sphere(reach_mm: float, speed_mm_s: float, ticks: int = 90) -> np.ndarray:
    """(ticks, 3) through anchors about a sphere of 10 mm, the first one clear of it."""
    rng = np.random.default_rng(5)
    direction = rng.normal(size=(20, 3)) * 0.3 + [0.0, 0.0, 1.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    path = direction * (10.0 + reach_mm + rng.uniform(-1.2, 0.2, 20))[:, None]
    path[0] = direction[0] * (10.5 + reach_mm)
    return shapes.wander(path, speed_mm_s, ticks)


@pytest.mark.parametrize("speed_mm_s", [40.0, 500.0])
@pytest.mark.parametrize("name", TOOLS)
def test_turned_tools_on_a_sphere(name: str, speed_mm_s: float) -> None:
    mesh, tool, turn = shapes.sphere(10.0, 3), TOOLS[name], a_turn(3)
    hip = from_near(on_sphere(1.0, speed_mm_s, 1000), Oracle(*mesh, turned_tool(tool, turn)), 80)
    result = compare(mesh, tool, turn, hip)
    assert result.touching > 20
    assert result.differ == 0
    assert result.wrong == 0
    assert result.deepest_mm > -AGREE_MM


@pytest.fixture(scope="module")
def crop(data_dir: Path) -> shapes.Mesh:
    """8000 triangles of a real tooth surface."""
    from hapticlod.scan import load_scan

    scan = load_scan(data_dir / "dirty" / "00_clean_crop_8k.ply")
    return (scan.vertices - scan.centre_mm).astype(np.float32), scan.faces


@pytest.fixture(scope="module")
def skull(data_dir: Path) -> shapes.Mesh:
    """The 15 mm of a dry skull with 162 of its 497 non-manifold edges, read as they are: nothing welded or dropped."""
    import trimesh

    read = trimesh.load(data_dir / "meshes" / "human_skull_100k.ply", process=False)
    vertices, faces = np.asarray(read.vertices, dtype=np.float64), np.asarray(read.faces)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    bad = vertices[unique[count > 2]].mean(axis=1)
    assert len(bad) == 497
    crowd = [(np.linalg.norm(bad - p, axis=1) < 10.0).sum() for p in bad]
    centre = bad[int(np.argmax(crowd))]
    near = faces[np.linalg.norm(vertices[faces].mean(axis=1) - centre, axis=1) < 15.0]
    used, index = np.unique(near, return_inverse=True)
    return (vertices[used] - centre).astype(np.float32), index.reshape(-1, 3)


def strokes(mesh: shapes.Mesh, reach_mm: float, clear: Oracle, seed: int, speed_mm_s: float, ticks: int) -> np.ndarray:
    """(ticks, 3) from free air to faces of a mesh and a little into them."""
    corners = mesh[0].astype(np.float64)[mesh[1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    rng = np.random.default_rng(seed)
    while True:
        at = rng.choice(np.flatnonzero(size > 1e-9), 40)
        out = normal[at] / size[at, None]
        path = corners[at].mean(axis=1) + out * (reach_mm + rng.uniform(-0.8, 0.2, 40))[:, None]
        path[0] = path[1] + out[1] * (reach_mm + 1.0)
        if clear.clearance(path[0], 5.0) > 0.3:
            return from_near(shapes.wander(path, speed_mm_s, 2000), clear, ticks)


@pytest.mark.parametrize("name", TOOLS)
@pytest.mark.parametrize(("surface", "seed"), [("crop", 0), ("crop", 1), ("skull", 2)])
def test_turned_tools_on_real_surfaces(surface: str, seed: int, name: str, request: pytest.FixtureRequest) -> None:
    mesh, tool, turn = request.getfixturevalue(surface), TOOLS[name], a_turn(seed)
    oracle = Oracle(*mesh, turned_tool(tool, turn))
    result = compare(mesh, tool, turn, strokes(mesh, 1.0, oracle, seed, 60.0, 40))
    assert result.touching > 5
    assert result.differ == 0
    assert result.wrong == 0
    assert result.deepest_mm > -AGREE_MM


@pytest.mark.parametrize("speed_mm_s", [30.0, 500.0])
@pytest.mark.parametrize("radius_mm", [0.0, 0.1, 0.5, 1.0, 3.0])
def test_skull(skull: shapes.Mesh, radius_mm: float, speed_mm_s: float) -> None:
    """Edges with three and more faces, duplicates, flipped neighbours: none of it matters to two-sided triangles."""
    oracle = Oracle(*skull, point_or_ball(radius_mm))
    hip = strokes(skull, radius_mm, oracle, 4, speed_mm_s, 60 if radius_mm < 3.0 else 30)
    result = compare(skull, point_or_ball(radius_mm), np.array([1.0, 0.0, 0.0, 0.0]), hip)
    assert result.touching > 5
    assert result.differ <= 1
    assert result.wrong == 0
    assert result.deepest_mm > -AGREE_MM


@pytest.mark.parametrize("name", TOOLS)
@pytest.mark.parametrize("shape", ["plane", "sphere", "groove"])
def test_turning_tools_rest_at_a_minimum(shape: str, name: str) -> None:
    """The way out of a turn is not unique: what is asked is that no ball penetrates and nothing is left unheld."""
    mesh = {"plane": shapes.plane(8.0, 12), "sphere": shapes.sphere(10.0, 3), "groove": shapes.groove(8.0, 12)}[shape]
    tool, rng = TOOLS[name], np.random.default_rng(6)
    reach = float((np.linalg.norm(tool[:, :3], axis=1) + tool[:, 3]).max())
    if shape == "sphere":
        hip = on_sphere(0.4, 60.0, 250)
        hip[:30] += hip[0] / np.linalg.norm(hip[0]) * np.linspace(reach, 0.0, 30)[:, None]
    else:
        path = np.column_stack([rng.uniform(-3.0, 3.0, (12, 2)), rng.uniform(-0.4, 0.6, 12)])
        path[0] = [0.5, 0.0, 3.5 + reach]
        hip = shapes.wander(path, 60.0, 250)
    turns = random_turns(rng, len(hip), 0.01)
    rows = Core([mesh], tool).replay(hip, turns)
    held = (rows["errors"] & TURN_HELD) != 0
    assert held.sum() < 5
    assert rows["contact"].sum() > 60
    used = turns[np.maximum.accumulate(np.where(held, 0, np.arange(len(hip))))]
    oracle = Oracle(*mesh, tool)
    unheld = []
    for k, row in enumerate(rows):
        oracle.offsets = turned_tool(tool, used[k])[:, :3]
        assert oracle.clearance(row["scp_mm"], 0.1) > -AGREE_MM, f"tick {k}"
        if row["contact"] and not row["errors"] & NOT_CONVERGED:
            unheld.append(oracle.unheld(row["scp_mm"], hip[k]))
    assert (np.array(unheld) > 0.02).sum() <= 3
