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
from tuning.costing import Costing, entered
from tuning.load import LoadMeter, mean_load
from tuning.sample import threads

# By the clock, a tick's time is its least over at most so many runs: other programs take time, the tick does not.
CLOCK_RUNS = 12
CLOCK_QUANTILES = {"loop_cost_p50_us": 0.5, "loop_cost_p99_us": 0.99, "loop_cost_p999_us": 0.999}


@dataclass(frozen=True)
class Measured:
    """What one run over all motions gave.

    `metrics` are those of `hapticlod.metrics`, costs by counters; `counted_us` the costs behind them and `clock_us`
    what the clock said, on the station and without interrupts: one (T,) float32 array per motion. `variety` of each
    motion: how many levels were used in contact, and switches. `load` of the machine meanwhile: `LoadMeter.read`.
    """

    metrics: dict[str, float]
    counted_us: tuple[NDArray[np.float32], ...]
    clock_us: tuple[NDArray[np.float32], ...]
    variety: tuple[tuple[int, int], ...]
    load: dict[str, float]


@dataclass
class Verifier:
    """Replays configurations over motions kept apart. What was measured once is kept, also between runs.

    A configuration runs once, and its ticks are priced by what they counted: the same figures whenever it is asked
    for, whatever else the machine does, so that configurations are compared and not the noise of their timings. What
    the clock says of one is `clocked`.

    Attributes:
        ladder, tool, station: what is tuned, and for what.
        motions: kept apart from the surrogate's.
        costing: turns counters, or this machine's times, into the station's.
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

    def records(self, config: LodConfig) -> list[Record]:
        """One record per motion; costs as on the station, by counters."""
        return self.runs_of(config)[0]

    def runs_of(self, config: LodConfig) -> tuple[list[Record], tuple[NDArray[np.float32], ...]]:
        """Records, one per motion, and what the clock said of their ticks, us."""
        origin = self.ladder.scan.centre_mm
        with ThreadPoolExecutor(threads()) as pool:
            rungs = pool.map(self.ladder.at, [level.triangles for level in config.levels])
            cells_mm = [level.cell_mm for level in config.levels]
            levels = list(pool.map(lambda rung, cell_mm: runtime_level(rung, origin, cell_mm), rungs, cells_mm))
        factors = np.array([self.costing.levels.factor(level.triangles, level.cell_mm) for level in config.levels])

        def one(motion: Motion) -> tuple[Record, NDArray[np.float32]]:
            # Not cut short: what a configuration costs and feels like is then the same for every budget.
            record = replay_levels(levels, config, origin, motion, self.tool, self.station, 1, cut_short=False)
            rows = record.rows.copy()
            used = np.array(record.level_bytes)[rows["level"]]
            balls = np.array([min(level.balls, self.tool.balls) for level in config.levels])[rows["level"]]
            enters = entered(rows)
            factor = factors[rows["level"]]
            clock_ns = self.costing.cost_ns(record.rows, used, balls, enters, factor)
            rows["cost_ns"] = self.costing.counted_ns(record.rows, used, balls, enters, factor)
            # The costing has counted the slowdown.
            return replace(record, rows=rows, slowdown=1.0), (1e-3 * clock_ns).astype(np.float32)

        with ThreadPoolExecutor(threads()) as pool:
            made = list(pool.map(one, self.motions))
        return [record for record, _ in made], tuple(clock for _, clock in made)

    def reference(self) -> list[Record]:
        """The finest level's records, one per motion."""
        if not self._reference:
            self.measured(finest_only(self.ladder, self.tool))
        if not self._reference:
            asked = kept.key_of("reference", self.key)
            found = kept.load("reference", asked)
            if found is None:
                found = self.records(finest_only(self.ladder, self.tool))
                kept.store("reference", asked, found)
            self._reference = found
        return self._reference

    def measured(self, config: LodConfig) -> dict[str, float]:
        """The metrics, against the finest level on the same motions."""
        found = self.run(config)
        return {**found.metrics, **_misses(found.counted_us, self.station.budget_us)}

    def run(self, config: LodConfig) -> Measured:
        """All that the one run of a configuration gave; the metrics that depend on the budget are not to be used."""
        asked = kept.key_of("measured", self.key, config.changed(name="").model_dump_json())
        found = kept.load("measured", asked) if self.key else None
        if found is None:
            self.runs += 1
            meter = LoadMeter()
            records, clock = self.runs_of(config)
            load = meter.read()
            if config.changed(name="") == finest_only(self.ladder, self.tool).changed(name=""):
                self._reference = records
                if self.key:
                    kept.store("reference", kept.key_of("reference", self.key), records)
            counted = tuple(record.cost_us.astype(np.float32) for record in records)
            found = Measured(measure(records, self.reference()), counted, clock, tuple(map(_variety, records)), load)
            if self.key:
                kept.store("measured", asked, found)
        return found

    def most_varied(self, config: LodConfig) -> Motion:
        """The motion that shows most of a configuration: most levels in contact, then most switches."""
        variety = self.run(config).variety
        return self.motions[max(range(len(self.motions)), key=variety.__getitem__)]

    def first(self, seconds: float) -> Verifier:
        """A verifier of the first so many seconds of every motion."""
        cut = [motion.part(0.0, min(seconds, motion.seconds)) for motion in self.motions]
        reference = [
            replace(record, rows=record.rows[: motion.ticks])
            for record, motion in zip(self.reference(), cut, strict=True)
        ]
        key = f"{self.key} first {seconds!r} s" if self.key else ""
        return Verifier(self.ladder, self.tool, self.station, cut, self.costing, key, 0, reference)

    def affordable(self, config: LodConfig, most_s: float) -> Verifier:
        """This verifier, or one of shorter motions on which a configuration costs no more than about so many seconds.

        For what is measured only to be shown beside the answer, and may cost a hundred times what the answer does.
        """
        longest = max(motion.seconds for motion in self.motions)
        seconds = min(1.0, longest)
        pilot = self.first(seconds)
        costs_s = 1e-6 * sum(float(cost.sum()) for cost in pilot.run(config).counted_us)
        if costs_s * longest / seconds <= most_s:
            return self
        while 2 * seconds * costs_s <= most_s and 2 * seconds < longest:
            seconds *= 2
        return self.first(seconds)

    def clocked(self, config: LodConfig, within_us: float = 0.0) -> dict[str, float]:
        """What the clock says of the loop cost: mean and quantiles, us, of a tick's least time over some runs.

        The run that measured counts as one; others follow until p99.9 is within the bound, at most `CLOCK_RUNS`.
        `load_*`: the machine's load meanwhile (`LoadMeter.read`), mean over the runs. It is kept with the times: who
        asks again gets what they were taken under, not what the machine does now.
        """
        asked = kept.key_of("clocked", self.key, config.changed(name="").model_dump_json())
        found = kept.load("clocked", asked) if self.key else None
        if found is None:
            first = self.run(config)
            found = first.clock_us, [first.load]
        least, loads = found
        while len(loads) < CLOCK_RUNS and clock_metrics(least)["loop_cost_p999_us"] > within_us:
            meter = LoadMeter()
            _, again = self.runs_of(config)
            loads.append(meter.read())
            least = tuple(np.minimum(a, b) for a, b in zip(least, again, strict=True))
            if self.key:
                kept.store("clocked", asked, (least, loads))
        load = {f"load_{key}": value for key, value in mean_load(loads).items()}
        return {**clock_metrics(least), "runs": float(len(loads)), **load}


def clock_metrics(costs_us: Sequence[NDArray]) -> dict[str, float]:
    """Mean and quantiles of the loop cost, us, from (T,) times of every motion."""
    every = np.concatenate(costs_us).astype(np.float64)
    quantiles = np.quantile(every, list(CLOCK_QUANTILES.values()))
    return {"loop_cost_mean_us": float(every.mean()), **dict(zip(CLOCK_QUANTILES, map(float, quantiles), strict=True))}


def _variety(record: Record) -> tuple[int, int]:
    return len(np.unique(record.level[record.contact])), int(np.count_nonzero(np.diff(record.level)))


def _misses(costs_us: Sequence[NDArray], budget_us: float) -> dict[str, float]:
    """The two metrics that depend on the budget, which may be another one than when the ticks were counted."""
    over = [cost > budget_us for cost in costs_us]
    longest = max(int(np.diff(stretches(miss), axis=1).max(initial=0)) for miss in over)
    return {"deadline_miss_rate": float(np.concatenate(over).mean()), "longest_miss_run": float(longest)}
