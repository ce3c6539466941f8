"""Structure of a bundle: header and section table, checked against the bytes that are really there."""

from dataclasses import dataclass

import numpy as np

from hapticlod.bundle.format import (
    ENTRY_DTYPE,
    HEADER_DTYPE,
    LEVEL_SECTIONS,
    MAGIC,
    MAX_SECTIONS,
    MAX_STORED_LEVELS,
    OPTIONAL,
    SECTION_VERSION,
    VERSION,
    SectionType,
    aligned,
    digest,
)
from hapticlod.errors import InputError
from hapticlod.layout import MAX_LEVELS

COPY_AGAIN = "copy or write the bundle again"
UPDATE = "update HapticLOD or write the bundle with an older one"


@dataclass(frozen=True)
class Section:
    """One row of the section table."""

    type: int
    version: int
    level: int
    optional: bool
    offset: int
    length: int
    digest: bytes

    @property
    def name(self) -> str:
        """For people: VERTICES of level 2."""
        if self.type not in set(SectionType):
            return f"section type {self.type}"
        kind = SectionType(self.type)
        return f"{kind.name} of level {self.level}" if kind in LEVEL_SECTIONS else kind.name

    @property
    def known(self) -> bool:
        """Whether this program reads its type and version."""
        return self.type in set(SectionType) and self.version == SECTION_VERSION


def read_sections(file: np.ndarray, path: str) -> tuple[Section, ...]:
    """The sections of a file given as (n,) uint8: header, table, bounds, order, zero padding, every digest.

    Sections of unknown type or version are kept where they are optional.

    Raises:
        InputError: anything is wrong, or too new.
    """
    table = _table(file, path)
    most_levels = MAX_STORED_LEVELS if (table["type"] == SectionType.PARTS).any() else MAX_LEVELS
    end = HEADER_DTYPE.itemsize + table.nbytes
    seen: set[tuple[int, int]] = set()
    sections: list[Section] = []
    for entry in table:
        flags = int(entry["flags"])
        section = Section(
            int(entry["type"]),
            int(entry["version"]),
            int(entry["level"]),
            bool(flags & OPTIONAL),
            int(entry["offset"]),
            int(entry["length"]),
            entry["digest"].tobytes(),
        )
        where = f"{path}, {section.name}"
        if fault := _entry_fault(section, flags, end, len(file), most_levels):
            raise InputError(where, fault, COPY_AGAIN)
        if not section.known and not section.optional:
            what = f"is needed and has version {section.version}, which this program does not know"
            raise InputError(where, what, UPDATE)
        if (section.type, section.level) in seen:
            raise InputError(where, "appears twice", COPY_AGAIN)
        if file[end : section.offset].any():
            raise InputError(where, "follows padding that is not zero", COPY_AGAIN)
        seen.add((section.type, section.level))
        sections.append(section)
        end = section.offset + section.length
    if end != len(file):
        raise InputError(path, "has bytes after its last section", COPY_AGAIN)
    for section in sections:
        content = file[section.offset : section.offset + section.length]
        expected = bytes(32) if section.type == SectionType.SIGNATURE else digest(content.data)
        if section.digest != expected:
            raise InputError(f"{path}, {section.name}", "is damaged (its digest differs)", COPY_AGAIN)
    return tuple(sections)


def _table(file: np.ndarray, path: str) -> np.ndarray:
    if len(file) < HEADER_DTYPE.itemsize:
        raise InputError(path, f"is cut short: {len(file)} bytes, the header alone has 64", COPY_AGAIN)
    header = file[: HEADER_DTYPE.itemsize].view(HEADER_DTYPE)[0]
    if header["magic"].tobytes() != MAGIC:
        raise InputError(path, "is not a HapticLOD bundle", "name a .hlod file")
    if header["version"] != VERSION:
        what = f"has bundle format {header['version']}, this program reads format {VERSION}"
        raise InputError(path, what, UPDATE)
    if header["file_bytes"] != len(file):
        what = f"has {len(file)} bytes, its header promises {header['file_bytes']}: cut short or damaged"
        raise InputError(path, what, COPY_AGAIN)
    count = int(header["section_count"])
    start = HEADER_DTYPE.itemsize
    room = (len(file) - start) // ENTRY_DTYPE.itemsize
    if not 1 <= count <= min(MAX_SECTIONS, room) or header["table_offset"] != start:
        raise InputError(path, "has a damaged header (section count or table place)", COPY_AGAIN)
    content = file[start : start + count * ENTRY_DTYPE.itemsize]
    if digest(content.data) != header["table_digest"].tobytes():
        raise InputError(path, "has a damaged section table (its digest differs)", COPY_AGAIN)
    return content.view(ENTRY_DTYPE)


def _entry_fault(section: Section, flags: int, end: int, file_bytes: int, most_levels: int) -> str:
    """Why an entry cannot be right; `end` is where the section before it ended."""
    if section.offset != aligned(end):
        return "does not start where the one before ends"
    if section.offset + section.length > file_bytes:
        return "reaches beyond the file"
    if flags & ~OPTIONAL:
        return "has unknown flags"
    # A type that is not known here may be one of levels.
    of_no_level = section.type in set(SectionType) and section.type not in LEVEL_SECTIONS
    if section.level >= most_levels or (section.level and of_no_level):
        return "has a wrong level"
    return ""
