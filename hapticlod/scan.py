"""A scan: one clean triangle mesh in mm, with the report of what cleaning found."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from hapticlod.errors import InputError
from hapticlod.repair import clean
from hapticlod.repair_report import Count, RepairReport
from hapticlod.scan_file import check_indices, read_mesh

__all__ = ["Count", "RepairReport", "Scan", "load_scan", "scan_from_arrays"]

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4}
_OTHER_NAMES = {"micron": "um", "µm": "um", "μm": "um", "inch": "in", "inches": "in", "metre": "m", "meter": "m"}
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
    """

    vertices: np.ndarray
    faces: np.ndarray
    report: RepairReport
    name: str
    source: str
    unit: str

    @property
    def triangles(self) -> int:
        """Number of faces."""
        return len(self.faces)

    @cached_property
    def extent_mm(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(self.vertices.max(axis=0) - self.vertices.min(axis=0)))

    @cached_property
    def centre_mm(self) -> np.ndarray:
        """Centre (3,) of the bounding box."""
        return 0.5 * (self.vertices.max(axis=0) + self.vertices.min(axis=0))

    @cached_property
    def digest(self) -> str:
        """BLAKE2b (256 bits, hex) of vertices and faces: equal meshes have equal digests."""
        digest = hashlib.blake2b(digest_size=32)
        digest.update(np.ascontiguousarray(self.vertices, dtype="<f8").data)
        digest.update(np.ascontiguousarray(self.faces, dtype="<i4").data)
        return digest.hexdigest()


def load_scan(path: str | os.PathLike[str], unit: str = "mm", *, strict: bool = False) -> Scan:
    """Load and clean a scan.

    Args:
        path: STL (binary or ASCII), PLY, OBJ, OFF or GLB.
        unit: unit of the file's numbers: mm, cm, m, um or in (inches).
        strict: refuse instead of repairing; sharing equal vertices is no repair.

    Returns:
        The scan in mm. Its vertices are vertices of the file, scaled in float64, without any other change.

    Raises:
        InputError: the file cannot be used, the unit is unknown, or it needs repair and `strict` is set.
    """
    path = Path(path)
    name, scale = _unit_mm(unit)
    vertices, faces = read_mesh(path)
    scan = _make(vertices * scale, faces, os.fspath(path), path.stem, path.name, name, strict)
    notes = scan.report.notes
    if path.suffix.lower() == ".glb" and name != "m":
        notes += (f"glTF files are in metres by their standard; this one was read in {name}",)
    return replace(scan, report=replace(scan.report, notes=notes)) if notes else scan


def scan_from_arrays(vertices: np.ndarray, faces: np.ndarray, name: str = "mesh", *, strict: bool = False) -> Scan:
    """Clean a mesh given as arrays, like `load_scan`: the order of its vertices and faces changes.

    Args:
        vertices: (n, 3) mm. faces: (m, 3) integers in 0..n-1. name: for messages and reports.

    Raises:
        InputError: wrong shapes, an index out of range, or nothing usable.
    """
    points = np.asarray(vertices, dtype=np.float64)
    corners = np.asarray(faces)
    for what, array in (("vertices", points), ("faces", corners)):
        if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
            raise InputError(name, f"{what} have shape {array.shape}", f"give {what} of shape (count, 3)")
    if corners.dtype.kind not in "iu":
        raise InputError(name, f"faces are of type {corners.dtype}", "give integer indices")
    check_indices(corners, len(points), name)
    return _make(points, corners.astype(np.int64), name, name, "arrays", "mm", strict)


def _make(vertices: np.ndarray, faces: np.ndarray, where: str, name: str, source: str, unit: str, strict: bool) -> Scan:
    vertices, faces, report = clean(vertices, faces, where)
    repaired = report.repaired()
    if strict and repaired:
        faults = ", ".join(f"{count} {fault.replace('_', ' ')}" for fault, count in repaired.items())
        raise InputError(where, f"needs repair ({faults})", "mend the scan, or load it without strict")
    scan = Scan(vertices, faces, report, name, source, unit)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    note = _size_note(scan.extent_mm, unit)
    return replace(scan, report=replace(report, notes=(note,))) if note else scan


def _unit_mm(unit: str) -> tuple[str, float]:
    name = _OTHER_NAMES.get(unit.strip().lower(), unit.strip().lower())
    if name not in UNITS_MM:
        raise InputError(f"unit {unit!r}", "is unknown", f"give one of {', '.join(UNITS_MM)}")
    return name, UNITS_MM[name]


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
