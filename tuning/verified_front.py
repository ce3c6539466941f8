"""A front that was measured: what does not hold its budget is searched again, what holds a smaller one is reused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.station import Station
from tuning.candidate import Candidate
from tuning.correction import Correction
from tuning.objective import holds
from tuning.search import Found, Limits, Search
from tuning.sensitivity import Optimum
from tuning.space import Space
from tuning.verify import Verifier

ROUNDS = 4  # measurements for one budget


@dataclass(frozen=True)
class Point:
    """What is known of one budget: its best candidate, and whether that holds the budget as measured."""

    budget_us: float
    candidate: Candidate
    holds: bool


def verified_points(
    optima: Sequence[Optimum], found: Sequence[Found], search: Search, space: Space, verifier: Verifier,
    station: Station, judged: Callable[[LodConfig, dict[str, float]], float], seed: int,
    told: Callable[[str, float], None],
) -> list[Point]:  # fmt: skip
    """The best measured candidate of every budget, rising; the nearest to it where none holds it.

    What a configuration costs does not depend on the budget, so everything measured is a candidate for every budget
    that it holds: the measured objective never rises with the budget.

    Args:
        optima: of the surrogate, one per budget. found: what the surrogate says of them.
        verifier: of motions kept apart. judged: the objective by what was measured.
        station: its budget does not matter, its memory limit does.
    """
    made: list[Candidate] = []
    for i, (optimum, seen) in enumerate(zip(optima, found, strict=True)):
        told("verify in the runtime", i / len(optima))
        there = station.adjusted(budget_us=optimum.limits.budget_us)
        asked, at = Correction(1.0), seen
        for turn in range(ROUNDS):
            config = space.config(at.x, optimum.levels, f"{there.budget_us:g} us")
            metrics = verifier.measured(config)
            limits = Limits(asked.value * there.budget_us, there.memory_mb)
            meant = Optimum(at.x, optimum.levels, limits)
            made.append(Candidate(config, at.predicted, metrics, judged(config, metrics), holds(metrics, there), meant))
            if not asked.corrected(made[-1], there) or turn + 1 == ROUNDS:
                break
            limits = Limits(asked.value * there.budget_us, there.memory_mb)
            at = search.best(optimum.levels, limits, seed + turn, at.x)
    return [best_of(made, optimum.limits.budget_us, station) for optimum in optima]


def best_of(made: Sequence[Candidate], budget_us: float, station: Station) -> Point:
    """The best that holds a budget and the station's memory; where none does, the one that exceeds them least."""
    there = station.adjusted(budget_us=budget_us)
    held = [candidate for candidate in made if holds(candidate.measured, there)]
    if held:
        return Point(budget_us, min(held, key=lambda candidate: candidate.objective), True)
    return Point(budget_us, min(made, key=lambda candidate: _excess(candidate, there)), False)


def _excess(candidate: Candidate, station: Station) -> float:
    cost, memory = candidate.measured["loop_cost_p999_us"], candidate.measured["memory_mb"]
    return float(np.log(max(cost / station.budget_us, memory / station.memory_mb)))
