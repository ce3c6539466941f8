"""A scan: one clean triangle mesh in mm, with the report of what cleaning found."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hapticlod.box import bounding_box, box_diagonal
from hapticlod.errors import InputError
from hapticlod.material import check_materials, vertex_means
from hapticlod.repair_report import Count, RepairReport
from hapticlod.scan_file import CheckedFile, FileMesh, check_indices, read_mesh
from hapticlod.scan_unit import UNITS_MM, guess_unit, named_unit

__all__ = ["Count", "RepairReport", "Scan", "load_scan", "scan_from_arrays"]

# Things that are touched with a hand-held tool are between a crown and a torso in size.
SMALLEST_EXTENT_MM, LARGEST_EXTENT_MM = 1.0, 5000.0


@dataclass(frozen=True, eq=False)
class Scan:
    """A cleaned triangle mesh.

    Attributes:
        vertices: (n, 3) float64 mm, each used by a face, along a space-filling curve.
        faces: (m, 3) int32, counter-clockwise seen from outside where the scan has an outside; same spatial order.
        report: what cleaning found and mended.
        name: short name for people. source: file name, or what made the scan. unit: the unit the source was in.
        face_materials: (m, 3) float64 of `hapticlod.material`, NaN where it is the station's; None: the scan has none.
        corner_colours: (m, 3, 3) uint8, red, green, blue per corner of each face; None where the file has no colours.
    """

    vertices: np.ndarray
    faces: np.ndarray
    report: RepairReport
    name: str
    source: str
    unit: str
    face_materials: np.ndarray | None = None
    corner_colours: np.ndarray | None = None

    @property
    def triangles(self) -> int:
        """Number of faces."""
        return len(self.faces)

    @cached_property
    def extent_mm(self) -> float:
        """Diagonal of the bounding box."""
        return box_diagonal(self.vertices)

    @cached_property
    def centre_mm(self) -> np.ndarray:
        """Centre (3,) of the bounding box."""
        low, high = bounding_box(self.vertices)
        return 0.5 * (high + low)

    @cached_property
    def digest(self) -> str:
        """BLAKE2b (256 bits, hex) of vertices, faces and materials: scans that feel alike have equal digests."""
        digest = hashlib.blake2b(digest_size=32)
        digest.update(np.ascontiguousarray(self.vertices, dtype="<f8").data)
        digest.update(np.ascontiguousarray(self.faces, dtype="<i4").data)
        if self.face_materials is not None:
            digest.update(np.ascontiguousarray(np.nan_to_num(self.face_materials, nan=-1.0), dtype="<f8").data)
        return digest.hexdigest()

    @cached_property
    def vertex_materials(self) -> np.ndarray | None:
        """(n, 3) materials of the vertices: the mean of the faces around each, by area."""
        if self.face_materials is None:
            return None
        return vertex_means(self.vertices, self.faces, self.face_materials)

    def with_materials(self, face_materials: np.ndarray) -> Scan:
        """A copy with other materials (m, 3). Raises InputError where a value cannot be."""
        made = check_materials(face_materials, self.triangles, self.name)
        made.setflags(write=False)
        return replace(self, face_materials=None if np.isnan(made).all() else made)


def load_scan(path: str | os.PathLike[str] | CheckedFile, unit: str | None = "mm", *, strict: bool = False) -> Scan:
    """Load and clean a scan.

    Args:
        path: STL (binary or ASCII), PLY, OBJ, OFF, GLB or 3MF; or what `check_mesh_file` read of one.
        unit: unit of the file's numbers: mm, cm, m, um or in (inches). None: what the file says (glTF: metres; 3MF; a
            comment of OBJ, PLY or STL), else a guess from its size; the report says which and what it rests on.
        strict: refuse instead of repairing; sharing equal vertices is no repair.

    Returns:
        The scan in mm. Its vertices are vertices of the file, scaled in float64, without any other change. The faces of
        a PLY file may have the properties `stiffness_n_mm` (or `stiffness`, in N/mm too), `friction_static` and
        `friction_dynamic`: these become its materials.

    Raises:
        InputError: the file cannot be used, the unit is unknown, or it needs repair and `strict` is set.
    """
    asked = None if unit is None else named_unit(unit)
    file = path if isinstance(path, CheckedFile) else Path(path)
    held = read_mesh(file)
    path = file.path if isinstance(file, CheckedFile) else file
    taken = asked or held.unit or guess_unit(held.vertices, held.faces)
    held = replace(held, vertices=held.vertices * taken.mm)
    scan = _make(held, os.fspath(path), path.stem, path.name, taken.name, strict)
    notes = scan.report.notes + held.notes
    if asked is None:
        notes += (taken.why,)
    elif held.unit is not None and held.unit.name != asked.name:
        notes += (f"{held.unit.why}; this one was read in {asked.name}",)
    return replace(scan, report=replace(scan.report, notes=notes)) if notes else scan


def scan_from_arrays(
    vertices: np.ndarray,
    faces: np.ndarray,
    name: str = "mesh",
    *,
    strict: bool = False,
    face_materials: np.ndarray | None = None,
) -> Scan:
    """Clean a mesh given as arrays, like `load_scan`: the order of its vertices and faces changes.

    Args:
        vertices: (n, 3) mm. faces: (m, 3) integers in 0..n-1. name: for messages and reports.
        face_materials: (m, 3) stiffness N/mm, static and dynamic friction per face; NaN: the station's.

    Raises:
        InputError: wrong shapes, an index out of range, an impossible material, or nothing usable.
    """
    points = np.asarray(vertices, dtype=np.float64)
    corners = np.asarray(faces)
    for what, array in (("vertices", points), ("faces", corners)):
        if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
            raise InputError(name, f"{what} have shape {array.shape}", f"give {what} of shape (count, 3)")
    if corners.dtype.kind not in "iu":
        raise InputError(name, f"faces are of type {corners.dtype}", "give integer indices")
    check_indices(corners, len(points), name)
    materials = None if face_materials is None else check_materials(face_materials, len(corners), name)
    return _make(FileMesh(points, corners.astype(np.int64), materials), name, name, "arrays", "mm", strict)


def _make(mesh: FileMesh, where: str, name: str, source: str, unit: str, strict: bool) -> Scan:
    from hapticlod.repair import clean  # scipy is slow to import: a file that cannot be read is refused at once

    vertices, faces, of_file, report = clean(mesh.vertices, mesh.faces, where)
    repaired = report.repaired()
    if strict and repaired:
        faults = ", ".join(f"{count} {fault.replace('_', ' ')}" for fault, count in repaired.items())
        raise InputError(where, f"needs repair ({faults})", "mend the scan, or load it without strict")
    colours = None if mesh.colours is None else mesh.colours[of_file]
    scan = Scan(vertices, faces, report, name, source, unit, corner_colours=colours)
    if mesh.materials is not None:
        scan = scan.with_materials(mesh.materials[of_file])
    vertices.setflags(write=False)
    faces.setflags(write=False)
    note = _size_note(scan.extent_mm, unit)
    return replace(scan, report=replace(report, notes=(note,))) if note else scan


def _size_note(extent_mm: float, unit: str) -> str | None:
    if SMALLEST_EXTENT_MM <= extent_mm <= LARGEST_EXTENT_MM:
        return None
    guesses = [
        f"{other} would make it {extent_mm / UNITS_MM[unit] * scale:.3g} mm"
        for other, scale in UNITS_MM.items()
        if SMALLEST_EXTENT_MM <= extent_mm / UNITS_MM[unit] * scale <= LARGEST_EXTENT_MM
    ]
    advice = f" ({'; '.join(guesses)})" if guesses else ""
    return f"extent {extent_mm:.3g} mm in unit {unit}: is the unit right?{advice}"
