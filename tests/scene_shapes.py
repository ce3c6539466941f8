"""A small scene for the tests: a ball and a box beside it, as files."""

from pathlib import Path

import numpy as np
import trimesh

TWO_PARTS = """\
name = "two bodies"

[[part]]
name = "ball"
scan = "ball.stl"
unit = "mm"

[[part]]
name = "the box"
scan = "box.stl"
unit = "mm"
position_mm = [12.0, 0.0, 0.0]
orientation = [0.7071067811865476, 0.0, 0.0, 0.7071067811865476]
material = { stiffness_n_mm = 0.5 }
most_triangles = 400
"""


def write_scene(folder: Path, text: str = TWO_PARTS) -> Path:
    """The scene file; its scans lie beside it: a ball of 10 mm, a box of 8 x 10 x 6 mm."""
    trimesh.creation.icosphere(3, 10.0).export(folder / "ball.stl")
    box = trimesh.creation.box((8.0, 10.0, 6.0)).subdivide().subdivide().subdivide()
    box.export(folder / "box.stl")
    path = folder / "scene.toml"
    path.write_text(text)
    return path


def write_glb(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Two nodes in metres, "left" and "right" (turned and moved by the graph); returns right's vertices, mm."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.icosphere(2, 0.005), node_name="left", geom_name="left mesh")
    box = trimesh.creation.box((0.004, 0.006, 0.002)).subdivide()
    turn = np.array([[0.0, -1.0, 0.0, 0.02], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.003], [0.0, 0.0, 0.0, 1.0]])
    scene.add_geometry(box, node_name="right", geom_name="right mesh", transform=turn)
    scene.export(path, file_type="glb")
    return 1000.0 * (box.vertices @ turn[:3, :3].T + turn[:3, 3]), box.faces
