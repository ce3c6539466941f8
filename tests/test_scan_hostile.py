"""Files that lie about what they hold: refused at once and in little memory, or read without losing a face."""

from __future__ import annotations

import json
import os
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from hapticlod.errors import InputError
from hapticlod.scan import load_scan, scan_from_arrays
from hapticlod.scan_file import check_mesh_file

HEAD = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face {}\nproperty list {} int vertex_indices\nend_header\n"
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 2, 0]], "<f4").tobytes()


def ply(*faces: bytes, count: str = "uchar") -> bytes:
    return (
        (HEAD.format("binary_little_endian", 5) + FACES.format(len(faces), count)).encode() + CORNERS + b"".join(faces)
    )


def text_ply(*faces: str) -> bytes:
    points = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 2 0\n"
    return (HEAD.format("ascii", 5) + FACES.format(len(faces), "uchar") + points + "\n".join(faces) + "\n").encode()


def face(*corners: int) -> bytes:
    return struct.pack(f"<B{len(corners)}i", len(corners), *corners)


def glb(accessors: list[dict[str, Any]], views: list[dict[str, Any]], **more: Any) -> bytes:
    part = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}
    nodes = {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [part]}
    held = {"asset": {"version": "2.0"}, **nodes, "accessors": accessors, "bufferViews": views, **more}
    text = json.dumps(held | {"buffers": [{"byteLength": 64}]}).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 64, b"BIN\0") + bytes(64)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


POINTS = {"componentType": 5126, "type": "VEC3"}
INDICES = {"componentType": 5125, "type": "SCALAR"}
TEN_GB = [{**POINTS, "count": 900_000_000}, {**INDICES, "count": 900_000_000}]

HOSTILE = {
    "ten_gb.glb": (glb(TEN_GB, []), "accessor 0: is cut short or damaged: claims 900000000 of VEC3"),
    "ten_gb_view.glb": (
        glb([x | {"bufferView": 0} for x in TEN_GB], [{"buffer": 0, "byteLength": 1 << 34}]),
        "accessor 0",
    ),
    "no_view.glb": (glb([POINTS | {"count": 1, "bufferView": 9}], []), "accessor 0: is not as glTF has it"),
    "packed.glb": (glb([], [], extensionsRequired=["KHR_draco_mesh_compression"]), "is compressed with KHR_draco"),
    "no_json.glb": (
        b"glTF" + struct.pack("<III4s", 2, 40, 20, b"JSON") + b"[1, 2, 3".ljust(20),
        "cannot be read as GLB",
    ),
    "mixed.ply": (ply(face(0, 1, 2), face(0, 1, 2, 3), face(2, 3, 4)), "cut short, or its faces differ|faces must be"),
    "other.ply": (ply(face(0, 1, 2), face(0, 1, 2, 3), face(2, 3)), "face 1: vertex_indices has 4 values, 3 in face 0"),
    "long.ply": (ply(struct.pack("<I3i", 1 << 31, 0, 1, 2), count="uint"), "cut short, or its faces differ"),
    "pairs.ply": (
        ply(face(0, 1), face(1, 2), face(2, 3), face(3, 4)),
        "is cut short: its head claims 5 vertex, 4 face",
    ),
    "claim.ply": (text_ply("3 0 1 2", "1000000000 0 1 2"), "face 1: claims 1000000000 corners, 3 numbers follow"),
    "edge.ply": (text_ply("3 0 1 2", "2 0 1"), "face 1: claims 2 corners"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_lies_are_refused_in_little_memory(name: str, tmp_path: Path) -> None:
    content, message = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message) as caught:
            load_scan(tmp_path / name, None)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    assert name in caught.value.where and caught.value.remedy and "\n" not in str(caught.value)


def test_polygons_are_split_and_none_is_lost(tmp_path: Path) -> None:
    (tmp_path / "quads.ply").write_bytes(ply(face(0, 1, 2, 3), face(1, 4, 2, 0)))
    (tmp_path / "mixed.ply").write_bytes(text_ply("3 0 1 2", "4 0 2 3 4"))
    assert load_scan(tmp_path / "quads.ply").report.triangles_read == 4
    assert load_scan(tmp_path / "mixed.ply").report.triangles_read == 3


def test_a_large_file_is_refused_unread_and_a_pipe_is_no_file(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as stream:
        stream.truncate(10 << 30)  # a hole: nothing is on the disk
    with pytest.raises(InputError, match=r"has 10\.0 GB, more than is read"):
        load_scan(tmp_path / "large.stl")
    os.mkfifo(tmp_path / "pipe.stl")
    with pytest.raises(InputError, match="is no file"):
        load_scan(tmp_path / "pipe.stl")


def test_parts_without_faces_are_left_out_aloud(tmp_path: Path) -> None:
    scene = trimesh.Scene([trimesh.creation.icosphere(subdivisions=1), trimesh.PointCloud(np.eye(3))])
    scene.export(tmp_path / "both.glb")
    report = load_scan(tmp_path / "both.glb", "mm").report
    assert report.triangles == 80
    assert any("parts of 3 points without faces" in note for note in report.notes)


@pytest.mark.parametrize("where", [1e30, -3e38, 1e300])
def test_coordinates_far_beyond_any_scan_are_refused(where: float) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [where, 0, 0]])
    with pytest.raises(InputError, match=r"vertex 3: lies .* mm from the origin"):
        scan_from_arrays(vertices, np.array([[0, 1, 2], [0, 1, 3]]))


def test_a_far_vertex_is_refused_unparsed_where_a_face_needs_it(tmp_path: Path) -> None:
    """Of STL and binary PLY: importing the parser takes longer than all else. The vertex has the parser's number."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, -1e30, 0], [0, 1, 0], [np.nan, 0, 0]], "<f4")
    whole, broken = [[0, 3, 1], [0, 1, 2]], [[0, 3, 1], [4, 1, 2]]

    def write(faces: list[list[int]]) -> list[Path]:
        facets = np.zeros(2, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
        facets["corners"] = points[np.array(faces)]
        head = (HEAD.format("binary_little_endian", 5) + FACES.format(2, "uchar")).encode()
        (tmp_path / "far.stl").write_bytes(bytes(80) + struct.pack("<I", 2) + facets.tobytes())
        (tmp_path / "far.ply").write_bytes(head + points.tobytes() + b"".join(face(*corners) for corners in faces))
        return [tmp_path / "far.stl", tmp_path / "far.ply"]

    for path, vertex in zip(write(whole), (5, 2), strict=True):
        with pytest.raises(InputError, match=rf"vertex {vertex}: lies 1e\+30 from the origin, too far in any unit"):
            check_mesh_file(path)
        vertices: Any = trimesh.load(path, process=False)
        assert np.abs(vertices.vertices[vertex]).max() > 9e29
    for path in write(broken):
        assert check_mesh_file(path).path == path
        assert load_scan(path, "mm").triangles == 1


def test_a_stray_vertex_is_named_and_a_distant_part_is_not_one() -> None:
    """Beside a vertex at 4 km a crop of millimetres would count as flat, and be mended by what reaches to the stray."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    vertices = np.vstack([ball.vertices + [1e5, 0, 0], [[2.8e6, 0, 0]]])
    faces = np.vstack([ball.faces, [[0, 1, len(vertices) - 1]]])
    with pytest.raises(InputError, match=rf"vertex {len(vertices) - 1}: lies 2.7e\+06 mm from the middle of the scan"):
        scan_from_arrays(vertices, faces)
    speck = trimesh.creation.icosphere(subdivisions=0, radius=0.1)
    both = np.vstack([ball.vertices, speck.vertices + [900.0, 0, 0]])
    scan = scan_from_arrays(both, np.vstack([ball.faces, speck.faces + len(ball.vertices)]))
    assert scan.triangles == len(ball.faces) + len(speck.faces)


def test_one_triangle_and_very_many_loose_ones(tmp_path: Path) -> None:
    one = scan_from_arrays(np.eye(3), np.array([[0, 1, 2]]))
    assert (one.triangles, one.report.components) == (1, 1)
    rng = np.random.default_rng(0)
    corners = rng.uniform(-100, 100, (20_000, 1, 3)) + rng.uniform(-0.1, 0.1, (20_000, 3, 3))
    loose = scan_from_arrays(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3))
    assert loose.triangles == 20_000 and loose.report.components > 19_990
