"""Read the triangles of a mesh file. A header's counts are checked against the file before a parser believes them."""

from __future__ import annotations

import io
import logging
import os
import struct
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hapticlod.errors import InputError
from hapticlod.far_vertices import check_facets
from hapticlod.glb_header import check_glb
from hapticlod.ply_header import check_ply
from hapticlod.scan_attributes import corner_colours, face_materials
from hapticlod.scan_unit import Unit, unit_of_3mf, unit_of_file

_EXPORT_AGAIN = "export or copy the file again"
_SMALLER = "reduce the scan in the program that made it, or export it as binary STL or PLY"
_STL_HEAD, _STL_FACET = 84, 50  # bytes: 80 of comment and a uint32 count; 12 floats and 2 bytes of attributes
# Bytes of the largest file that is read: 80 million triangles as binary STL, 15 million as text. What a 3MF archive
# unpacks to is read as text, which takes several times its length in memory.
_MOST_BYTES, _MOST_UNPACKED = 4 << 30, 1 << 30
_ARCHIVES = {b"PK\x03\x04": "zip", b"\x1f\x8b\x08": "gzip", b"7z\xbc\xaf": "7z", b"Rar!": "rar", b"BZh": "bzip2"}


@dataclass(frozen=True, eq=False)
class FileMesh:
    """What a file holds, uncleaned.

    Attributes:
        vertices: (n, 3) float64 in the file's unit. faces: (m, 3) int64, every index in 0..n-1.
        materials: (m, 3) of `hapticlod.material`, or None. colours: (m, 3, 3) uint8 per corner of each face, or None.
        unit: what the file says of it, or None. notes: what was left out, one sentence each.
    """

    vertices: np.ndarray
    faces: np.ndarray
    materials: np.ndarray | None = None
    colours: np.ndarray | None = None
    unit: Unit | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class CheckedFile:
    """The bytes of a file that may well be what its ending says, and that ending."""

    path: Path
    data: bytes
    kind: str


def read_mesh(file: Path | CheckedFile) -> FileMesh:
    """Read STL (binary or ASCII), PLY, OBJ, OFF, GLB or 3MF; several bodies are joined, node poses applied.

    Args:
        file: its ending names the format.

    Raises:
        InputError: missing, empty, cut short, not the format it claims, no faces, an index out of range, or a material
            that cannot be.
    """
    checked = file if isinstance(file, CheckedFile) else check_mesh_file(file)
    where, data, kind = os.fspath(checked.path), checked.data, checked.kind
    bodies = _bodies(data, kind, where)
    if not bodies:
        raise InputError(where, "holds no triangles", "export a surface with faces")
    sizes = np.cumsum([0] + [len(body.vertices) for body in bodies])
    colours = [body.colours for body in bodies if body.colours is not None]
    return FileMesh(
        np.concatenate([body.vertices for body in bodies]),
        np.concatenate([body.faces + sizes[i] for i, body in enumerate(bodies)]),
        bodies[0].materials if len(bodies) == 1 else None,  # only PLY has any, and it is one body
        np.concatenate(colours) if len(colours) == len(bodies) else None,
        bodies[0].unit or unit_of_file(data, kind),
        tuple(note for body in bodies for note in body.notes),
    )


def check_mesh_file(path: Path) -> CheckedFile:
    """Read a file, fast. Raises InputError where `read_mesh` would refuse it for what is seen without parsing it."""
    where = os.fspath(path)
    kind = path.suffix.lower().lstrip(".")
    data = _read_bytes(path, kind)
    if kind == "stl":
        data = _check_stl(data, where)
    elif kind == "ply":
        check_ply(data, where)
    elif kind == "obj":
        data = _as_utf8(data, kind, where)
    elif kind == "off":
        data = _check_off(_as_utf8(data, kind, where), where)
    elif kind == "3mf":
        _check_3mf(data, where)
    else:
        check_glb(data, where)
    return CheckedFile(path, data, kind)


def check_indices(faces: np.ndarray, vertex_count: int, where: str) -> None:
    """Raise InputError naming the first face that refers to a vertex that is not there."""
    bad = (faces < 0) | (faces >= vertex_count)
    if bad.any():
        face = int(np.flatnonzero(bad[:, 0] | bad[:, 1] | bad[:, 2])[0])
        index = int(faces[face][bad[face]][0])
        raise InputError(
            f"{where}, face {face}",
            f"refers to vertex {index}, but the vertices are 0 to {vertex_count - 1}",
            "delete that face or export the scan again",
        )


def _read_bytes(path: Path, kind: str) -> bytes:
    where = os.fspath(path)
    if path.is_dir():
        raise InputError(where, "is a folder", "name the mesh file in it")
    if not path.exists():
        raise InputError(where, "does not exist", "check the path")
    if not path.is_file():
        raise InputError(where, "is no file", "give a mesh file")
    if kind in ("zip", "gz", "7z", "rar", "bz2", "tar", "tgz", "xz"):
        raise InputError(where, "is an archive", "unpack it and give the mesh file in it")
    if kind not in ("stl", "ply", "obj", "off", "glb", "3mf"):
        ending = f"the ending .{kind}" if kind else "a name without an ending"
        raise InputError(where, f"{ending} is no known mesh format", "give STL, PLY, OBJ, OFF, GLB or 3MF")
    try:
        if (size := path.stat().st_size) > _MOST_BYTES:
            raise InputError(where, f"has {size / 2**30:.1f} GB, more than is read ({_MOST_BYTES >> 30} GB)", _SMALLER)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(where, f"cannot be read ({error.strerror})", "check the permissions of the file") from error
    if not data:
        raise InputError(where, "is empty (0 bytes)", _EXPORT_AGAIN)
    packed = next((name for magic, name in _ARCHIVES.items() if data.startswith(magic)), None)
    if packed is not None and kind != "3mf":
        raise InputError(where, f"is a {packed} archive", "unpack it and give the mesh file in it")
    return data


def _check_stl(data: bytes, where: str) -> bytes:
    """Tell binary from ASCII by length, not by the word "solid", which binary files carry too."""
    if len(data) >= _STL_HEAD:
        count = struct.unpack_from("<I", data, 80)[0]
        length = _STL_HEAD + _STL_FACET * count
        if count > 0 and len(data) == length:
            check_facets(data, where)
            return data
    text = data[:1024].lower()
    if text.lstrip().startswith(b"solid") and b"\0" not in data[:65536] and (b"facet" in text or len(data) < 1024):
        return _check_ascii_stl(data, where)
    if len(data) < _STL_HEAD:
        raise InputError(where, f"has only {len(data)} bytes, fewer than the head of an STL file", _EXPORT_AGAIN)
    whole = (len(data) - _STL_HEAD) // _STL_FACET
    if count == whole == 0:
        raise InputError(where, "holds no triangles", "export a surface with faces")
    if count != whole:
        claim = f"its head claims {count} triangles ({length} bytes), it holds {whole}"
        raise InputError(where, f"is {'cut short' if count > whole else 'damaged'}: {claim}", _EXPORT_AGAIN)
    check_facets(data, where)
    return data[:length]  # a few bytes of padding after the last triangle


def _check_ascii_stl(data: bytes, where: str) -> bytes:
    text = data.lower()
    facets, ends, corners = (text.count(word) for word in (b"facet normal", b"endfacet", b"vertex"))
    if facets != ends or corners != 3 * facets or b"endsolid" not in text[-4096:]:
        raise InputError(
            where, f"is cut short or damaged: {facets} facets begin, {ends} end, {corners} vertices", _EXPORT_AGAIN
        )
    return _as_utf8(data, "stl", where)


def _check_off(data: bytes, where: str) -> bytes:
    lines = [line for line in data.split(b"\n") if line.strip() and not line.lstrip().startswith(b"#")]
    words = b" ".join(lines[:2]).upper().split()
    try:
        if words[0] not in (b"OFF", b"COFF"):
            raise ValueError(words[0])
        vertices, faces = int(words[1]), int(words[2])
    except (IndexError, ValueError) as error:
        raise InputError(where, "does not start with OFF and its counts", "give the file its true ending") from error
    rows = len(lines) - (1 if len(lines[0].split()) > 1 else 2)
    if min(vertices, faces) < 0 or rows != vertices + faces:
        claim = f"its head claims {vertices} vertices and {faces} faces, {rows} lines follow"
        raise InputError(where, f"is cut short or damaged: {claim}", _EXPORT_AGAIN)
    return data


def _check_3mf(data: bytes, where: str) -> None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
    except zipfile.BadZipFile as error:
        raise InputError(where, "is no 3MF archive, or cut short", _EXPORT_AGAIN) from error
    if unpacked > _MOST_UNPACKED:
        raise InputError(where, f"claims to unpack to {unpacked / 2**30:.0f} GB", "save it as binary STL or PLY")


def _as_utf8(data: bytes, kind: str, where: str) -> bytes:
    if b"\0" in data[:65536]:
        raise InputError(where, f"holds binary data, but {kind.upper()} is text", "give the file its true ending")
    try:
        data.decode("utf-8")
        return data
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")  # a comment in an old encoding; numbers are the same


def _bodies(data: bytes, kind: str, where: str) -> list[FileMesh]:
    import trimesh  # slow to import, and only needed here

    try:
        with _quiet():
            # process=False: trimesh would weld by its own rule and drop faces without a word.
            scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, skip_materials=True)
            nodes = [scene.graph[node] for node in scene.graph.nodes_geometry]
            parts = [(scene.geometry[name], np.asarray(pose, dtype=np.float64)) for pose, name in nodes]
            said = unit_of_3mf(str(scene.units or "mm")) if kind == "3mf" else None
    except MemoryError as error:
        raise InputError(where, "needs more memory than there is", "use a smaller scan") from error
    except Exception as error:  # the parsers raise whatever their code meets
        # Text that is not UTF-8 sends the parser looking for a package that guesses encodings.
        reason = "text is damaged" if isinstance(error, ImportError) else " ".join(str(error).split())[:200]
        raise InputError(
            where, f"cannot be read as {kind.upper()} ({type(error).__name__}: {reason})", _EXPORT_AGAIN
        ) from error
    points = 0
    bodies = []
    for part, pose in parts:
        vertices = np.asarray(part.vertices, dtype=np.float64)
        faces = np.asarray(getattr(part, "faces", ()), dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.size == 0:
            points += len(vertices)
            continue
        if not np.array_equal(pose, np.eye(4)):
            vertices = vertices @ pose[:3, :3].T + pose[:3, 3]
            if np.linalg.det(pose[:3, :3]) < 0.0:
                faces = faces[:, ::-1]
        check_indices(faces, len(vertices), where)
        materials, colours = face_materials(part, len(faces), where), corner_colours(part, faces)
        bodies.append(FileMesh(vertices, faces, materials, colours, said))
    if points and not bodies:
        raise InputError(where, f"is a point cloud ({points} points, no faces)", "mesh it first, then give the surface")
    if points:
        note = f"parts of {points} points without faces (lines or point clouds) were left out"
        bodies[0] = replace(bodies[0], notes=(note,))
    return bodies


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the parser's warnings and log lines off the user's terminal; what matters is checked here."""
    log = logging.getLogger("trimesh")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)
