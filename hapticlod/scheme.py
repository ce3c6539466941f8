"""A scheme: a configuration in proportions, which fits every scan. Files: configs/policies/.

A `LodConfig` names triangles and millimetres, so it belongs to one scan. To compare one idea over many scans, a scheme
says how large its levels are in shares of the scan, and its lengths in sizes of the scan or of its simplification.
"""

import tomllib
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from hapticlod.config import Level, LodConfig, load_config
from hapticlod.layout import MAX_LEVELS
from hapticlod.toml import TomlModel, checked, fault_at, load_toml

if TYPE_CHECKING:
    from hapticlod.ladder import Ladder
    from hapticlod.tool import Tool

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]


class SchemeLevel(TomlModel):
    """One level: its triangles as a share of the scan's, its cells in mean edges, its share of the tool's balls."""

    share: Share
    cell_edges: Positive = 4.0
    balls: Share = 1.0


class Scheme(TomlModel):
    """Levels, finest first, and how the loop moves between them; fields not explained here are `LodConfig`'s.

    `l_offsets`: mapping segment inward and outward, in rms offsets between the scan and its coarsest level here; it
    replaces `l_in_mm` and `l_out_mm`. `distances`: where levels change under policy "distance", in shares of the
    scan's extent; they take the place of the speeds.
    """

    name: str = Field(min_length=1)
    policy: Literal["velocity", "distance"] = "velocity"
    speeds_mm_s: tuple[Positive, ...] = ()
    distances: tuple[Share, ...] = ()
    hysteresis: float = Field(default=0.0, ge=0, lt=1)
    dwell_ms: float = Field(default=0.0, ge=0)
    filter_hz: float = Field(default=0.0, ge=0)
    blend_ms: float = Field(default=0.0, ge=0)
    mapping: Literal["paper", "two-sided"] = "two-sided"
    l_in_mm: float = Field(default=0.0, ge=0)
    l_out_mm: float = Field(default=5.0, ge=0)
    l_offsets: Positive | None = None
    shading: bool = False
    crack_mm: float = Field(default=0.0, ge=0)
    levels: tuple[SchemeLevel, ...] = Field(min_length=1, max_length=MAX_LEVELS)

    @model_validator(mode="after")
    def _consistent(self) -> "Scheme":
        used, unused = ("speeds_mm_s", "distances") if self.policy == "velocity" else ("distances", "speeds_mm_s")
        if getattr(self, unused):
            raise fault_at(unused, f"goes with the other policy: under {self.policy} levels change at {used}")
        given: tuple[float, ...] = getattr(self, used)
        if len(given) != len(self.levels) - 1:
            raise fault_at(used, f"{len(self.levels)} levels need {len(self.levels) - 1}, not {len(given)}")
        if any(after <= before for before, after in pairwise(given)):
            raise fault_at(used, "must increase")
        sizes = [(level.share, level.balls) for level in self.levels]
        if any(after[0] > before[0] or after == before for before, after in pairwise(sizes)):
            raise fault_at("levels", "must become coarser, or take fewer balls, one by one")
        return self

    def on(self, ladder: "Ladder", tool: "Tool") -> LodConfig:
        """This scheme on one scan, for one tool. Levels that come out alike are dropped with the threshold before them.

        Raises:
            InputError: the result is no configuration.
        """
        scan = ladder.scan
        thresholds = self.speeds_mm_s if self.policy == "velocity" else [d * scan.extent_mm for d in self.distances]
        levels: list[Level] = []
        kept: list[float] = []
        for i, level in enumerate(self.levels):
            rung = ladder.at(max(1, round(scan.triangles * level.share)))
            made = Level(
                triangles=rung.triangles,
                cell_mm=level.cell_edges * rung.mean_edge_mm,
                balls=max(1, round(tool.balls * level.balls)),
            )
            if levels and (made.triangles, made.balls) == (levels[-1].triangles, levels[-1].balls):
                continue
            if levels:
                kept.append(thresholds[i - 1])
            levels.append(made)
        l_in_mm, l_out_mm = self.l_in_mm, self.l_out_mm
        if self.l_offsets is not None:
            l_in_mm = l_out_mm = self.l_offsets * _offset_mm(ladder, levels[-1].triangles)
        shared = self.model_dump(exclude={"distances", "l_offsets", "levels", "speeds_mm_s", "l_in_mm", "l_out_mm"})
        lengths = {"l_in_mm": l_in_mm, "l_out_mm": l_out_mm}
        values = {**shared, **lengths, "levels": levels, "speeds_mm_s": tuple(kept)}
        return checked(LodConfig, values, f"scheme {self.name} on {scan.name}")


def _offset_mm(ladder: "Ladder", triangles: int) -> float:
    """Rms offset of a level from the scan, read between the rungs around it, whose offsets are known already."""
    sizes = np.log([rung.triangles for rung in ladder.rungs])[::-1]
    offsets = np.array([rung.rms_mm for rung in ladder.rungs])[::-1]
    # Never 0: a mapping needs a length even where simplification loses nothing, as on a plane.
    least = 1e-3 * ladder.rungs[0].mean_edge_mm
    return float(max(np.interp(np.log(triangles), sizes, offsets), least))


def load_scheme(path: str | Path) -> Scheme | LodConfig:
    """Reads a configuration file of either kind: a scheme's levels have a `share`, a configuration's `triangles`.

    Raises:
        InputError: naming file, line, column and field of every fault.
    """
    try:
        levels = tomllib.loads(Path(path).read_text(encoding="utf-8")).get("levels", [])
        in_shares = any(isinstance(level, dict) and "share" in level for level in levels)
    except (OSError, ValueError, TypeError):
        in_shares = False  # what is wrong is said below
    return load_toml(path, Scheme) if in_shares else load_config(path)
