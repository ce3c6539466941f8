"""Check a PLY file's header against its length before anything is allocated for what it claims (Turk, 1994)."""

from __future__ import annotations

from hapticlod.errors import InputError
from hapticlod.ply_faces import Element, Property, check_corners

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16", "float16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "double", "float64"), 8),
}
_LONGEST_HEADER = 1 << 20
_FIX = "export or copy the file again"


def check_ply(data: bytes, where: str) -> None:
    """Raise InputError unless the file is a PLY that holds as many vertices and faces as its header claims."""
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise InputError(where, "does not start with a PLY header", _FIX)
    line_end = data.find(b"\n", end)
    body = data[line_end + 1 :] if line_end >= 0 else b""
    elements, form = _parse(data[:end].decode("ascii", "replace"), where)
    is_text = form == "ascii"
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None or not {"x", "y", "z"} <= {p.name for p in vertex.properties if not p.count_bytes}:
        raise InputError(where, "its header has no vertex with x, y and z", _FIX)
    claim = ", ".join(f"{element.count} {element.name}" for element in elements)
    if is_text:
        needed, unit = sum(element.count for element in elements), "lines"
        held = sum(1 for line in body.split(b"\n") if line.strip())
    else:
        needed, held, unit = sum(element.count * element.least_bytes for element in elements), len(body), "bytes"
    if held < needed:
        least = f"at least {needed} {unit}"
        raise InputError(where, f"is cut short: its head claims {claim} ({least}), {held} {unit} follow", _FIX)
    if vertex.count > 0 and not any(element.name == "face" and element.count for element in elements):
        remedy = "mesh it first, then give the surface"
        raise InputError(where, f"is a point cloud ({vertex.count} points, no faces)", remedy)
    if is_text and held > needed:
        raise InputError(where, f"is damaged: its head claims {claim}, {held} {unit} follow", _FIX)
    check_corners(body, elements, form, where)


def _parse(header: str, where: str) -> tuple[list[Element], str]:
    elements: list[Element] = []
    form = ""
    for number, line in enumerate(header.splitlines(), start=1):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
                if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
                    raise ValueError(line)
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2])))
                if elements[-1].count < 0:
                    raise ValueError(line)
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(
                    Property(words[4], _SIZES[words[3]], _SIZES[words[2]], _letter(words[3]))
                )
            elif words[:1] == ["property"]:
                elements[-1].properties.append(Property(words[2], _SIZES[words[1]], 0, _letter(words[1])))
        except (IndexError, KeyError, ValueError) as error:
            raise InputError(f"{where}, line {number}", f"cannot be read as PLY header: {line!r}", _FIX) from error
    return elements, form


def _letter(name: str) -> str:
    """numpy's for a type of the header."""
    return "f" if name.startswith(("float", "double")) else "u" if name.startswith("u") else "i"
