"""A long tool beside a wall whose place is known: none of its balls is led into it."""

import numpy as np
import pytest
from motion_shapes import Mesh

from hapticlod.motion import Motion, hand
from hapticlod.motion.surface import Surface
from hapticlod.motion.walk import Path
from hapticlod.motion.whole_tool import yielded
from hapticlod.tool import Tool, union

RADIUS_MM, LENGTH_MM, BALLS = 0.5, 6.0, 13
WALL_X_MM = 5.0


def shaft(balls: int = BALLS) -> Tool:
    centres = [[0.0, 0.0, z] for z in np.linspace(0.0, LENGTH_MM, balls)]
    return union(centres, [RADIUS_MM] * balls, "shaft")


def quad(corners: list[list[float]], cells: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a parallelogram from its first, second and last corner, in small triangles."""
    a, b, d = (np.array(corner) for corner in corners)
    u, v = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    vertices = a + u.reshape(-1, 1) * (b - a) + v.reshape(-1, 1) * (d - a)
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.column_stack([first, first + cells + 1, first + cells + 2])
    upper = np.column_stack([first, first + cells + 2, first + 1])
    return vertices, np.concatenate([lower, upper])


def walled_floor() -> Mesh:
    """A floor in z = 0 that faces +z, and at its end a wall in x = 5 that faces -x."""
    floor = quad([[-20.0, -20.0, 0.0], [WALL_X_MM, -20.0, 0.0], [-20.0, 20.0, 0.0]], 40)
    wall = quad([[WALL_X_MM, -20.0, 0.0], [WALL_X_MM, -20.0, 20.0], [WALL_X_MM, 20.0, 0.0]], 40)
    corners = np.round(np.concatenate([floor[0], wall[0]]), 9)
    vertices, welded = np.unique(corners, axis=0, return_inverse=True)
    return Mesh(vertices=vertices, faces=welded.reshape(-1)[np.concatenate([floor[1], wall[1] + len(floor[0])])])


def leaning(degrees: float, count: int) -> np.ndarray:
    """(K, 4) quaternions that tip the shaft from +z toward +x."""
    half = np.radians(degrees) / 2
    return np.tile([np.cos(half), 0.0, np.sin(half), 0.0], (count, 1))


def depths(tip_mm: np.ndarray, degrees: float, tool: Tool) -> np.ndarray:
    """(K, P) how deep balls are in the floor or the wall, by their planes."""
    lean = np.radians(degrees)
    z = tool.centres_mm[:, 2]
    x = tip_mm[:, :1] + np.sin(lean) * z
    height = tip_mm[:, 2:] + np.cos(lean) * z
    return RADIUS_MM - np.minimum(WALL_X_MM - x, height)


@pytest.fixture(scope="module")
def surface() -> Surface:
    return Surface(walled_floor())


def approach(count: int = 400, depth_mm: float = 0.3) -> np.ndarray:
    """Tips that slide over the floor, pressed in, to 1 mm before the wall and back."""
    there = np.linspace(-5.0, WALL_X_MM - 1.0, count // 2)
    x = np.concatenate([there, there[::-1]])
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, RADIUS_MM - depth_mm)])


def test_a_leaning_shaft_is_kept_out_of_the_wall(surface: Surface) -> None:
    tool, tips, degrees = shaft(), approach(), 30.0
    allowed = np.full(len(tips), 0.3)
    assert depths(tips, degrees, tool).max() > 2.0  # as planned it goes through
    shift = yielded(surface, tips, leaning(degrees, len(tips)), tool, allowed)
    assert depths(tips + shift, degrees, tool).max() < 0.3 + 2.0 * surface.spacing_mm
    assert shift[:, 0].min() < -1.5  # it gives way along the floor, away from the wall,
    assert np.abs(shift[:, 1]).max() < 0.05
    assert shift[:, 2].min() > -0.02  # and is not pressed deeper into the floor


def test_an_upright_shaft_that_meets_nothing_is_left_alone(surface: Surface) -> None:
    tool, tips = shaft(), approach()
    assert not yielded(surface, tips, leaning(0.0, len(tips)), tool, np.full(len(tips), 0.3)).any()


def test_after_the_wall_the_hand_returns_to_its_way(surface: Surface) -> None:
    tool, tips, degrees = shaft(), approach(800), 30.0
    shift = yielded(surface, tips, leaning(degrees, len(tips)), tool, np.full(len(tips), 0.3))
    clear = depths(tips, degrees, tool).max(axis=1) < 0.31
    assert np.abs(shift[: np.argmin(clear)]).max() == 0.0
    late = len(tips) - 1 - np.argmin(clear[::-1]) + 60  # time to drift back
    assert late < len(tips)
    assert np.abs(shift[late:]).max() == 0.0


def wall_depth_mm(motion: Motion, tool: Tool) -> np.ndarray:
    """(T,) how deep the shaft's balls, the three at the tip apart, are in the wall."""
    assert motion.orientation is not None
    w, axis = motion.orientation[:, :1], motion.orientation[:, 1:]
    up = np.array([0.0, 0.0, 1.0])
    along = up + 2.0 * (w * np.cross(axis, up) + np.cross(axis, np.cross(axis, up)))
    at = motion.position_mm[:, None] + along[:, None] * tool.centres_mm[None, 3:, 2:]
    beside = (np.abs(at[..., 1]) < 20.0) & (at[..., 2] > 0.0) & (at[..., 2] < 20.0)
    return np.where(beside, RADIUS_MM - (WALL_X_MM - at[..., 0]), -np.inf).max(axis=1)


def test_a_hand_on_a_path_to_the_wall_yields(surface: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole making of a hand, with normals that lean the shaft toward the wall."""
    tool, random = shaft(), np.random.default_rng(0)
    x = np.linspace(-5.0, WALL_X_MM - 1.0, 181)
    path = Path(np.column_stack([x, np.zeros_like(x), np.full_like(x, RADIUS_MM)]), x - x[0])
    lean = np.radians(30.0)
    normals = np.tile([np.sin(lean), 0.0, np.cos(lean)], (len(x), 1))

    def deepest() -> float:
        speed_mm_s = np.full(2000, 9.0)
        args = surface, path, normals, speed_mm_s, [], hand.Press(encoder_mm=0.0), tool, 1000.0, random, "to wall", {}
        return float(wall_depth_mm(hand.hand_motion(*args), tool).max())

    assert deepest() < 1.5  # as deep as a hand of 0.8 N presses, and its tremor
    monkeypatch.setattr(hand, "yielded", lambda surface, tip_mm, *_: np.zeros_like(tip_mm))
    assert deepest() > 2.0
