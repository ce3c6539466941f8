"""Scene files: TOML that names the scans of a scene and where they lie.

name = "lower jaw"

[[part]]
name = "teeth"
scan = "teeth.stl"            # beside this file; or a GLB, and `node` names one of its nodes
unit = "mm"                   # where the file does not say it
position_mm = [0.0, 0.0, 4.0]
orientation = [1.0, 0.0, 0.0, 0.0]   # unit quaternion w, x, y, z: first turned, then moved
material = { stiffness_n_mm = 2.0 }  # or `materials`, a material map
hidden = false                # whether the scene begins without it
least_triangles = 100         # bounds on what a level may show of it
most_triangles = 20000

[[nodes]]                     # every node of a GLB that carries a mesh becomes a part of the node's name
scan = "gingiva.glb"
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from hapticlod.errors import InputError
from hapticlod.material_map import Properties, load_materials
from hapticlod.scan import Scan, load_scan, scan_from_arrays
from hapticlod.scan_unit import UNITS_MM
from hapticlod.scene import MAX_PARTS, Part, Scene, make_scene, placed
from hapticlod.scene_nodes import read_nodes
from hapticlod.toml import TomlModel, fault_at, load_toml
from hapticlod.toml_places import key_places

Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
_UNIT_LENGTH = 1e-3  # how far a quaternion's length may be from 1


class Placement(TomlModel):
    """What parts and nodes have in common."""

    scan: str = Field(min_length=1, description="file, relative to the scene file")
    unit: str | None = None
    position_mm: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    material: Properties | None = None
    hidden: bool = False
    least_triangles: int = Field(default=100, ge=1)
    most_triangles: int | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _possible(self) -> Placement:
        length = float(np.linalg.norm(self.orientation))
        if abs(length - 1.0) > _UNIT_LENGTH:
            raise fault_at(
                "orientation", f"is no rotation: a unit quaternion w, x, y, z has length 1, not {length:.4g}"
            )
        if self.unit is not None and self.unit not in UNITS_MM:
            raise fault_at("unit", f"{self.unit!r} is none of {', '.join(UNITS_MM)}")
        if self.most_triangles is not None and self.most_triangles < self.least_triangles:
            raise fault_at("most_triangles", "must not be less than least_triangles")
        return self


class PartEntry(Placement):
    """One part."""

    name: str = Field(min_length=1, max_length=63)
    node: str | None = Field(default=None, description="of a GLB: the node that carries the part's mesh")
    materials: str | None = Field(default=None, description="material map, relative to the scene file")

    @model_validator(mode="after")
    def _named(self) -> PartEntry:
        if len(self.name.encode()) > 63 or not self.name.isprintable() or self.name != self.name.strip():
            raise fault_at("name", "must be 1 to 63 bytes of printable text without space around it")
        if self.material is not None and self.materials is not None:
            raise fault_at("materials", "give material or materials, not both")
        if self.node is not None and not self.scan.lower().endswith(".glb"):
            raise fault_at("node", "belongs to a GLB")
        return self


class NodesEntry(Placement):
    """All nodes of a GLB."""

    @model_validator(mode="after")
    def _is_glb(self) -> NodesEntry:
        if not self.scan.lower().endswith(".glb"):
            raise fault_at("scan", "must be a GLB: other files have no nodes")
        return self


class SceneFile(TomlModel):
    """A scene as it stands in its file."""

    name: str = ""
    part: tuple[PartEntry, ...] = Field(default=(), max_length=MAX_PARTS)
    nodes: tuple[NodesEntry, ...] = ()

    @model_validator(mode="after")
    def _told_apart(self) -> SceneFile:
        if not self.part and not self.nodes:
            raise fault_at("part", "no part is given: give at least one [[part]] or [[nodes]]")
        seen: set[str] = set()
        for number, entry in enumerate(self.part):
            if entry.name in seen:
                raise fault_at(f"part.{number}.name", f"{entry.name!r} names another part already")
            seen.add(entry.name)
        return self


def load_scene(path: str | os.PathLike[str], unit: str | None = None, *, strict: bool = False) -> Scene:
    """Read a scene file and all scans in it.

    Args:
        path: the TOML file. unit: of scans that neither the scene file nor they themselves give a unit.
        strict: refuse scans that need repair instead of mending them.

    Raises:
        InputError: names the file, line and field, or the scan, that cannot be used.
    """
    path = Path(path)
    held = load_toml(path, SceneFile)
    _check_files(path, held)
    parts: list[Part] = []
    for entry in held.part:
        scan = _scan_of(path, entry, unit, strict)
        parts.append(_part(entry, entry.name, scan, path))
    for entry in held.nodes:
        for name, vertices, faces in read_nodes(path.parent / entry.scan):
            scale = UNITS_MM[entry.unit] if entry.unit else 1000.0  # glTF is in metres
            scan = scan_from_arrays(vertices * scale, faces, name, strict=strict)
            parts.append(_part(entry, name, scan, path))
    return make_scene(parts, held.name or path.stem, os.fspath(path))


def _check_files(path: Path, held: SceneFile) -> None:
    """Before anything is read, which may take minutes: whether all files are there."""
    places = key_places(path.read_text(encoding="utf-8").replace("\r\n", "\n"))
    for table, entries in (("part", held.part), ("nodes", held.nodes)):
        for number, entry in enumerate(entries):
            for key in ("scan", "materials"):
                name = getattr(entry, key, None)
                if name is None or (path.parent / name).is_file():
                    continue
                line, column = places[table, number, key]
                what = f"{table}.{number}.{key}: there is no file {path.parent / name}"
                raise InputError(f"{path}:{line}:{column}", what, "correct the path; it is relative to the scene file")


def _scan_of(path: Path, entry: PartEntry, unit: str | None, strict: bool) -> Scan:
    source = path.parent / entry.scan
    if entry.node is None:
        return load_scan(source, entry.unit or unit, strict=strict)
    nodes = {name: (vertices, faces) for name, vertices, faces in read_nodes(source)}
    if entry.node not in nodes:
        raise InputError(
            os.fspath(source), f"has no node {entry.node!r} with a mesh", f"name one of {', '.join(nodes)}"
        )
    vertices, faces = nodes[entry.node]
    scale = UNITS_MM[entry.unit] if entry.unit else 1000.0
    return scan_from_arrays(vertices * scale, faces, entry.name, strict=strict)


def _part(entry: PartEntry | NodesEntry, name: str, scan: Scan, path: Path) -> Part:
    if entry.material is not None:
        scan = scan.with_materials(np.tile(np.array(entry.material.row), (scan.triangles, 1)))
    elif isinstance(entry, PartEntry) and entry.materials is not None:
        scan = load_materials(path.parent / entry.materials).applied(scan)
    moved = placed(scan, entry.position_mm, entry.orientation)
    return Part(
        name, moved, entry.position_mm, entry.orientation, entry.hidden, entry.least_triangles, entry.most_triangles
    )
