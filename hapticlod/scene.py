"""A scene: several scans as parts, each in its place, touched by one loop. To the tuner it is one scan."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from hapticlod.errors import InputError
from hapticlod.repair_report import Count, RepairReport
from hapticlod.scan import Scan

MAX_PARTS = 64
"""One bit each; runtime/core/scene.hpp has the same number."""


@dataclass(frozen=True, eq=False)
class Part:
    """One scan of a scene.

    Attributes:
        name: unlike any other part's; what the station's operator says to hide or show it.
        scan: cleaned, and already where the part lies.
        position_mm, orientation: where that is: (3,) mm, and a unit quaternion w, x, y, z (4,). They are kept for
            people; `scan` has been moved.
        hidden: whether the scene begins without it.
        least_triangles, most_triangles: bounds of its own on what a level may show of it.
    """

    name: str
    scan: Scan
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    hidden: bool = False
    least_triangles: int = 100
    most_triangles: int | None = None

    @property
    def finest(self) -> int:
        """Triangles of its finest level."""
        return min(self.scan.triangles, self.most_triangles or self.scan.triangles)

    def triangles_at(self, share: float) -> int:
        """How many triangles it shows where the scene shows this share of all."""
        least = min(self.least_triangles, self.finest)
        return int(min(max(round(share * self.scan.triangles), least), self.finest))


@dataclass(frozen=True, eq=False)
class Scene(Scan):
    """All parts as one scan: vertices and faces one part after the other, nothing welded across parts."""

    parts: tuple[Part, ...] = field(default=())

    @cached_property
    def digest(self) -> str:
        """Of what is felt and of how it may be simplified; names and what is hidden at first are not in it."""
        digest = hashlib.blake2b(digest_size=32)
        for part in self.parts:
            digest.update(f"{part.scan.digest} {part.least_triangles} {part.most_triangles}\n".encode())
        return digest.hexdigest()

    @cached_property
    def vertex_materials(self) -> np.ndarray | None:
        """(n, 3) materials of the vertices, NaN where a part has none."""
        if self.face_materials is None:
            return None
        empty = [np.full((len(part.scan.vertices), 3), np.nan) for part in self.parts]
        held = [part.scan.vertex_materials for part in self.parts]
        return np.concatenate([e if h is None else h for e, h in zip(empty, held, strict=True)])


def make_scene(parts: Sequence[Part], name: str, source: str) -> Scene:
    """A scene of 1 to 64 parts with different names.

    Raises:
        InputError: too many parts, none, or two of one name.
    """
    if not 1 <= len(parts) <= MAX_PARTS:
        raise InputError(source, f"has {len(parts)} parts", f"give 1 to {MAX_PARTS}")
    names = [part.name for part in parts]
    for twice in sorted({n for n in names if names.count(n) > 1}):
        raise InputError(source, f"has two parts named {twice!r}", "give each part a name of its own")
    first = np.cumsum([0] + [len(part.scan.vertices) for part in parts])
    materials = None
    if any(part.scan.face_materials is not None for part in parts):
        none = [np.full((part.scan.triangles, 3), np.nan) for part in parts]
        held = [part.scan.face_materials for part in parts]
        materials = np.concatenate([n if h is None else h for n, h in zip(none, held, strict=True)])
    vertices = np.concatenate([part.scan.vertices for part in parts])
    faces = np.concatenate([part.scan.faces + first[i] for i, part in enumerate(parts)]).astype(np.int32)
    for array in (vertices, faces):
        array.setflags(write=False)
    return Scene(vertices, faces, _report(parts), name, source, "mm", face_materials=materials, parts=tuple(parts))


def _report(parts: Sequence[Part]) -> RepairReport:
    """The sums of all parts' reports; notes say whose they are."""
    reports = [part.scan.report for part in parts]

    def summed(name: str) -> object:
        values = [getattr(report, name) for report in reports]
        if isinstance(values[0], Count):
            return Count(sum(v.found for v in values), sum(v.fixed for v in values))
        return max(values) if name == "weld_tolerance_mm" else sum(values)

    notes = tuple(f"{part.name}: {note}" for part in parts for note in part.scan.report.notes)
    sums = {f.name: summed(f.name) for f in fields(RepairReport) if f.name != "notes"}
    return RepairReport(**sums, notes=notes)  # type: ignore[arg-type]


def placed(scan: Scan, position_mm: Sequence[float], orientation: Sequence[float]) -> Scan:
    """A scan turned by a unit quaternion (w, x, y, z) about its own origin, then moved (mm)."""
    if tuple(position_mm) == (0.0, 0.0, 0.0) and tuple(orientation) == (1.0, 0.0, 0.0, 0.0):
        return scan
    vertices = scan.vertices @ rotation_matrix(orientation).T + np.asarray(position_mm, dtype=np.float64)
    vertices.setflags(write=False)
    return replace(scan, vertices=vertices)


def rotation_matrix(orientation: Sequence[float]) -> np.ndarray:
    """(3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = np.asarray(orientation, dtype=np.float64) / np.linalg.norm(orientation)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
