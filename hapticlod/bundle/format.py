"""The .hlod container, format 1, byte for byte. Equal to runtime/io/bundle_format.hpp; docs/bundle.md specifies it."""

import hashlib
from enum import IntEnum
from typing import Any, Final

import numpy as np

from hapticlod.layout import (
    BALL_DTYPE,
    BLOCK_DTYPE,
    BOUND_DTYPE,
    BRICK_DTYPE,
    CONFIG_DTYPE,
    HASH_DTYPE,
    MATERIAL_DTYPE,
    RECORD_DTYPE,
)

MAGIC: Final = b"\x89HLOD\r\n\x1a"
VERSION: Final = 1
ALIGNMENT: Final = 64
MAX_SECTIONS: Final = 8192
MAX_STORED_LEVELS: Final = 512  # of a scene: all levels of all parts, one after the other
MAX_MANIFEST_BYTES: Final = 16 << 20
MAX_MANIFEST_DEPTH: Final = 64
SECTION_VERSION: Final = 1
OPTIONAL: Final = 1

HEADER_DTYPE: Final = np.dtype(
    [
        ("magic", "V8"),
        ("version", "<u4"),
        ("section_count", "<u4"),
        ("file_bytes", "<u8"),
        ("table_offset", "<u8"),
        ("table_digest", "V32"),
    ]
)

ENTRY_DTYPE: Final = np.dtype(
    [
        ("type", "<u4"),
        ("version", "<u4"),
        ("level", "<u4"),
        ("flags", "<u4"),
        ("offset", "<u8"),
        ("length", "<u8"),
        ("digest", "V32"),
    ]
)

MOTION_DTYPE: Final = np.dtype([("time_s", "<f8"), ("position_mm", "<f8", 3), ("orientation", "<f8", 4)])


PART_DTYPE: Final = np.dtype(
    [
        ("name", "S64"),
        ("level_count", "<u4"),
        ("flags", "<u4"),
        ("position_mm", "<f8", 3),
        ("orientation", "<f8", 4),
        ("cell_mm", "<f8", 8),
        ("triangles", "<u4", 8),
        ("reserved", "<u4", 8),
    ]
)
PART_HIDDEN: Final = 1


class SectionType(IntEnum):
    """What a section holds."""

    MANIFEST = 1
    CONFIG = 2
    TOOL = 3
    PARTS = 4
    VERTICES = 16
    FACES = 17
    ADJACENCY = 18
    NORMALS = 19
    HASH = 20
    TABLE = 21
    BRICKS = 22
    CELLS = 23
    BLOCKS = 24
    MATERIALS = 25
    BOUNDS = 30
    GOLDEN_MOTION = 32
    GOLDEN_RECORD = 33
    SIGNATURE = 48


ACCELERATION: Final = tuple(SectionType(number) for number in range(18, 25))
"""Sections that speed a level up and can be rebuilt from its vertices and faces."""

LEVEL_SECTIONS: Final = (SectionType.VERTICES, SectionType.FACES, *ACCELERATION, SectionType.MATERIALS)
"""Sections that belong to a level; MATERIALS are there only where the scan has any."""

# What one element of a section is: a section's length is a whole number of them.
ELEMENT: Final[dict[SectionType, np.dtype[Any]]] = {
    SectionType.MANIFEST: np.dtype("u1"),
    SectionType.CONFIG: CONFIG_DTYPE,
    SectionType.TOOL: BALL_DTYPE,
    SectionType.PARTS: PART_DTYPE,
    SectionType.VERTICES: np.dtype(("<f4", 3)),
    SectionType.FACES: np.dtype(("<u4", 3)),
    SectionType.ADJACENCY: np.dtype(("<u4", 3)),
    SectionType.NORMALS: np.dtype(("<f4", 3)),
    SectionType.HASH: HASH_DTYPE,
    SectionType.TABLE: np.dtype("<u4"),
    SectionType.BRICKS: BRICK_DTYPE,
    SectionType.CELLS: np.dtype("<u4"),
    SectionType.BLOCKS: BLOCK_DTYPE,
    SectionType.MATERIALS: MATERIAL_DTYPE,
    SectionType.BOUNDS: BOUND_DTYPE,
    SectionType.GOLDEN_MOTION: MOTION_DTYPE,
    SectionType.GOLDEN_RECORD: RECORD_DTYPE,
    SectionType.SIGNATURE: np.dtype("u1"),
}


def is_optional(kind: SectionType) -> bool:
    """Whether a reader that does not know the section may skip it."""
    return kind in ACCELERATION or kind >= SectionType.BOUNDS


def aligned(offset: int) -> int:
    """The next place where a section may start."""
    return (offset + ALIGNMENT - 1) // ALIGNMENT * ALIGNMENT


def digest(data: Any) -> bytes:
    """BLAKE2b-256 of a buffer."""
    return hashlib.blake2b(data, digest_size=32).digest()


def depth(value: Any) -> int:
    """How deep JSON is nested: 0 for a number, 1 for a flat list or object."""
    deepest, wholes = 0, [value]
    while wholes := [whole for whole in wholes if isinstance(whole, dict | list)]:
        deepest += 1
        wholes = [part for whole in wholes for part in (whole.values() if isinstance(whole, dict) else whole)]
    return deepest
