"""Searching and measuring in turn: what was measured corrects what the surrogate is asked for next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.station import Station
from tuning.objective import holds
from tuning.prepare import Prepared, Stages
from tuning.search import Found, Limits, Search
from tuning.sensitivity import Optimum
from tuning.trials import next_trial
from tuning.verify import Verifier

ROUNDS = 4  # measurements of one level count
RESCUES = 5  # further ones while nothing that was measured holds the budget
FINISH, TRIALS = 2, 8  # and of the best level count, to use what is left of the budget, and near the best
# Before these last ones, while something holds the budget; in all; and in all of a search that goes on from an earlier.
MOST_MEASURED, MOST_IN_ALL, MOST_AGAIN = 10, 18, 4
AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected
# A level count is not measured if it could not win even were it better than predicted by this factor.
HOPE = 0.7
# Nor if fewer levels were predicted as good to this, JND or noticed jumps per second: one more is hardly used.
ALIKE = 1e-3
# A later level count is given up after its first measurement if it could then not be better by this than one before.
WORTH = 0.02
MUCH_LESS = 0.7  # how much less is asked for, at least, after several measurements over the budget in a row
# How much more is asked for, at most, than what held: two noisy tails once made a slope that asked for three times it.
MORE = 1.5
# Slopes of ln (measured / predicted) along ln budget that are believed, and how near to the ends of a bracket one goes.
_SLOPES, _INSET = (-0.8, 3.0), 0.05

Judge = Callable[[LodConfig, dict[str, float]], float]


@dataclass(frozen=True)
class Candidate:
    """A configuration with what was predicted of it and what was measured.

    `found`: its point, and `optimum`: of the search it came from, `correction`: what that search's budget was the
    station's times. `expected_us`: the predicted p99.9 cost, corrected by what had been measured before; None: nothing
    was predicted.
    """

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    objective: float
    feasible: bool
    optimum: Optimum | None = None
    expected_us: float | None = None
    found: Found | None = None
    correction: float = 1.0

    @property
    def disagreement(self) -> float | None:
        """By what part of itself the measured p99.9 cost misses what was expected; None: nothing was."""
        return None if self.expected_us is None else abs(self.expected_us / cost_us(self) - 1.0)


def cost_us(candidate: Candidate) -> float:
    """What the budget limits, as measured."""
    return candidate.measured["loop_cost_p999_us"]


def explore(
    search: Search, verifier: Verifier, ready: Prepared, station: Station, counts: Sequence[int], seed: int,
    stages: Stages, judged: Judge, near: Mapping[int, Candidate] | None = None,
) -> list[Candidate]:  # fmt: skip
    """The best of every level count that may win, measured, and searched again while its cost was predicted wrong.

    The most promising level count comes first; by how much its cost was mispredicted is where the next one begins.
    `near`: by level count, what an earlier search ended with: this one goes on from there, with fewer measurements.
    """
    near = near or {}
    made: list[Candidate] = []
    most = MOST_AGAIN if near else MOST_MEASURED

    def measured(found: Found, optimum: Optimum, correction: float, expected_us: float) -> Candidate:
        stages("verify in the runtime", len(made) / (len(counts) * ROUNDS))
        config = ready.space.config(found.x, optimum.levels, f"{optimum.levels} levels")
        metrics = verifier.measured(config)
        value, fits = judged(config, metrics), holds(metrics, station)
        made.append(Candidate(config, found.predicted, metrics, value, fits, optimum, expected_us, found, correction))
        return made[-1]

    def answer(count: int, found: Found, asked: Correction) -> Candidate:
        expected_us = asked.expected_us(found.predicted["loop_cost_p999_us"])
        return measured(found, Optimum(found.x, count, limits_of(station, asked.value)), asked.value, expected_us)

    def best() -> Candidate | None:
        return min((c for c in made if c.feasible), key=lambda c: c.objective, default=None)

    def least() -> float:
        held = best()
        return np.inf if held is None else held.objective

    stages("optimise", 0.0)
    begin = {count: before.optimum.x for count, before in near.items() if before.optimum is not None}
    every = search.best_of_each(counts, limits_of(station, 1.0), seed, begin)
    correction = 1.0
    ended: dict[int, tuple[Found, Correction]] = {}
    promise = np.inf  # of a level count: its best as predicted, by how much its first was mispredicted
    for count in sorted(counts, key=lambda k: every[k].rank):
        if HOPE * every[count].objective > least() or _hardly_used(every, count):
            continue
        if len(made) >= most and best() is not None:
            break
        found, asked = every[count], Correction(1.0)
        if not made and count in near:
            correction = near[count].correction
        if abs(np.log(correction)) > AGREE:
            stages("optimise", len(made) / (len(counts) * ROUNDS))
            asked = Correction(correction)
            found = search.best(count, limits_of(station, correction), seed, found.x)
        for turn in range(ROUNDS + RESCUES):
            candidate = answer(count, found, asked)
            # Asked for less, the search gave what it gave before: there is nothing cheaper to be had of it.
            stuck = any(turn and candidate.config == other.config for other in made[:-1])
            more = asked.corrected(candidate, station) and not stuck
            if turn == 0:
                before, promise = promise, min(promise, every[count].objective * _mispredicted(candidate))
                if promise > (1.0 - WORTH) * before:
                    break
            rounds = min(ROUNDS, turn + 1 + most - len(made)) if best() is not None else ROUNDS + RESCUES
            if not more or turn + 1 >= rounds:
                break
            stages("optimise", len(made) / (len(counts) * ROUNDS))
            found = search.best(count, limits_of(station, asked.value), seed + turn + 1, found.x)
        correction = asked.value
        ended[count] = found, asked
    held = best()
    if held is None or held.optimum is None:
        return made
    count = held.optimum.levels
    found, asked = ended[count]
    for _ in range(FINISH):
        unused = cost_us(held) < (1.0 - AGREE) * station.budget_us
        if not unused or (near and len(made) >= most) or not asked.goes_on(station, AGREE):
            break
        stages("optimise", 0.9)
        found = search.best(count, limits_of(station, asked.value), seed, found.x)
        asked.take(answer(count, found, asked))
        held = best() or held
        if any(made[-1].config == other.config for other in made[:-1]):
            break
    for turn in range(TRIALS):
        if len(made) >= (most if near else MOST_IN_ALL):
            break
        stages("optimise", 0.95)
        held = best() or held
        like = [c for c in made if c.optimum is not None and c.optimum.levels == count]
        trial = next_trial(held, like, count, search, ready.space, station, np.random.default_rng([seed, turn]))
        if trial is None or held.optimum is None:
            break
        point, expected_us = trial
        whole = search.look(point.x, count, limits_of(station, 1.0))
        measured(whole, held.optimum, held.correction, expected_us)
    return made


def _mispredicted(candidate: Candidate) -> float:
    """Measured over predicted objective."""
    predicted = 0.0 if candidate.found is None else candidate.found.objective
    return candidate.objective / predicted if predicted > 0.0 else 1.0


def _hardly_used(every: Mapping[int, Found], count: int) -> bool:
    fewer = [found for levels, found in every.items() if levels < count]
    return any(abs(found.objective - every[count].objective) < ALIKE and found.excess <= 0.0 for found in fewer)


@dataclass
class Correction:
    """What the surrogate's budget is multiplied by so that the measured cost meets the station's.

    How measured exceeds predicted cost changes with the budget, so the last two measurements make a line of one's
    logarithm along the other's.

    Attributes:
        value: that is in use. held, broke: the largest that was measured within the budget, the least that was not.
        misses: measurements over the budget in a row.
        factors: ln value and ln measured over predicted cost, of every measurement. last: of them.
    """

    value: float
    held: float = 0.0
    broke: float = np.inf
    misses: int = 0
    factors: list[tuple[float, float]] = field(default_factory=list)
    last: Candidate | None = None

    def expected_us(self, predicted_us: float) -> float:
        """What a cost that is predicted at the value in use should be measured as."""
        if not self.factors:
            return predicted_us / self.value
        at, factor, slope = self._line()
        return predicted_us * float(np.exp(factor + slope * (np.log(self.value) - at)))

    def _line(self) -> tuple[float, float, float]:
        """The last point, and the slope there; it is kept where a larger budget still buys more cost."""
        (at, factor), before = self.factors[-1], self.factors[-2:-1]
        slope = (factor - before[0][1]) / (at - before[0][0]) if before and at != before[0][0] else 0.0
        return at, factor, float(np.clip(slope, *_SLOPES))

    def corrected(self, candidate: Candidate, station: Station) -> bool:
        """Takes a measurement in. False: it is as near to the budget as makes sense, or the budget does not bind."""
        self.take(candidate)
        return self.goes_on(station, AGREE)

    def take(self, candidate: Candidate) -> None:
        """Learns from what was measured at the value in use."""
        self.last = candidate
        predicted_us = candidate.predicted["loop_cost_p999_us"]
        self.factors.append((float(np.log(self.value)), float(np.log(cost_us(candidate) / predicted_us))))
        if candidate.feasible:
            self.held, self.misses = max(self.held, self.value), 0
        else:
            self.broke, self.misses = min(self.broke, self.value), self.misses + 1

    def goes_on(self, station: Station, near: float) -> bool:
        """Sets the value that should meet the budget. False: the last is within `near` of it, or it does not bind."""
        assert self.last is not None
        at, factor, slope = self._line()
        value = float(np.exp(at))
        share = self.last.predicted["loop_cost_p999_us"] / (value * station.budget_us)
        wanted = float(np.exp(at + (np.log((1.0 - 0.5 * near) / share) - factor - at) / (1.0 + slope)))
        if self.last.feasible:
            if cost_us(self.last) > (1.0 - near) * station.budget_us or share < 1.0 - AGREE:
                return False
            wanted = float(np.clip(wanted, (1.0 + 0.5 * near) * value, MORE * value))
        else:
            wanted = min(wanted, (1.0 - near if self.misses == 1 else MUCH_LESS) * value)
        if self.held > 0.0 and self.broke < np.inf:
            if self.broke < (1.0 + 0.5 * near) * self.held:
                return False
            inset = min(_INSET * np.log(self.broke / self.held), 0.5 * near)
            wanted = float(np.clip(wanted, self.held * np.exp(inset), self.broke * np.exp(-inset)))
        self.value = float(np.clip(wanted, 0.03, 3.0))
        return True


def limits_of(station: Station, correction: float) -> Limits:
    """Of a station, its budget times the correction."""
    return Limits(station.budget_us * correction, station.memory_mb)
