"""Check a PLY file's header against its length before anything is allocated for what it claims (Turk, 1994)."""

from __future__ import annotations

from dataclasses import dataclass, field

from hapticlod.errors import InputError

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16", "float16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "double", "float64"), 8),
}
_LONGEST_HEADER = 1 << 20
_FIX = "export or copy the file again"


@dataclass
class _Element:
    name: str
    count: int
    row_bytes: int = 0  # the least a row can take: a list of face corners holds at least three
    names: list[str] = field(default_factory=list)


def check_ply(data: bytes, where: str) -> None:
    """Raise InputError unless the file is a PLY that holds as many vertices and faces as its header claims."""
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise InputError(where, "does not start with a PLY header", _FIX)
    line_end = data.find(b"\n", end)
    body = data[line_end + 1 :] if line_end >= 0 else b""
    elements, is_text = _parse(data[:end].decode("ascii", "replace"), where)
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None or not {"x", "y", "z"} <= set(vertex.names):
        raise InputError(where, "its header has no vertex with x, y and z", _FIX)
    claim = ", ".join(f"{element.count} {element.name}" for element in elements)
    if is_text:
        needed, unit = sum(element.count for element in elements), "lines"
        held = sum(1 for line in body.split(b"\n") if line.strip())
    else:
        needed, held, unit = sum(element.count * element.row_bytes for element in elements), len(body), "bytes"
    if held < needed:
        least = f"at least {needed} {unit}"
        raise InputError(where, f"is cut short: its head claims {claim} ({least}), {held} {unit} follow", _FIX)
    if is_text and held > needed:
        raise InputError(where, f"is damaged: its head claims {claim}, {held} {unit} follow", _FIX)


def _parse(header: str, where: str) -> tuple[list[_Element], bool]:
    elements: list[_Element] = []
    is_text = False
    for number, line in enumerate(header.splitlines(), start=1):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                is_text = words[1] == "ascii"
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2])))
                if elements[-1].count < 0:
                    raise ValueError(line)
            elif words[:2] == ["property", "list"]:
                least = 3 if elements[-1].name == "face" and "ind" in words[4] else 0
                elements[-1].row_bytes += _SIZES[words[2]] + least * _SIZES[words[3]]
            elif words[:1] == ["property"]:
                elements[-1].row_bytes += _SIZES[words[1]]
                elements[-1].names.append(words[2])
        except (IndexError, KeyError, ValueError) as error:
            raise InputError(f"{where}, line {number}", f"cannot be read as PLY header: {line!r}", _FIX) from error
    return elements, is_text
