"""Hold the faces of a PLY file against what its reader takes for granted: as many corners in each, none left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hapticlod.errors import InputError

_FIX = "triangulate the surface in the program that made it, and export it again"


@dataclass(frozen=True)
class Property:
    """A column of an element: bytes of one value, and of a list's length before its values (0: no list)."""

    name: str
    value_bytes: int
    count_bytes: int = 0

    @property
    def is_corners(self) -> bool:
        """Whether it lists the corners of a face."""
        return bool(self.count_bytes) and "ind" in self.name


@dataclass
class Element:
    """Rows of one kind, as a PLY header describes them."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    @property
    def least_bytes(self) -> int:
        """The least that a row can take in binary: a list of face corners holds at least three."""
        least = {True: 3, False: 0}
        values = (least[p.is_corners] if p.count_bytes else 1 for p in self.properties)
        return sum(p.count_bytes + p.value_bytes * count for p, count in zip(self.properties, values, strict=True))


def check_corners(body: bytes, elements: list[Element], form: str, where: str) -> None:
    """Raise InputError where the reader would pass over a face or read it wrongly.

    A binary file is read as if all its lists were as long as the first row's; of a text file's lists, what is missing
    is not missed.

    Args:
        body: what follows the header. elements: in the file's order. form: ascii or binary_*_endian.
    """
    before = 0
    for element in elements:
        if element.name == "face" and element.count:
            if form == "ascii":
                rows = [line for line in body.split(b"\n") if line.strip()]
                _check_text(rows[before : before + element.count], element, where)
            else:
                _check_binary(memoryview(body)[before:], element, "<" if form == "binary_little_endian" else ">", where)
            return
        if form != "ascii" and any(p.count_bytes for p in element.properties):
            return  # lists before the faces: their reader says what it makes of them
        before += element.count if form == "ascii" else element.count * element.least_bytes


def _check_text(rows: list[bytes], face: Element, where: str) -> None:
    lead = next((i for i, p in enumerate(face.properties) if p.count_bytes), None)
    if lead is None or not face.properties[lead].is_corners:
        return
    for number, row in enumerate(rows):
        words = row.split()
        try:
            corners = int(words[lead])
        except (IndexError, ValueError) as error:
            raise InputError(f"{where}, face {number}", "does not begin with its number of corners", _FIX) from error
        held = len(words) - lead - 1
        if corners < 3 or held < corners:
            raise InputError(f"{where}, face {number}", f"claims {corners} corners, {held} numbers follow", _FIX)


def _check_binary(body: memoryview, face: Element, order: str, where: str) -> None:
    lists: list[tuple[Property, int, int]] = []  # where each list's length stands in a row, and what it is in the first
    stride = 0
    for p in face.properties:
        if p.count_bytes:
            length = bytes(body[stride : stride + p.count_bytes]).ljust(p.count_bytes, b"\0")
            held = int.from_bytes(length, "little" if order == "<" else "big")
            lists.append((p, stride, held))
            stride += p.count_bytes + p.value_bytes * held
        else:
            stride += p.value_bytes
    if stride * face.count > len(body):
        what = f"{face.count} faces like the first one take {stride * face.count} bytes, {len(body)} follow"
        raise InputError(where, f"is cut short, or its faces differ in their number of corners: {what}", _FIX)
    rows = np.frombuffer(body, np.uint8, stride * face.count).reshape(face.count, stride)
    for p, at, held in lists:
        count = np.ascontiguousarray(rows[:, at : at + p.count_bytes]).view(f"{order}u{p.count_bytes}")[:, 0]
        if p.is_corners and held < 3:
            raise InputError(f"{where}, face 0", f"has {held} corners", _FIX)
        if (other := count != held).any():
            first = int(np.flatnonzero(other)[0])
            raise InputError(
                f"{where}, face {first}",
                f"{p.name} has {count[first]} values, {held} in face 0: faces must be alike",
                _FIX,
            )
