"""Measuring configurations in the runtime, on motions that the surrogate has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hapticlod.config import Level, LodConfig
from hapticlod.ladder import Ladder
from hapticlod.metrics import measure
from hapticlod.motion import Motion
from hapticlod.replay import Record, replay_levels, runtime_level
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.sample import Costing

# A tick's time is its least over so many runs: other programs take time, the tick does not.
REPEATS = 3
# The paper's dentition: triangles per level, switching speeds, L (Zhou et al. 2009, section 3.3, table 4).
PAPER_TRIANGLES = (66224, 26556, 14830)
PAPER_SPEEDS_MM_S = (30.0, 120.0)
PAPER_L_MM = 5.0


@dataclass
class Verifier:
    """Replays configurations over motions kept apart. Levels that were built once are kept.

    Attributes:
        ladder, tool, station: what is tuned, and for what.
        motions: kept apart from the surrogate's.
        costing: turns this machine's times into the station's.
    """

    ladder: Ladder
    tool: Tool
    station: Station
    motions: Sequence[Motion]
    costing: Costing
    _reference: list[Record] = field(default_factory=list)

    def records(self, config: LodConfig, repeats: int = REPEATS) -> list[Record]:
        """One record per motion, costs as on the station."""
        origin = self.ladder.scan.centre_mm
        levels = [runtime_level(self.ladder.at(level.triangles), origin, level.cell_mm) for level in config.levels]
        made = []
        for motion in self.motions:
            record = replay_levels(levels, config, origin, motion, self.tool, self.station, repeats)
            rows = record.rows.copy()
            used = np.array(record.level_bytes)[rows["level"]]
            rows["cost_ns"] = self.costing.cost_ns(record.rows, used)
            made.append(replace(record, rows=rows, slowdown=1.0))  # the costing has counted the slowdown
        return made

    def measured(self, config: LodConfig) -> dict[str, float]:
        """The metrics, against the finest level on the same motions."""
        if not self._reference:
            self._reference = self.records(self.finest(), 1)
        return measure(self.records(config), self._reference)

    def fixed(self, triangles: int, name: str) -> LodConfig:
        """The configuration that stays on one level, with the whole tool."""
        rung = self.ladder.at(triangles)
        level = Level(triangles=rung.triangles, cell_mm=4.0 * rung.mean_edge_mm, balls=self.tool.balls)
        return LodConfig(name=name, levels=(level,))

    def finest(self) -> LodConfig:
        """The scan itself."""
        return self.fixed(self.ladder.scan.triangles, "finest only")

    def coarsest(self) -> LodConfig:
        """The last rung."""
        return self.fixed(self.ladder.rungs[-1].triangles, "coarsest only")

    def paper(self) -> LodConfig:
        """The paper's dentition in its proportions on this scan: its speeds, its L, its mapping, no filter."""
        made, speeds = [], []
        for i, count in enumerate(PAPER_TRIANGLES):
            wanted = round(self.ladder.scan.triangles * count / PAPER_TRIANGLES[0])
            rung = self.ladder.at(max(wanted, 1))
            level = Level(triangles=rung.triangles, cell_mm=4.0 * rung.mean_edge_mm, balls=self.tool.balls)
            if made and level.triangles >= made[-1].triangles:
                continue
            if made:
                speeds.append(PAPER_SPEEDS_MM_S[i - 1])
            made.append(level)
        return LodConfig(
            name="the paper's", levels=tuple(made), speeds_mm_s=tuple(speeds), mapping="paper", l_out_mm=PAPER_L_MM
        )
