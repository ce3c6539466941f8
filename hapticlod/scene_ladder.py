"""The ladder of a scene: every part has its own; a rung shows one share of each, within the part's bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, cast

import numpy as np

from hapticlod.deviation import Deviation
from hapticlod.errors import InputError
from hapticlod.ladder import STAGE, Keep, Ladder, Rung, build_ladder, make_anew
from hapticlod.measured_rung import MeasuredRung
from hapticlod.scan import Scan
from hapticlod.scene import Scene

_RUNGS, _COARSEST_RATIO = 12, 300.0
_LEAST_STEP = 0.03
_REMEMBERED = 32


@dataclass(frozen=True, eq=False)
class SceneRung(MeasuredRung):
    """A rung of every part; seen as one mesh it has what a `Rung` has, and passes for one (`ladder_of`).

    Attributes:
        parts: in the order of the scene's parts. asked: the number of triangles asked for.
        hidden: a bit for each part that the scene begins without.
    """

    parts: tuple[Rung, ...]
    asked: int
    hidden: int = 0

    @cached_property
    def triangles(self) -> int:
        """Number of faces."""
        return sum(rung.triangles for rung in self.parts)

    @cached_property
    def vertices(self) -> np.ndarray:
        """(v, 3) of all parts."""
        return np.concatenate([rung.vertices for rung in self.parts])

    @cached_property
    def faces(self) -> np.ndarray:
        """(f, 3) of all parts."""
        first = np.cumsum([0] + [len(rung.vertices) for rung in self.parts])
        return np.concatenate([rung.faces + first[i] for i, rung in enumerate(self.parts)]).astype(np.int32)

    @cached_property
    def materials(self) -> np.ndarray | None:
        """(v, 3), NaN where a part has none; None where no part has any."""
        if all(rung.materials is None for rung in self.parts):
            return None
        empty = [np.full((len(rung.vertices), 3), np.nan) for rung in self.parts]
        return np.concatenate(
            [e if rung.materials is None else rung.materials for e, rung in zip(empty, self.parts, strict=True)]
        )

    @cached_property
    def mean_edge_mm(self) -> float:
        """Mean length of the sides of all faces."""
        return sum(rung.mean_edge_mm * rung.triangles for rung in self.parts) / self.triangles

    @property
    def area_mm2(self) -> float:
        """Area of all faces."""
        return sum(rung.area_mm2 for rung in self.parts)

    @property
    def components(self) -> int:
        """How many pieces the faces form: those of every part, which share no vertices."""
        return sum(rung.components for rung in self.parts)

    @cached_property
    def deviation(self) -> Deviation:
        """Of all parts: squares weighted by area, the greatest distance, turned area over area."""
        areas = np.array([rung.area_mm2 for rung in self.parts])
        each = [rung.deviation for rung in self.parts]
        weight = areas / areas.sum()
        return Deviation(
            math.sqrt(sum(w * d.rms_mm**2 for w, d in zip(weight, each, strict=True))),
            max(d.hausdorff_mm for d in each),
            float(sum(w * d.turned_part for w, d in zip(weight, each, strict=True))),
        )


@dataclass(frozen=True, eq=False)
class SceneLadder:
    """Ladders of all parts, and rungs of the scene: what the tuner takes for the ladder of a scan.

    Attributes:
        scan: the scene. rungs: strictly falling in triangles. ladders: of the parts. notes: whose, and what.
    """

    scan: Scene
    rungs: tuple[SceneRung, ...]
    ladders: tuple[Ladder, ...]
    notes: tuple[str, ...]
    _made: dict[int, SceneRung] = field(repr=False, default_factory=dict)

    def at(self, triangles: int) -> SceneRung:
        """The rung of at most so many triangles, as far as the parts' bounds allow it. Raises InputError below 1."""
        if triangles < 1:
            raise InputError(f"{triangles} triangles", "is less than 1", "ask for a positive number of triangles")
        for rung in (*self.rungs, *self._made.values()):
            if rung.triangles == triangles:
                return rung
        if triangles >= self.rungs[0].triangles:
            return self.rungs[0]
        made = self._made.get(triangles)
        if made is None:
            if len(self._made) >= _REMEMBERED:
                self._made.pop(next(iter(self._made)), None)
            made = _rung(self.scan, self.ladders, share_for(self.scan, triangles), triangles)
            self._made[triangles] = made  # several threads may ask, and two for the same
        return made


def ladder_of(
    scan: Scan,
    *,
    progress: Callable[[str, float], None] | None = None,
    keep: Keep = make_anew,
    meshed: Callable[[Sequence[Rung]], None] | None = None,
) -> Ladder:
    """The ladder of a scan, or of a scene, which has everything that the tuner asks of one: see `build_ladder`.

    A scene's parts are measured one by one: `meshed` is told its rungs when they are all known.
    """
    if not isinstance(scan, Scene):
        return build_ladder(scan, progress=progress, keep=keep, meshed=meshed)
    ladder = cast(Ladder, build_scene_ladder(scan, progress=progress, keep=keep))
    if meshed is not None:
        meshed(ladder.rungs)
    return ladder


def share_for(scene: Scene, triangles: int) -> float:
    """The share of every part at which, bounds observed, the scene has at most so many triangles."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if sum(part.triangles_at(middle) for part in scene.parts) > triangles:
            high = middle
        else:
            low = middle
    return low


def build_scene_ladder(
    scene: Scene, *, progress: Callable[[str, float], None] | None = None, keep: Keep = make_anew
) -> SceneLadder:
    """Simplify every part once, and cut rungs of equal shares. Raises what `build_ladder` raises."""
    tell = progress or (lambda stage, part: None)
    ladders: list[Ladder] = []
    done = 0
    for part in scene.parts:
        ratio = max(part.scan.triangles / max(part.triangles_at(1.0 / _COARSEST_RATIO), 1), 1.0)
        rungs = _RUNGS if ratio > 1.0 else 1
        of_part = partial(_keep_of_part, keep, part.name)
        ladders.append(build_ladder(part.scan, rungs=rungs, coarsest_ratio=ratio, keep=of_part))
        done += part.scan.triangles
        tell(STAGE, done / scene.triangles)
    shares = [_COARSEST_RATIO ** (-i / (_RUNGS - 1)) for i in range(_RUNGS)]
    made: list[SceneRung] = []
    for share in shares:
        asked = sum(part.triangles_at(share) for part in scene.parts)
        rung = _rung(scene, ladders, share, asked)
        if not made or rung.triangles <= (1.0 - _LEAST_STEP) * made[-1].triangles:
            made.append(rung)
    notes = tuple(f"{p.name}: {n}" for p, ladder in zip(scene.parts, ladders, strict=True) for n in ladder.notes)
    return SceneLadder(scene, tuple(made), tuple(ladders), notes)


def _keep_of_part(keep: Keep, part: str, name: str, make: Callable[[], Any]) -> Any:
    return keep(f"{part}: {name}", make)


def _rung(scene: Scene, ladders: Sequence[Ladder], share: float, asked: int) -> SceneRung:
    each = zip(scene.parts, ladders, strict=True)
    hidden = sum(1 << i for i, part in enumerate(scene.parts) if part.hidden)
    return SceneRung(tuple(ladder.at(part.triangles_at(share)) for part, ladder in each), asked, hidden)
