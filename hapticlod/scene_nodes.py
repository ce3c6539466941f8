"""Nodes of a GLB that carry meshes, each where the file's own graph puts it."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from hapticlod.errors import InputError
from hapticlod.scan_file import check_indices


def read_nodes(path: Path) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """(name, vertices (n, 3) float64 in the file's unit, faces (m, 3)) of every node with triangles, sorted by name.

    Raises:
        InputError: the file cannot be read, or has no such node.
    """
    where = os.fspath(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        what = "is a folder" if path.is_dir() else f"cannot be read ({error.strerror})"
        raise InputError(where, what, "check the path") from error
    if data[:4] != b"glTF":
        raise InputError(where, "does not start like a GLB file", "save it as binary glTF (.glb)")
    import trimesh  # slow to import, and only needed here

    try:
        held: Any = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
        graph = [(node, *held.graph[node]) for node in sorted(held.graph.nodes_geometry)]
    except Exception as error:  # the parser raises whatever its code meets
        reason = " ".join(str(error).split())[:200]
        what = f"cannot be read as GLB ({type(error).__name__}: {reason})"
        raise InputError(where, what, "export the scene again") from error
    nodes: list[tuple[str, np.ndarray, np.ndarray]] = []
    for node, pose, name in graph:
        mesh = held.geometry[name]
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        if faces.size == 0:
            continue
        turn = np.asarray(pose, dtype=np.float64)
        check_indices(faces, len(vertices), where)
        vertices = vertices @ turn[:3, :3].T + turn[:3, 3]
        nodes.append((str(node), vertices, faces[:, ::-1] if np.linalg.det(turn[:3, :3]) < 0.0 else faces))
    if not nodes:
        raise InputError(where, "has no node with triangles", "export surfaces with faces")
    return nodes
