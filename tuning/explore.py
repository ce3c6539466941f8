"""Searching and measuring in turn: what was measured corrects what the surrogate is asked for next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.config import LodConfig
from hapticlod.station import Station
from tuning.objective import holds
from tuning.prepare import Prepared, Stages
from tuning.search import Found, Limits, Search
from tuning.sensitivity import Optimum
from tuning.verify import Verifier

ROUNDS = 3  # measurements of one level count
RESCUES = 5  # further ones while nothing that was measured holds the budget
AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected
# A level count is not measured if it could not win even were it better than predicted by this factor.
HOPE = 0.7
# How much less is asked for, at least, after one measurement over the budget, and after several in a row.
LESS, MUCH_LESS = 0.95, 0.7

Judge = Callable[[LodConfig, dict[str, float]], float]


@dataclass(frozen=True)
class Candidate:
    """A configuration with what was predicted of it and what was measured; `optimum`: of the search it came from."""

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    objective: float
    feasible: bool
    optimum: Optimum | None = None


def cost_us(candidate: Candidate) -> float:
    """What the budget limits, as measured."""
    return candidate.measured["loop_cost_p999_us"]


def explore(
    search: Search, verifier: Verifier, ready: Prepared, station: Station, counts: Sequence[int], seed: int,
    stages: Stages, judged: Judge, near: Mapping[int, NDArray[np.float64]] | None = None,
) -> list[Candidate]:  # fmt: skip
    """The best of every level count that may win, measured, and searched again while its cost was predicted wrong.

    The most promising level count comes first; by how much its cost was mispredicted is where the next one begins.
    `near`: by level count, where to begin the search.
    """
    made: list[Candidate] = []

    def measured(count: int, found: Found, limits: Limits) -> Candidate:
        stages("verify in the runtime", len(made) / (len(counts) * ROUNDS))
        config = ready.space.config(found.x, count, f"{count} levels")
        metrics = verifier.measured(config)
        optimum = Optimum(found.x, count, limits)
        made.append(
            Candidate(config, found.predicted, metrics, judged(config, metrics), holds(metrics, station), optimum)
        )
        return made[-1]

    def best() -> float:
        return min((c.objective for c in made if c.feasible), default=np.inf)

    stages("optimise", 0.0)
    every = search.best_of_each(counts, limits_of(station, 1.0), seed, near or {})
    correction = 1.0
    for count in sorted(counts, key=lambda k: every[k].rank):
        if HOPE * every[count].objective > best():
            continue
        found, asked = every[count], Correction(1.0)
        if abs(np.log(correction)) > AGREE:
            stages("optimise", len(made) / (len(counts) * ROUNDS))
            asked = Correction(correction)
            found = search.best(count, limits_of(station, correction), seed, found.x)
        for turn in range(ROUNDS + RESCUES):
            candidate = measured(count, found, limits_of(station, asked.value))
            # Asked for less, the search gave what it gave before: there is nothing cheaper to be had of it.
            stuck = any(turn and candidate.config == other.config for other in made[:-1])
            more = asked.corrected(candidate, station) and not stuck
            if not more or turn + 1 >= ROUNDS + (0 if np.isfinite(best()) else RESCUES):
                break
            stages("optimise", len(made) / (len(counts) * ROUNDS))
            found = search.best(count, limits_of(station, asked.value), seed + turn + 1, found.x)
        correction = asked.value
    return made


@dataclass
class Correction:
    """What the surrogate's budget is multiplied by so that the measured cost meets the station's.

    Attributes:
        value: that is in use. held, broke: the largest that was measured within the budget, the least that was not.
        misses: measurements over the budget in a row.
    """

    value: float
    held: float = 0.0
    broke: float = np.inf
    misses: int = 0

    def corrected(self, candidate: Candidate, station: Station) -> bool:
        """Takes a measurement in. False: it is as near to the budget as makes sense, or the budget does not bind."""
        ratio = candidate.predicted["loop_cost_p999_us"] / cost_us(candidate)
        if candidate.feasible:
            self.held, self.misses = max(self.held, self.value), 0
            if cost_us(candidate) > (1.0 - 2 * AGREE) * station.budget_us:
                return False
            if candidate.predicted["loop_cost_p999_us"] < (1.0 - 2 * AGREE) * self.value * station.budget_us:
                return False
            wanted = max(ratio, self.value / LESS)
        else:
            self.broke, self.misses = min(self.broke, self.value), self.misses + 1
            wanted = min(ratio, (LESS if self.misses == 1 else MUCH_LESS) * self.value)
        if self.held > 0.0 and self.broke < np.inf:
            if self.broke < (1.0 + AGREE) * self.held:
                return False
            wanted = float(np.sqrt(self.held * self.broke))
        self.value = float(np.clip(wanted, 0.03, 3.0))
        return True


def limits_of(station: Station, correction: float) -> Limits:
    """Of a station, its budget times the correction."""
    return Limits(station.budget_us * correction, station.memory_mb)
