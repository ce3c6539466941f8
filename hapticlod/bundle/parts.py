"""Section PARTS of a bundle: the parts of a scene. The checks of runtime/io/bundle_scene.cpp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hapticlod.bundle.format import PART_DTYPE, PART_HIDDEN
from hapticlod.layout import MAX_LEVELS

MAX_PARTS = 64
_MOST_NAME_BYTES = 63
_UNIT_LENGTH = 1e-3


class PartLike(Protocol):
    """What is stored of a part beside its levels: `hapticlod.scene.Part` has it."""

    @property
    def name(self) -> str: ...
    @property
    def position_mm(self) -> Sequence[float]: ...
    @property
    def orientation(self) -> Sequence[float]: ...
    @property
    def hidden(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class StoredPart:
    """One row of PARTS.

    Attributes:
        name: see `hapticlod.scene.Part`, as position_mm (3,), orientation (4,) and hidden are.
        first_level: the first of its levels among those of the bundle. level_count: how many follow.
        cell_mm, triangles: per level.
    """

    name: str
    position_mm: tuple[float, ...]
    orientation: tuple[float, ...]
    hidden: bool
    first_level: int
    level_count: int
    cell_mm: tuple[float, ...]
    triangles: tuple[int, ...]


def part_rows(parts: Sequence[PartLike], levels: Sequence[Sequence[Any]]) -> np.ndarray:
    """(P,) of PART_DTYPE; levels: those of each part, with `triangles` and `cell_mm`."""
    rows = np.zeros(len(parts), dtype=PART_DTYPE)
    for row, part, own in zip(rows, parts, levels, strict=True):
        row["name"] = part.name.encode()
        row["level_count"] = len(own)
        row["flags"] = PART_HIDDEN if part.hidden else 0
        row["position_mm"], row["orientation"] = part.position_mm, part.orientation
        row["cell_mm"][: len(own)] = [level.cell_mm for level in own]
        row["triangles"][: len(own)] = [level.triangles for level in own]
    return rows


def stored_parts(rows: np.ndarray) -> tuple[StoredPart, ...]:
    """Rows that have passed `parts_fault`."""
    parts: list[StoredPart] = []
    first = 0
    for row in rows:
        count = int(row["level_count"])
        parts.append(
            StoredPart(
                row["name"].decode(),
                tuple(row["position_mm"].tolist()),
                tuple(row["orientation"].tolist()),
                bool(row["flags"] & PART_HIDDEN),
                first,
                count,
                tuple(row["cell_mm"][:count].tolist()),
                tuple(row["triangles"][:count].tolist()),
            )
        )
        first += count
    return tuple(parts)


def parts_fault(rows: np.ndarray, config: Any) -> str:
    """The first fault of PARTS under this config, or ''."""
    if not 1 <= len(rows) <= MAX_PARTS:
        return f"{len(rows)} parts, expected 1 to {MAX_PARTS}"
    counts = rows["level_count"].astype(np.int64)
    seen: set[bytes] = set()
    for number, row in enumerate(rows):
        if fault := _row_fault(row, int(config["level_count"])):
            return f"part {number} {fault}"
        if bytes(row["name"]) in seen:
            return f"part {number} has the name of another"
        seen.add(bytes(row["name"]))
    if counts.max() != config["level_count"]:
        return "no part has as many levels as the config"
    for level in range(int(config["level_count"])):
        shown = sum(int(row["triangles"][min(level, n - 1)]) for row, n in zip(rows, counts.tolist(), strict=True))
        if shown != config["triangles"][level]:
            return f"at level {level} they have other triangles than the config says"
    return ""


def _row_fault(row: Any, level_count: int) -> str:
    raw = row["name"]
    try:
        good = 1 <= len(raw) <= _MOST_NAME_BYTES and all(byte >= 32 and byte != 127 for byte in raw)
        raw.decode()
    except UnicodeDecodeError:
        good = False
    if not good:
        return f"has a name that is no text of 1 to {_MOST_NAME_BYTES} bytes"
    if not 1 <= row["level_count"] <= min(level_count, MAX_LEVELS):
        return "has a wrong number of levels"
    if row["flags"] & ~np.uint32(PART_HIDDEN) or row["reserved"].any():
        return "has unknown flags or reserved fields that are not 0"
    if not abs(float(np.linalg.norm(row["orientation"])) - 1.0) <= _UNIT_LENGTH:
        return "has an orientation that is not a unit quaternion"
    if not (np.abs(row["position_mm"]) <= 1e9).all():
        return "has a position that is not finite or beyond 10^9 mm"
    return ""
