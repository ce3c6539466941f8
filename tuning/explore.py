"""Searching and measuring in turn: what was measured corrects what the surrogate is asked for next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapticlod.config import LodConfig
from hapticlod.station import Station
from tuning.prepare import Prepared, Stages
from tuning.search import Found, Limits, Search
from tuning.sensitivity import Optimum
from tuning.verify import Verifier

ROUNDS = 4
RESCUES = 4  # further rounds while nothing that was measured holds the budget
LEADERS = 2  # level counts that are looked at again when prediction and measurement differ
AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected

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


def holds(metrics: Mapping[str, float], station: Station) -> bool:
    """Whether budget and memory hold."""
    return metrics["loop_cost_p999_us"] <= station.budget_us and metrics["memory_mb"] <= station.memory_mb


def cost_us(candidate: Candidate) -> float:
    """What the budget limits, as measured."""
    return candidate.measured["loop_cost_p999_us"]


def explore(
    search: Search, verifier: Verifier, ready: Prepared, station: Station, counts: Sequence[int], seed: int,
    stages: Stages, judged: Judge, near: Mapping[int, NDArray[np.float64]] | None = None,
) -> list[Candidate]:  # fmt: skip
    """The best of every level count, measured; then the leaders again, with the surrogate's budget corrected.

    `near`: by level count, where to begin.
    """
    made: list[Candidate] = []
    warm: dict[int, NDArray[np.float64]] = {}

    def verified(count: int, found: Found, limits: Limits) -> Candidate:
        stages("verify in the runtime", len(made) / (len(counts) + LEADERS))
        warm[count] = found.x
        config = ready.space.config(found.x, count, f"{count} levels")
        metrics = verifier.measured(config)
        optimum = Optimum(found.x, count, limits)
        made.append(
            Candidate(config, found.predicted, metrics, judged(config, metrics), holds(metrics, station), optimum)
        )
        return made[-1]

    stages("optimise", 0.0)
    whole = limits_of(station, 1.0)
    every = search.best_of_each(counts, whole, seed, near or {})
    latest = {count: verified(count, found, whole) for count, found in every.items()}
    used = dict.fromkeys(latest, 1.0)
    for turn in range(1, ROUNDS + RESCUES):
        rescuing = not any(candidate.feasible for candidate in made)
        if turn >= ROUNDS and not rescuing:
            break
        corrections = {count: _correction(latest[count], station) for count in latest}
        wrong = [count for count in latest if corrections[count] is not None]
        # Those that could still win: the best by what was measured, whether or not they held the budget. While none
        # did, those that came nearest to holding it.
        for count in sorted(wrong, key=lambda k: cost_us(latest[k]) if rescuing else latest[k].objective)[:LEADERS]:
            stages("optimise", len(made) / (len(counts) + LEADERS))
            correction = float(corrections[count] or 1.0)
            if not latest[count].feasible:
                correction = min(correction, 0.7 * used[count])  # what was asked for last time was too much
            used[count] = correction
            limits = limits_of(station, correction)
            latest[count] = verified(count, search.best(count, limits, seed + turn, warm[count]), limits)
    return made


def _correction(candidate: Candidate, station: Station) -> float | None:
    """What the surrogate's budget must be multiplied by so that the measured cost meets it; None: they agree."""
    predicted, measured = candidate.predicted["loop_cost_p999_us"], cost_us(candidate)
    apart = measured / station.budget_us
    if candidate.feasible and apart > 1.0 - 2 * AGREE:
        return None  # as near to the budget as makes sense
    if candidate.feasible and predicted < (1.0 - 2 * AGREE) * station.budget_us:
        return None  # the budget does not bind
    return float(np.clip(predicted / measured, 0.1, 2.0))


def limits_of(station: Station, correction: float) -> Limits:
    """Of a station, its budget times the correction."""
    return Limits(station.budget_us * correction, station.memory_mb)
