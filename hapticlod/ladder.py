"""The ladder: nested simplifications of one scan, from the scan itself down to a few hundred triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hapticlod.caps import contract_dust, flip_caps, is_flat
from hapticlod.closest import SurfaceIndex
from hapticlod.collapse import CollapseList, collapse
from hapticlod.deviation import Deviation, ScanSurface
from hapticlod.errors import InputError
from hapticlod.material import face_areas, transferred, vertex_areas
from hapticlod.measured_rung import MeasuredRung
from hapticlod.repair import DEGENERATE_HEIGHT_OF_EXTENT
from hapticlod.rung_check import Sides, UnsoundRung, checked_deviation
from hapticlod.scan import Scan
from hapticlod.topology import vertex_components

STAGE = "simplify into a ladder and measure the rungs"
# A rung that is less than this part smaller than the one before tells nothing new.
_LEAST_STEP = 0.03
_NOTED_AREA = 0.02  # of the scan's: a rung's loss of area that is worth a note
_REMEMBERED = 32  # rungs of `at` that are kept

Keep = Callable[[str, Callable[[], Any]], Any]
"""Is given the name of a piece of work and what does it; gives its result, made now or kept since an earlier run."""


def make_anew(name: str, make: Callable[[], Any]) -> Any:
    """A `Keep` that keeps nothing."""
    return make()


@dataclass(frozen=True, eq=False)
class Rung(MeasuredRung):
    """One simplification of the scan.

    Attributes:
        vertices: (v, 3) float64 mm. faces: (f, 3) int32, facing as the scan does. Both in the scan's spatial order.
        vertex_map: (n,) int32, for every vertex of the scan the vertex of this rung that it became part of. Two
            vertices that share one on a rung share one on every coarser rung. Where the last face around a vertex was
            removed, it counts to a neighbour; a vertex may be without faces.
        asked: number of triangles asked for. `triangles` may be larger where no more could be collapsed without
            turning faces over, and smaller by one or two because a collapse removes a pair.
        materials: (v, 3) of `hapticlod.material`; None where the scan has none.
    """

    vertices: np.ndarray
    faces: np.ndarray
    vertex_map: np.ndarray
    asked: int
    _scan: ScanSurface = field(repr=False)
    materials: np.ndarray | None = field(default=None, repr=False)

    @property
    def triangles(self) -> int:
        """Number of faces."""
        return len(self.faces)

    @cached_property
    def mean_edge_mm(self) -> float:
        """Mean length of the sides of all faces (an edge between two faces counts twice)."""
        sides = self.vertices[self.faces] - self.vertices[self.faces[:, [1, 2, 0]]]
        return float(np.sqrt(np.einsum("ijk,ijk->ij", sides, sides)).mean())

    @cached_property
    def area_mm2(self) -> float:
        """Area of all faces."""
        return float(face_areas(self.vertices, self.faces).sum())

    @cached_property
    def components(self) -> int:
        """How many parts its faces form, joined through shared vertices."""
        return vertex_components(self.faces, len(self.vertices))[0]

    @cached_property
    def deviation(self) -> Deviation:
        """Distance to the scan, measured and checked when first asked for: see `ScanSurface` for the sampling."""
        if self.vertices is self._scan.vertices:
            return Deviation(0.0, 0.0, 0.0)
        mesh = SurfaceIndex(self.vertices, self.faces)
        said = self._scan.deviation(self.vertices, self.faces, self.vertex_map, mesh)
        return checked_deviation(said, self._scan, self.vertices, self.faces, mesh)

    def _measure(self, keep: Keep, name: str) -> None:
        vars(self)["deviation"] = keep(name, lambda: self.deviation)  # where the cached property looks first


@dataclass(frozen=True, eq=False)
class Ladder:
    """A scan and its rungs, finest first; rung 0 is the scan itself.

    Attributes:
        scan: the scan. rungs: strictly falling in triangles.
        notes: what did not go as asked, one sentence each.
    """

    scan: Scan
    rungs: tuple[Rung, ...]
    notes: tuple[str, ...]
    _collapses: CollapseList = field(repr=False)
    _sides: Sides = field(repr=False)
    _last: int = field(repr=False)  # collapses of the coarsest rung that may be touched
    _made: dict[int, Rung] = field(repr=False, default_factory=dict)

    def at(self, triangles: int) -> Rung:
        """The rung with at most so many triangles that is nearest to them: a prefix of the list of collapses.

        Counts above the scan's give the scan; counts below what simplification can reach give the coarsest.

        Raises:
            InputError: `triangles` is less than 1.
            UnsoundRung: what simplification gave there must not be touched.
        """
        if triangles < 1:
            raise InputError(f"{triangles} triangles", "is less than 1", "ask for a positive number of triangles")
        for rung in (*self.rungs, *self._made.values()):
            if rung.triangles == triangles:
                return rung
        if triangles >= self.scan.triangles:
            return self.rungs[0]
        steps = min(self._collapses.collapses_for(triangles), self._last)
        made = self._made.get(steps)
        if made is None:
            if len(self._made) >= _REMEMBERED:
                self._made.pop(next(iter(self._made)), None)
            made = _rung(self._collapses, steps, triangles, self.scan, self.rungs[0]._scan, self._sides)
            self._made[steps] = made  # several threads may ask, and two for the same
        return made


def build_ladder(
    scan: Scan,
    rungs: int = 12,
    coarsest_ratio: float = 300.0,
    *,
    progress: Callable[[str, float], None] | None = None,
    keep: Keep = make_anew,
    meshed: Callable[[Sequence[Rung]], None] | None = None,
) -> Ladder:
    """Simplify a scan once and cut the list of collapses into rungs, evenly spaced in the logarithm of their size.

    Args:
        scan: a cleaned scan.
        rungs: how many, at least 1; fewer come back where simplification stops early or the scan is small.
        coarsest_ratio: the scan's triangles over those of the coarsest rung.
        progress: called with the stage and how much of it is done, 0 to 1.
        keep: asked for the list of collapses and for every rung's deviation: what takes long on a large scan.
        meshed: called once with all rungs, before they are measured, which takes most of the time.

    Raises:
        InputError: fewer than 1 rung or a ratio below 1.
    """
    if rungs < 1:
        raise InputError(f"rungs = {rungs}", "is less than 1", "ask for about 12")
    if not 1.0 <= coarsest_ratio < float("inf"):
        raise InputError(f"coarsest_ratio = {coarsest_ratio}", "is not a number from 1 up", "use about 300")
    tell = progress or (lambda stage, part: None)
    tell(STAGE, 0.0)
    count = scan.triangles
    targets = [max(1, round(count * coarsest_ratio ** (-i / max(1, rungs - 1)))) for i in range(rungs)]
    surface = ScanSurface(scan.vertices, scan.faces)
    collapses: CollapseList = keep("collapses", lambda: collapse(scan.vertices, scan.faces, targets[-1]))
    same = np.arange(len(scan.vertices), dtype=np.int32)
    finest = Rung(scan.vertices, scan.faces, same, count, surface, scan.vertex_materials)
    made, steps_of, refused, last = [finest], [0], "", 0
    sides = Sides(scan.vertices, scan.faces)
    tell(STAGE, 0.2)
    for target in targets[1:]:
        steps = collapses.collapses_for(target)
        try:
            rung = _rung(collapses, steps, target, scan, surface, sides)
        except UnsoundRung as fault:
            refused = f"rungs below {made[-1].triangles} triangles are left out: the next one {fault}"
            break
        last = steps
        if rung.triangles > (1.0 - _LEAST_STEP) * made[-1].triangles:
            continue
        made.append(rung)
        steps_of.append(steps)
    if meshed is not None:
        meshed(made)
    for number, (rung, steps) in enumerate(zip(made[1:], steps_of[1:], strict=True), start=1):
        rung._measure(keep, f"deviation after {steps} collapses")  # now, while progress is shown
        tell(STAGE, 0.2 + 0.8 * number / len(made))
    tell(STAGE, 1.0)
    notes = ((refused,) if refused else ()) + _notes(made, targets, bool(refused))
    return Ladder(scan, tuple(made), notes, collapses, sides, last)


def _rung(collapses: CollapseList, steps: int, asked: int, scan: Scan, surface: ScanSurface, sides: Sides) -> Rung:
    vertices, faces, vertex_map = collapses.mesh(steps)
    sides.check(vertices, faces, collapses.alive(steps))
    height = DEGENERATE_HEIGHT_OF_EXTENT * scan.extent_mm
    if is_flat(vertices, faces, height).any():
        # Vertices that came to lie on one point share faces from here on; the map still tells them apart.
        faces = contract_dust(vertices, faces, height)[faces]
        faces = flip_caps(vertices, faces[~is_flat(vertices, faces, 0.0)], height)
        faces = faces[~is_flat(vertices, faces, height)]
    faces = faces.astype(np.int32)
    for array in (vertices, faces, vertex_map):
        array.setflags(write=False)
    materials = None
    if (values := scan.vertex_materials) is not None:
        materials = transferred(values, vertex_areas(scan.vertices, scan.faces), vertex_map, vertices)
    return Rung(vertices, faces, vertex_map, asked, surface, materials)


def _notes(made: list[Rung], targets: list[int], was_refused: bool) -> tuple[str, ...]:
    notes = []
    coarsest = made[-1]
    if len(made) < len(targets) and not was_refused:
        notes.append(
            f"{len(made)} rungs instead of {len(targets)}: simplification stopped at {coarsest.triangles} triangles, "
            f"{targets[-1]} were asked for"
        )
    elif coarsest.is_larger_than_asked and not was_refused:
        notes.append(f"the coarsest rung has {coarsest.triangles} triangles, {targets[-1]} were asked for")
    if (parts := made[0].components) > 1 and coarsest.components < parts:
        notes.append(
            f"of {parts} parts the coarsest rung has {coarsest.components}: a part is left out where it is smaller "
            "than the rung's mean edge"
        )
    part = coarsest.area_mm2 / made[0].area_mm2
    if abs(part - 1.0) > _NOTED_AREA:
        notes.append(f"the coarsest rung of {coarsest.triangles} triangles has {100 * part:.0f} % of the scan's area")
    turned = max(made, key=lambda rung: rung.deviation.turned_part)
    if turned.deviation.turned_part > 0.01:
        notes.append(
            f"{100 * turned.deviation.turned_part:.1f} % of the rung of {turned.triangles} triangles lie nearer to the "
            "other side of a thin or folded part than to their own"
        )
    return tuple(notes)
