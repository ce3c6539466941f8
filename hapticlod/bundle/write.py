"""Writes a bundle: deterministic, in one piece or not at all."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hapticlod.bundle.format import (
    ENTRY_DTYPE,
    HEADER_DTYPE,
    LEVEL_SECTIONS,
    MAGIC,
    MAX_MANIFEST_BYTES,
    MAX_MANIFEST_DEPTH,
    MOTION_DTYPE,
    OPTIONAL,
    SECTION_VERSION,
    VERSION,
    SectionType,
    aligned,
    depth,
    digest,
    is_optional,
)
from hapticlod.bundle.parts import PartLike, part_rows, parts_fault
from hapticlod.bundle.read import read_bundle
from hapticlod.files import write_atomic
from hapticlod.layout import BALL_DTYPE, CONFIG_DTYPE, RECORD_DTYPE
from hapticlod.motion import Motion
from hapticlod.signature import SIGNATURE_BYTES, Key
from hapticlod.tool import Tool


class LevelLike(Protocol):
    """A built level, as `hapticlod._runtime.Level` gives it."""

    def arrays(self) -> Mapping[str, Any]:
        """Buffers by section name: vertices, faces, adjacency, normals, hash, table, bricks, cells, blocks; materials
        where there are any; bounds, without which opening takes longer."""
        ...


def write_bundle(
    path: str | Path,
    *,
    levels: Sequence[LevelLike],
    config: Any,
    tool: Tool,
    manifest: Mapping[str, Any],
    golden_motion: Motion | None = None,
    golden_record: np.ndarray | None = None,
    key: Key | None = None,
    parts: Sequence[PartLike] = (),
) -> None:
    """Writes a `.hlod`. Equal arguments give equal bytes; an existing file is replaced in one step.

    Args:
        path: the file.
        levels: finest first; their cell sizes and triangle counts must be those of `config`.
        config: numpy scalar of `hapticlod.layout.CONFIG_DTYPE`, as `LodConfig.to_runtime` gives it.
        tool: all its balls are stored, in their nested order.
        manifest: provenance, station, predicted and measured metrics: JSON types, numpy numbers and arrays, paths.
        golden_motion: a short motion at the loop rate ...
        golden_record: ... and (T,) rows of `RECORD_DTYPE` that its replay gave. Both or neither.
        key: signs the bundle; None leaves it unsigned.
        parts: of a scene, whose `levels` are then `hapticlod._runtime.SceneLevel`s of as many parts.

    Raises:
        InputError: the file cannot be written.
        ValueError: the parts do not fit each other, or the manifest holds a number that is not finite.
    """
    sections = _sections(levels, config, tool, manifest, golden_motion, golden_record, parts)
    write_atomic(path, container(sections, key=key))


def sign_bundle(source: str | Path, path: str | Path, key: Key) -> None:
    """Writes a copy of a bundle, checked first and signed with `key`; a signature that it had is replaced.

    Raises:
        InputError: the bundle cannot be read, or the copy not be written.
    """
    held = read_bundle(source)
    file = np.memmap(held.path, dtype=np.uint8, mode="r")
    kept = [section for section in held.sections if section.type != SectionType.SIGNATURE]
    sections = [(s.type, s.level, file[s.offset : s.offset + s.length]) for s in kept]
    versions = {(s.type, s.level): s.version for s in kept}
    write_atomic(path, container(sections, section_version=versions, key=key))


def container(
    sections: Sequence[tuple[int, int, Any]],
    *,
    section_version: Mapping[tuple[int, int], int] | None = None,
    key: Key | None = None,
) -> bytearray:
    """The file that holds (type, level, buffer) in this order, with digests. `section_version` by (type, level).

    With a `key`, a signature follows as the last section.
    """
    versions = section_version or {}
    if key is not None:
        sections = [*sections, (SectionType.SIGNATURE, 0, bytes(SIGNATURE_BYTES))]
    table = np.zeros(len(sections), dtype=ENTRY_DTYPE)
    end = HEADER_DTYPE.itemsize + table.nbytes
    for entry, (kind, level, data) in zip(table, sections, strict=True):
        data = memoryview(data).cast("B")
        entry["type"], entry["level"] = kind, level
        entry["version"] = versions.get((kind, level), SECTION_VERSION)
        known = kind in set(SectionType)
        entry["flags"] = OPTIONAL if not known or is_optional(SectionType(kind)) else 0
        entry["offset"] = aligned(end)
        entry["length"] = data.nbytes
        if kind != SectionType.SIGNATURE:  # it signs header and table, so they cannot hold its digest
            entry["digest"] = np.void(digest(data))
        end = aligned(end) + data.nbytes

    header = np.zeros(1, dtype=HEADER_DTYPE)
    header["magic"] = np.void(MAGIC)
    header["version"] = VERSION
    header["section_count"] = len(sections)
    header["file_bytes"] = end
    header["table_offset"] = HEADER_DTYPE.itemsize
    header["table_digest"] = np.void(digest(table.tobytes()))
    file = bytearray(end)
    file[: header.nbytes] = header.tobytes()
    file[header.nbytes : header.nbytes + table.nbytes] = table.tobytes()
    for entry, (_, _, data) in zip(table, sections, strict=True):
        start = int(entry["offset"])
        file[start : start + int(entry["length"])] = memoryview(data).cast("B")
    if key is not None:
        file[-SIGNATURE_BYTES:] = key.signature(bytes(file[: header.nbytes + table.nbytes]))
    return file


def _sections(
    levels: Sequence[LevelLike],
    config: Any,
    tool: Tool,
    manifest: Mapping[str, Any],
    golden_motion: Motion | None,
    golden_record: np.ndarray | None,
    parts: Sequence[PartLike],
) -> list[tuple[int, int, Any]]:
    settings = np.ascontiguousarray(config).reshape(1)
    if settings.dtype != CONFIG_DTYPE:
        raise ValueError(f"config has dtype {settings.dtype}, not CONFIG_DTYPE")
    if len(levels) != int(settings["level_count"][0]):
        raise ValueError(f"{len(levels)} levels, but the config has {int(settings['level_count'][0])}")
    text = json.dumps(manifest, allow_nan=False, ensure_ascii=False, indent=1, default=_plain).encode(errors="replace")
    if len(text) > MAX_MANIFEST_BYTES or depth(json.loads(text)) > MAX_MANIFEST_DEPTH:
        raise ValueError("the manifest is larger than 16 MiB, or nested deeper than 64")
    balls = np.zeros(tool.balls, dtype=BALL_DTYPE)
    balls["centre_mm"], balls["radius_mm"] = tool.centres_mm, tool.radii_mm
    sections: list[tuple[int, int, Any]] = [
        (SectionType.MANIFEST, 0, text),
        (SectionType.CONFIG, 0, settings.tobytes()),
        (SectionType.TOOL, 0, balls.tobytes()),
    ]
    stored: list[LevelLike] = list(levels)
    if parts:
        own = _levels_of_parts(levels, parts)
        rows = part_rows(parts, own)
        if fault := parts_fault(rows, settings[0]):
            raise ValueError(fault)
        sections.append((SectionType.PARTS, 0, rows.tobytes()))
        stored = [level for part in own for level in part]
    bounds: list[Any] = []
    for number, level in enumerate(stored):
        arrays = level.arrays()
        bounds.append(arrays.get("bounds"))
        faces = memoryview(arrays["faces"]).nbytes // 12
        if not parts and faces != int(settings["triangles"][0][number]):
            raise ValueError(
                f"level {number} has {faces} triangles, its config says {int(settings['triangles'][0][number])}"
            )
        kinds = [kind for kind in LEVEL_SECTIONS if kind != SectionType.MATERIALS or "materials" in arrays]
        sections += [(kind, number, _buffer(arrays[kind.name.lower()])) for kind in kinds]
    if all(part is not None for part in bounds):
        sections.append((SectionType.BOUNDS, 0, b"".join(_buffer(part) for part in bounds)))
    if (golden_motion is None) != (golden_record is None):
        raise ValueError("give a golden motion and its record, or neither")
    if golden_motion is not None and golden_record is not None:
        if golden_record.dtype != RECORD_DTYPE or golden_record.shape != (golden_motion.ticks,):
            raise ValueError(f"golden record {golden_record.shape} does not fit {golden_motion.ticks} ticks")
        sections += [
            (SectionType.GOLDEN_MOTION, 0, motion_rows(golden_motion).tobytes()),
            (SectionType.GOLDEN_RECORD, 0, golden_record.tobytes()),
        ]
    return sections


def _levels_of_parts(levels: Sequence[Any], parts: Sequence[PartLike]) -> list[list[Any]]:
    """Of every part its levels; one that stays the same to the end is stored once."""
    if any(len(level.parts) != len(parts) for level in levels):
        raise ValueError(f"{len(parts)} parts, but a level has another number of them")
    own: list[list[Any]] = [[] for _ in parts]
    for level in levels:
        for held, piece in zip(own, level.parts, strict=True):
            if not held or held[-1] is not piece:
                held.append(piece)
    for i, held in enumerate(own):
        if any(level.parts[i] is not held[min(k, len(held) - 1)] for k, level in enumerate(levels)):
            raise ValueError(f"{parts[i].name}: a level is repeated before the last one")
    return own


def motion_rows(motion: Motion) -> np.ndarray:
    """(T,) of MOTION_DTYPE; without orientation the tool keeps the scan's axes."""
    rows = np.zeros(motion.ticks, dtype=MOTION_DTYPE)
    rows["time_s"], rows["position_mm"] = motion.time_s, motion.position_mm
    rows["orientation"] = [1.0, 0.0, 0.0, 0.0] if motion.orientation is None else motion.orientation
    return rows


def _buffer(data: Any) -> Any:
    return data if isinstance(data, bytes | bytearray | memoryview) else np.ascontiguousarray(data).tobytes()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"the manifest holds a {type(value).__name__}")
