"""Material maps: TOML files that say what the parts of a scan are made of, by connected component or by colour.

name = "enamel and gingiva"

[default]                 # the rest; without it, the station's stiffness and friction
stiffness_n_mm = 2.0

[[material]]
name = "gingiva"
colour = [226, 120, 130]  # or component = 0, the largest
tolerance = 30            # of each channel
stiffness_n_mm = 0.4
friction_static = 0.35    # both or neither
friction_dynamic = 0.25
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from hapticlod.errors import InputError
from hapticlod.material import COLUMNS, MOST_FRICTION, STIFFEST_N_MM
from hapticlod.scan import Scan
from hapticlod.toml import TomlModel, fault_at, load_toml
from hapticlod.toml_places import key_places
from hapticlod.topology import vertex_components

Channel = Annotated[int, Field(ge=0, le=255)]
Friction = Annotated[float, Field(ge=0, le=MOST_FRICTION)]
_DEFAULT_TOLERANCE = 8
_NAMED_COLOURS = 4  # of the scan, in a message


class Properties(TomlModel):
    """What a material is like. What is left out is the station's."""

    stiffness_n_mm: float | None = Field(default=None, gt=0, le=STIFFEST_N_MM)
    friction_static: Friction | None = None
    friction_dynamic: Friction | None = None

    @model_validator(mode="after")
    def _whole(self) -> Properties:
        given = [name for name in COLUMNS if getattr(self, name) is not None]
        if not given:
            raise fault_at("stiffness_n_mm", "no property is given: give a stiffness, friction or both")
        if self.friction_static is None and self.friction_dynamic is not None:
            raise fault_at("friction_static", "missing: friction_dynamic is given, both are needed")
        if self.friction_dynamic is None and self.friction_static is not None:
            raise fault_at("friction_dynamic", "missing: friction_static is given, both are needed")
        if (self.friction_dynamic or 0.0) > (self.friction_static or 0.0):
            raise fault_at("friction_dynamic", "must not exceed friction_static")
        return self

    @property
    def row(self) -> list[float]:
        """Its values by column, NaN where not given."""
        values = (getattr(self, name) for name in COLUMNS)
        return [np.nan if value is None else value for value in values]


class Entry(Properties):
    """One material and the faces it applies to: those of a component, or those of a colour."""

    name: str = ""
    component: int | None = Field(default=None, ge=0, description="0 has the most triangles")
    colour: tuple[Channel, Channel, Channel] | None = Field(default=None, description="red, green, blue")
    tolerance: Channel | None = Field(default=None, description="a channel may differ by this; 8 where left out")

    @model_validator(mode="after")
    def _one_key(self) -> Entry:
        if (self.component is None) == (self.colour is None):
            field = "component" if self.colour is None else "colour"
            raise fault_at(field, "give component or colour: one of them says where the material is")
        if self.tolerance is not None and self.colour is None:
            raise fault_at("tolerance", "belongs to a colour")
        return self


class MaterialFile(TomlModel):
    """A material map as it stands in its file."""

    name: str = ""
    default: Properties | None = None
    material: tuple[Entry, ...] = ()

    @model_validator(mode="after")
    def _some(self) -> MaterialFile:
        if self.default is None and not self.material:
            raise fault_at("material", "the map is empty: give [[material]] tables, [default] or both")
        named = [entry.component for entry in self.material if entry.component is not None]
        if twice := sorted({k for k in named if named.count(k) > 1}):
            raise fault_at("material", f"component {twice[0]} has two materials")
        return self


@dataclass(frozen=True)
class MaterialMap:
    """A material map that can be applied to scans.

    Attributes:
        file: its content. path: where it came from. places: `path:line:column` of the key of every entry.
    """

    file: MaterialFile
    path: str
    places: tuple[str, ...]

    def applied(self, scan: Scan) -> Scan:
        """The scan with this map's materials; those that it had before are gone.

        A face of several vertex colours goes with most of its corners, with the first where all three differ.

        Raises:
            InputError: an entry that applies to no face, two that apply to the same face, or colours where the scan
                has none.
        """
        owner = np.full(scan.triangles, -1)
        for number, faces in self._by_component(scan):
            self._claim(owner, faces, number)
        for number, faces in self._by_colour(scan):
            self._claim(owner, faces, number)
        rest = [np.nan] * 3 if self.file.default is None else self.file.default.row
        rows = np.array([*(entry.row for entry in self.file.material), rest])
        return scan.with_materials(rows[owner])  # -1 is the last row

    def _claim(self, owner: np.ndarray, faces: np.ndarray, number: int) -> None:
        taken = faces & (owner >= 0)
        if taken.any():
            other = int(owner[taken][0])
            raise InputError(
                self.places[number],
                f"{_called(self.file.material[number], number)} and {_called(self.file.material[other], other)} both "
                f"apply to {int(taken.sum())} faces",
                "narrow one of them",
            )
        owner[faces] = number

    def _by_component(self, scan: Scan) -> list[tuple[int, np.ndarray]]:
        wanted = [(i, entry.component) for i, entry in enumerate(self.file.material) if entry.component is not None]
        if not wanted:
            return []
        count, of_face = vertex_components(scan.faces, len(scan.vertices))
        by_size = np.argsort(-np.bincount(of_face, minlength=count), kind="stable")
        for number, component in wanted:
            if component >= count:
                have = "one component, 0" if count == 1 else f"{count} components, 0 to {count - 1}"
                raise InputError(
                    self.places[number],
                    f"there is no component {component}: {scan.name} has {have}",
                    "name one of them",
                )
        return [(number, of_face == by_size[component]) for number, component in wanted]

    def _by_colour(self, scan: Scan) -> list[tuple[int, np.ndarray]]:
        wanted = [(i, entry) for i, entry in enumerate(self.file.material) if entry.colour is not None]
        if not wanted:
            return []
        if scan.corner_colours is None:
            raise InputError(
                self.places[wanted[0][0]],
                f"{scan.name} has no colours",
                "name components instead, or export the scan as PLY with its colours",
            )
        colours = scan.corner_colours.astype(np.int16)
        label = np.full(colours.shape[:2], -1)
        for number, entry in wanted:
            tolerance = _DEFAULT_TOLERANCE if entry.tolerance is None else entry.tolerance
            alike = np.abs(colours - np.array(entry.colour, dtype=np.int16)).max(axis=2) <= tolerance
            if not alike.any():
                raise InputError(
                    self.places[number],
                    f"nothing on {scan.name} has the colour {list(entry.colour or ())} within {tolerance}; "
                    f"its commonest are {_commonest(scan.corner_colours)}",
                    "correct the colour or widen the tolerance",
                )
            both = alike & (label >= 0)
            if both.any():
                other = int(label[both][0])
                raise InputError(
                    self.places[number],
                    f"{_called(entry, number)} and {_called(self.file.material[other], other)} both match "
                    f"{int(both.sum())} face corners",
                    "lower a tolerance until they are apart",
                )
            label[alike] = number
        first, second, third = label.T
        face = np.where(second == third, second, first)
        return [(number, face == number) for number, _ in wanted]


def load_materials(path: str | Path) -> MaterialMap:
    """Reads a material map. Raises InputError naming file, line, column and field of every fault."""
    file = load_toml(path, MaterialFile)
    places = key_places(Path(path).read_text(encoding="utf-8").replace("\r\n", "\n"))
    named = []
    for number, entry in enumerate(file.material):
        line, column = places["material", number, "component" if entry.colour is None else "colour"]
        named.append(f"{path}:{line}:{column}")
    return MaterialMap(file, str(path), tuple(named))


def _called(entry: Entry, number: int) -> str:
    return f"material {number}" + (f" ({entry.name})" if entry.name else "")


def _commonest(colours: np.ndarray) -> str:
    packed = colours.reshape(-1, 3).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    found, count = np.unique(packed, return_counts=True)
    most = found[np.argsort(-count, kind="stable")][:_NAMED_COLOURS]
    return ", ".join(str([int(c) >> 16, int(c) >> 8 & 255, int(c) & 255]) for c in most)
