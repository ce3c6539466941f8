"""Hold the faces of a PLY file against what its reader takes for granted: as many corners in each, none left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hapticlod.errors import InputError
from hapticlod.far_vertices import check_vertices

_FIX = "triangulate the surface in the program that made it, and export it again"


@dataclass(frozen=True)
class Property:
    """A column of an element: bytes of one value, of a list's length before its values (0: no list), numpy's letter."""

    name: str
    value_bytes: int
    count_bytes: int = 0
    letter: str = "i"

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
    before, order = 0, ">" if form == "binary_big_endian" else "<"
    vertices = np.zeros((0, 3))
    for element in elements:
        if element.name == "face" and element.count:
            if form == "ascii":
                rows = [line for line in body.split(b"\n") if line.strip()]
                _check_text(rows[before : before + element.count], element, where)
            else:
                check_vertices(vertices, _check_binary(memoryview(body)[before:], element, order, where), where)
            return
        if element.name == "vertex" and form != "ascii" and not any(p.count_bytes for p in element.properties):
            vertices = _places(memoryview(body)[before:], element, order)
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


def _places(body: memoryview, vertex: Element, order: str) -> np.ndarray:
    """(n, 3) in the file's unit."""
    ends = np.cumsum([p.value_bytes for p in vertex.properties]).tolist()
    held = {p.name: (p, end - p.value_bytes) for p, end in zip(vertex.properties, ends, strict=True)}
    rows = np.frombuffer(body, np.uint8, ends[-1] * vertex.count).reshape(vertex.count, ends[-1])
    columns = []
    for p, at in (held[axis] for axis in "xyz"):
        column = np.ascontiguousarray(rows[:, at : at + p.value_bytes])
        columns.append(column.view(f"{order}{p.letter}{p.value_bytes}")[:, 0])
    return np.stack(columns, axis=1)


def _check_binary(body: memoryview, face: Element, order: str, where: str) -> np.ndarray:
    """The corners (m, k) of the faces, unless they are refused."""
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
    corners = np.zeros((0, 3), dtype=np.int64)
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
        if p.is_corners:
            at += p.count_bytes
            values = np.ascontiguousarray(rows[:, at : at + p.value_bytes * held])
            corners = values.view(f"{order}{p.letter}{p.value_bytes}")
    return corners
