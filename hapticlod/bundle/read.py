"""Reads a bundle: checked as the runtime checks it, its arrays left in the file (numpy memory map)."""

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hapticlod.bundle import content
from hapticlod.bundle.format import (
    ACCELERATION,
    ELEMENT,
    ENTRY_DTYPE,
    HEADER_DTYPE,
    LEVEL_SECTIONS,
    MAX_MANIFEST_BYTES,
    MAX_MANIFEST_DEPTH,
    SectionType,
    depth,
)
from hapticlod.bundle.parts import StoredPart, parts_fault, stored_parts
from hapticlod.bundle.structure import Section, read_sections
from hapticlod.errors import InputError
from hapticlod.motion import Motion
from hapticlod.signature import signature_fault
from hapticlod.tool import Tool

WRITE_AGAIN = "write the bundle again"


@dataclass(frozen=True, eq=False)
class BundleLevel:
    """One level. Arrays are read-only views into the file.

    Attributes:
        vertices: (n, 3) float32, mm relative to the config's origin.
        faces: (m, 3) uint32.
        cell_mm: edge of its voxels.
        acceleration: adjacency, normals, hash, table, bricks, cells, blocks; None where the bundle has them in a
            version that this program does not know (the runtime rebuilds them).
        materials: (n,) of `hapticlod.layout.MATERIAL_DTYPE`; None where everything is the station's.
    """

    vertices: np.ndarray
    faces: np.ndarray
    cell_mm: float
    acceleration: dict[str, np.ndarray] | None
    materials: np.ndarray | None = None

    @property
    def triangles(self) -> int:
        """Number of faces."""
        return len(self.faces)

    @property
    def bytes(self) -> int:
        """What the level takes in memory, as far as it is stored."""
        stored = [self.vertices, self.faces, *(self.acceleration or {}).values()]
        return sum(array.nbytes for array in stored) + (0 if self.materials is None else self.materials.nbytes)


@dataclass(frozen=True, eq=False)
class Bundle:
    """A checked bundle.

    Attributes:
        path: the file.
        file_bytes: its size.
        sections: the section table, in file order; unknown optional sections included.
        signer: public key (32 bytes) of who signed it, proved; None where it is unsigned, or signed in a way that this
            program does not know. Whether to trust that key is another question: `hapticlod.trust`.
        manifest: provenance, station, metrics.
        config: numpy scalar of `hapticlod.layout.CONFIG_DTYPE`.
        tool: named as in the manifest's `tool.name`, if it has one.
        levels: finest first; of a scene all levels of its first part, then of the next.
        parts: of a scene; none where the bundle holds one scan.
        golden_motion: and the (T,) RECORD_DTYPE rows that its replay gave, or None and None.
        golden_record: see `golden_motion`.
    """

    path: Path
    file_bytes: int
    sections: tuple[Section, ...]
    signer: bytes | None
    manifest: dict[str, Any]
    config: Any
    tool: Tool
    levels: tuple[BundleLevel, ...]
    golden_motion: Motion | None
    golden_record: np.ndarray | None
    parts: tuple[StoredPart, ...] = ()


def read_bundle(path: str | Path) -> Bundle:
    """Reads and checks a bundle: structure, digests, indices in range, finite numbers.

    Raises:
        InputError: the file is missing, cut short, damaged or too new; names file, section and remedy.
    """
    name = str(path)
    file = _mapped(Path(path))
    sections = read_sections(file, name)
    reader = _Reader(name, file, sections)
    signer = reader.signer()
    manifest = reader.manifest()
    config = reader.one(SectionType.CONFIG)
    reader.refuse("CONFIG", content.config_fault(config))
    count = int(config["level_count"])
    balls = reader.array(SectionType.TOOL)
    reader.refuse("TOOL", content.tool_fault(balls))
    if (config["balls"][:count] > len(balls)).any():
        reader.refuse("CONFIG", "a level uses more balls than the tool has")
    parts: tuple[StoredPart, ...] = ()
    meshes = [(int(config["triangles"][k]), float(config["cell_mm"][k])) for k in range(count)]
    if reader.has(SectionType.PARTS):
        rows = reader.array(SectionType.PARTS)
        reader.refuse("PARTS", parts_fault(rows, config))
        parts = stored_parts(rows)
        meshes = [mesh for part in parts for mesh in zip(part.triangles, part.cell_mm, strict=True)]
    stray = [s.name for s in sections if s.type in LEVEL_SECTIONS and s.level >= len(meshes)]
    if stray:
        owner = "part" if parts else "level of the config"
        raise InputError(name, f"{stray[0]} belongs to no {owner}", WRITE_AGAIN)
    levels = tuple(_level(reader, number, *mesh) for number, mesh in enumerate(meshes))
    _check_bounds(reader, levels)
    motion, record = _golden(reader, manifest, float(config["loop_hz"]), count)
    return Bundle(
        path=Path(path),
        file_bytes=len(file),
        sections=sections,
        signer=signer,
        manifest=manifest,
        config=config,
        tool=Tool(_name(manifest, "tool"), balls["centre_mm"].copy(), balls["radius_mm"].copy()),
        levels=levels,
        golden_motion=motion,
        golden_record=record,
        parts=parts,
    )


def _mapped(path: Path) -> np.ndarray:
    try:
        if not path.is_file():
            raise InputError(str(path), "is not a file" if path.exists() else "does not exist", "check the path")
        if path.stat().st_size == 0:
            raise InputError(str(path), "is empty", "write or copy it again")
        return np.memmap(path, dtype=np.uint8, mode="r").view(np.ndarray)
    except OSError as error:
        raise InputError(str(path), f"cannot be opened ({error.strerror})", "check the path") from error


class _Reader:
    """Sections of one file as arrays."""

    def __init__(self, path: str, file: np.ndarray, sections: tuple[Section, ...]) -> None:
        self.path = path
        self._file = file
        self._table_end = HEADER_DTYPE.itemsize + len(sections) * ENTRY_DTYPE.itemsize
        self._known = {(section.type, section.level): section for section in sections if section.known}

    def has(self, kind: SectionType, level: int = 0) -> bool:
        return (kind, level) in self._known

    def array(self, kind: SectionType, level: int = 0) -> np.ndarray:
        """(n, ...) view of a section in its element type."""
        section = self._known.get((kind, level))
        if section is None:
            raise InputError(self.path, f"section {kind.name} of level {level} is missing", WRITE_AGAIN)
        element = ELEMENT[kind]
        if section.length % element.itemsize:
            what = f"has {section.length} bytes, no multiple of {element.itemsize}"
            raise InputError(f"{self.path}, {section.name}", what, WRITE_AGAIN)
        raw = self._file[section.offset : section.offset + section.length]
        return raw.view(element.base).reshape(-1, *element.shape)

    def one(self, kind: SectionType) -> Any:
        rows = self.array(kind)
        if len(rows) != 1:
            raise InputError(f"{self.path}, {kind.name}", f"holds {len(rows)} records, expected 1", WRITE_AGAIN)
        return rows[0]

    def signer(self) -> bytes | None:
        if not self.has(SectionType.SIGNATURE):
            return None
        content = self.array(SectionType.SIGNATURE).tobytes()
        if fault := signature_fault(content, self._file[: self._table_end].tobytes()):
            raise InputError(f"{self.path}, SIGNATURE", fault, "get the bundle again from whoever signed it")
        return content[:32]

    def manifest(self) -> dict[str, Any]:
        raw = self.array(SectionType.MANIFEST).tobytes()
        manifest: Any = None
        if len(raw) <= MAX_MANIFEST_BYTES:
            with contextlib.suppress(ValueError, RecursionError):
                manifest = json.loads(raw.decode("utf-8"), parse_constant=_no_constant)
        if not isinstance(manifest, dict) or depth(manifest) > MAX_MANIFEST_DEPTH:
            raise InputError(f"{self.path}, MANIFEST", "is not a JSON object of at most 16 MiB", WRITE_AGAIN)
        return manifest

    def refuse(self, section: str, fault: str) -> None:
        """Raises where there is a fault."""
        if fault:
            raise InputError(f"{self.path}, {section}", fault, WRITE_AGAIN)


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no JSON")


def _level(reader: _Reader, number: int, triangles: int, cell_mm: float) -> BundleLevel:
    where = f"level {number}"
    vertices = reader.array(SectionType.VERTICES, number)
    faces = reader.array(SectionType.FACES, number)
    reader.refuse(where, content.mesh_fault(vertices, faces))
    if len(faces) != triangles:
        reader.refuse(where, f"has {len(faces)} triangles, its config says {triangles}")
    materials = None
    if reader.has(SectionType.MATERIALS, number):
        materials = reader.array(SectionType.MATERIALS, number)
        reader.refuse(where, content.materials_fault(materials, len(vertices)))
    acceleration = None
    if all(reader.has(kind, number) for kind in ACCELERATION):
        acceleration = {kind.name.lower(): reader.array(kind, number) for kind in ACCELERATION}
        reader.refuse(where, content.level_fault({"vertices": vertices, "faces": faces, **acceleration}))
        if acceleration["hash"]["cell_mm"][0] != cell_mm:
            reader.refuse(where, "its hash has another cell_mm than its config")
    elif not (cell_mm > 0 and np.isfinite(cell_mm)):
        reader.refuse(where, "cell_mm is not positive and finite")
    return BundleLevel(vertices, faces, cell_mm, acceleration, materials)


def _check_bounds(reader: _Reader, levels: tuple[BundleLevel, ...]) -> None:
    """Bounds of blocks speed the runtime up; nothing here uses them. Of no use where a level is to be rebuilt."""
    if not reader.has(SectionType.BOUNDS):
        return
    bounds = reader.array(SectionType.BOUNDS)
    blocks = [level.acceleration["blocks"] for level in levels if level.acceleration is not None]
    if len(blocks) < len(levels):
        return
    if len(bounds) != sum(map(len, blocks)):
        raise InputError(reader.path, "section BOUNDS and the blocks of all levels differ in number", WRITE_AGAIN)
    start = 0
    for number, part in enumerate(blocks):
        reader.refuse(f"level {number}", content.bounds_fault(bounds[start : start + len(part)], part))
        start += len(part)


def _golden(
    reader: _Reader, manifest: dict[str, Any], loop_hz: float, level_count: int
) -> tuple[Motion | None, np.ndarray | None]:
    motion = record = None
    ticks = 0
    if reader.has(SectionType.GOLDEN_MOTION):
        rows = reader.array(SectionType.GOLDEN_MOTION)
        reader.refuse("GOLDEN_MOTION", content.motion_fault(rows))
        turned = (rows["orientation"] != [1.0, 0.0, 0.0, 0.0]).any()
        about = manifest.get("golden_motion")
        provenance = about if isinstance(about, dict) else {}
        motion = Motion(
            rows["time_s"],
            rows["position_mm"],
            rows["orientation"] if turned else None,
            loop_hz,
            _name(manifest, "golden_motion"),
            provenance,
        )
        ticks = len(rows)
    if reader.has(SectionType.GOLDEN_RECORD):
        record = reader.array(SectionType.GOLDEN_RECORD)
        if len(record) != ticks:
            reader.refuse("GOLDEN_RECORD", f"has {len(record)} rows, the golden motion {ticks}")
        reader.refuse("GOLDEN_RECORD", content.record_fault(record, level_count))
    return motion, record


def _name(manifest: dict[str, Any], part: str) -> str:
    """What the manifest calls a part; the part's own word where it is silent."""
    about = manifest.get(part)
    name = about.get("name") if isinstance(about, dict) else None
    return name if isinstance(name, str) else part.replace("_", " ")
