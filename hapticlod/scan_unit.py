"""In which unit a mesh file's numbers are: what the file says, or a guess from its size."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from hapticlod.box import box_diagonal
from hapticlod.errors import InputError

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4}
_OTHER_NAMES = {
    "millimetre": "mm", "millimeter": "mm", "millimetres": "mm", "millimeters": "mm",
    "centimetre": "cm", "centimeter": "cm", "centimetres": "cm", "centimeters": "cm",
    "metre": "m", "meter": "m", "metres": "m", "meters": "m",
    "micron": "um", "microns": "um", "µm": "um", "μm": "um", "micrometre": "um", "micrometer": "um",
    "inch": "in", "inches": "in",
}  # fmt: skip
# Things that are touched with a hand-held tool are between a crown and a torso in size, and scanners resolve some tens
# of micrometres to some millimetres. A unit is doubted where a scan is further from both than a factor of two.
PLAUSIBLE_EXTENT_MM, PLAUSIBLE_EDGE_MM = (5.0, 500.0), (0.05, 3.0)
DOUBT = 2.0
_ORDER = ("mm", "m", "in", "cm", "um")  # of units that are as likely by size: the commoner one
# "# File units = millimeters" (3ds Max), "UNITS=in" (binary STL), "comment unit: mm" (PLY).
_SAID = re.compile(rb"\bunits?\b[\s:=]{1,4}\"?([A-Za-z\xc2\xb5\xce\xbc]{1,12})", re.IGNORECASE)
_HEAD_BYTES = 4096


@dataclass(frozen=True)
class Unit:
    """A unit and what that rests on, one sentence; `sure`: somebody said so."""

    name: str
    why: str
    sure: bool

    @property
    def mm(self) -> float:
        """Its length in mm."""
        return UNITS_MM[self.name]


def named_unit(name: str) -> Unit:
    """The unit that the user names. Raises InputError where there is none of that name."""
    known = _known(name)
    if known is None:
        raise InputError(f"unit {name!r}", "is unknown", f"give one of {', '.join(UNITS_MM)}")
    return Unit(known, f"unit {known}, as asked", True)


def unit_of_file(data: bytes, kind: str) -> Unit | None:
    """What a file says of its unit: glTF and 3MF by their standards, STL, PLY and OBJ in their comments."""
    if kind == "glb":
        return Unit("m", "unit m: glTF files are in metres by their standard", True)
    head = data[: 80 if kind == "stl" and data.lstrip()[:5].lower() != b"solid" else _HEAD_BYTES]
    if kind == "ply":
        head = b"\n".join(line for line in head.split(b"end_header")[0].split(b"\n") if line.startswith(b"comment"))
    elif kind in ("obj", "off"):
        head = b"\n".join(line for line in head.split(b"\n") if line.lstrip().startswith(b"#"))
    found = _SAID.search(head)
    name = None if found is None else _known(found[1].decode("utf-8", "replace"))
    return None if name is None else Unit(name, f"unit {name}: the file says so", True)


def unit_of_3mf(name: str) -> Unit | None:
    """The unit of a 3MF model; its standard's default is the millimetre, and it knows feet, which nobody scans in."""
    known = _known(name)
    return None if known is None else Unit(known, f"unit {known}: the file says so", True)


def guess_unit(vertices: np.ndarray, faces: np.ndarray) -> Unit:
    """The unit that makes a mesh a thing of plausible size, mm if that will do.

    Args:
        vertices: (n, 3) in the file's unit; not finite ones are passed over. faces: (m, 3) indices.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    points = vertices[used & np.isfinite(vertices).all(axis=1)]
    if len(points) == 0:
        return Unit("mm", "unit mm: nothing to guess from", False)
    few = vertices[faces[:: max(1, len(faces) // 20_000)]]
    with np.errstate(invalid="ignore", over="ignore"):
        extent = box_diagonal(points)
        edges = np.linalg.norm(few - np.roll(few, 1, axis=1), axis=2)
    edges = edges[np.isfinite(edges) & (edges > 0.0)]
    edge = float(np.median(edges)) if len(edges) else extent
    far = {name: _far(extent * UNITS_MM[name], edge * UNITS_MM[name]) for name in _ORDER}
    best = min(_ORDER, key=lambda name: (far[name], _ORDER.index(name)))
    if far["mm"] <= DOUBT or far[best] == far["mm"]:
        best = "mm"
    size = f"{_length(extent * UNITS_MM[best])} across, half its edges below {_length(edge * UNITS_MM[best])}"
    others = ", ".join(f"{_length(extent * UNITS_MM[u])} in {u}" for u in _ORDER[:3] if u != best)
    return Unit(best, f"unit {best} is a guess from the size: {size} ({others}); --unit says it for sure", False)


def _far(extent_mm: float, edge_mm: float) -> float:
    """By which factor a mesh is out of the plausible, in size and fineness together; 1: it is not."""
    factor = 1.0
    for value, (least, most) in ((extent_mm, PLAUSIBLE_EXTENT_MM), (edge_mm, PLAUSIBLE_EDGE_MM)):
        factor *= max(least / max(value, 1e-300), value / most, 1.0)
    return factor


def _known(name: str) -> str | None:
    name = name.strip().lower()
    name = _OTHER_NAMES.get(name, name)
    return name if name in UNITS_MM else None


def _length(mm: float) -> str:
    for name in ("m", "mm", "um"):
        if mm >= UNITS_MM[name]:
            return f"{mm / UNITS_MM[name]:.3g} {name}"
    return f"{mm:.3g} mm"
