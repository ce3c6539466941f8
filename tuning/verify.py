"""Measuring configurations in the runtime, on motions that the surrogate has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hapticlod.config import LodConfig
from hapticlod.contact_events import stretches
from hapticlod.ladder import Ladder
from hapticlod.metrics import measure
from hapticlod.motion import Motion
from hapticlod.replay import Record, replay_levels, runtime_level
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning import kept
from tuning.baselines import finest_only
from tuning.sample import Costing, threads

# A tick's time is its least over so many runs: other programs take time, the tick does not.
REPEATS = 2


@dataclass
class Verifier:
    """Replays configurations over motions kept apart. What was measured once is kept, also between runs.

    Attributes:
        ladder, tool, station: what is tuned, and for what.
        motions: kept apart from the surrogate's.
        costing: turns this machine's times into the station's.
        key: of ladder, tool, motions and costing; empty: nothing is kept between runs.
        runs: how many configurations were really measured.
    """

    ladder: Ladder
    tool: Tool
    station: Station
    motions: Sequence[Motion]
    costing: Costing
    key: str = ""
    runs: int = 0
    _reference: list[Record] = field(default_factory=list)

    def records(
        self, config: LodConfig, repeats: int = REPEATS, before: Sequence[Record] | None = None
    ) -> list[Record]:
        """One record per motion, costs as on the station. `before`: of runs of the same configuration, which count."""
        origin = self.ladder.scan.centre_mm
        levels = [runtime_level(self.ladder.at(level.triangles), origin, level.cell_mm) for level in config.levels]

        def one(index: int) -> Record:
            motion = self.motions[index]
            # Not cut short: what a configuration costs and feels like is then the same for every budget.
            record = replay_levels(levels, config, origin, motion, self.tool, self.station, repeats, cut_short=False)
            rows = record.rows.copy()
            used = np.array(record.level_bytes)[rows["level"]]
            rows["cost_ns"] = self.costing.cost_ns(record.rows, used)
            if before is not None:
                rows["cost_ns"] = np.minimum(rows["cost_ns"], before[index].rows["cost_ns"])
            return replace(record, rows=rows, slowdown=1.0)  # the costing has counted the slowdown

        with ThreadPoolExecutor(threads()) as pool:
            return list(pool.map(one, range(len(self.motions))))

    def reference(self) -> list[Record]:
        """The finest level's records, one per motion; its times are those of a single run."""
        if not self._reference:
            asked = kept.key_of("reference", self.key)
            found = kept.load("reference", asked) if self.key else None
            if found is None:
                found = self.records(finest_only(self.ladder, self.tool), 1)
                if self.key:
                    kept.store("reference", asked, found)
            self._reference = found
        return self._reference

    def measured(self, config: LodConfig, repeats: int = REPEATS) -> dict[str, float]:
        """The metrics, against the finest level on the same motions."""
        asked = kept.key_of("measured", self.key, config.changed(name="").model_dump_json(), repeats)
        found = kept.load("measured", asked) if self.key else None
        if found is None:
            reference = self.reference()
            self.runs += 1
            finest = finest_only(self.ladder, self.tool).changed(name=config.name)
            run_before = config == finest and repeats > 1  # the reference is one of its runs
            records = self.records(config, repeats - 1, reference) if run_before else self.records(config, repeats)
            found = measure(records, reference), [record.cost_us.astype(np.float32) for record in records]
            if self.key:
                kept.store("measured", asked, found)
        metrics, costs = found
        return {**metrics, **_misses(costs, self.station.budget_us)}


def _misses(costs_us: Sequence[NDArray], budget_us: float) -> dict[str, float]:
    """The two metrics that depend on the budget, which may be another one than when the ticks were timed."""
    over = [cost > budget_us for cost in costs_us]
    longest = max(int(np.diff(stretches(miss), axis=1).max(initial=0)) for miss in over)
    return {"deadline_miss_rate": float(np.concatenate(over).mean()), "longest_miss_run": float(longest)}
