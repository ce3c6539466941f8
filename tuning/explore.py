"""Searching and measuring in turn: what was measured corrects what the surrogate is asked for next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.station import Station
from tuning.candidate import Candidate, cost_us
from tuning.correction import AGREE, Correction, limits_of
from tuning.objective import holds
from tuning.prepare import Prepared, Stages
from tuning.search import Found, Search
from tuning.sensitivity import Optimum
from tuning.trials import next_trial
from tuning.verify import Verifier

ROUNDS = 4  # measurements of one level count
RESCUES = 5  # further ones while nothing that was measured holds the budget
FINISH, TRIALS = 2, 8  # and of the best level count, to use what is left of the budget, and near the best
# Fewer near the best where levels are large: to make and build them takes longer than they are touched for.
FEWEST_TRIALS, _TRIED_TRIANGLES = 2, 2e6
# Before these last ones, while something holds the budget; in all; and in all of a search that goes on from an earlier.
MOST_MEASURED, MOST_IN_ALL, MOST_AGAIN = 10, 18, 4
# A level count is not measured if it could not win even were it better than predicted by this factor.
HOPE = 0.7
# Nor if fewer levels were predicted as good to this, JND or noticed jumps per second: one more is hardly used.
ALIKE = 1e-3
# A later level count is given up after its first measurement if it could then not be better by this than one before.
WORTH = 0.02

Judge = Callable[[LodConfig, dict[str, float]], float]


def explore(
    search: Search, verifier: Verifier, ready: Prepared, station: Station, counts: Sequence[int], seed: int,
    stages: Stages, judged: Judge, near: Mapping[int, Candidate] | None = None,
) -> list[Candidate]:  # fmt: skip
    """The best of every level count that may win, measured, and searched again while its cost was predicted wrong.

    The most promising level count comes first; by how much its cost was mispredicted is where the next one begins.
    `near`: by level count, what an earlier search ended with: this one goes on from there, with fewer measurements.
    """
    run = _Exploration(search, verifier, ready, station, seed, stages, judged, len(counts) * ROUNDS)
    near = near or {}
    ended = run.level_counts(counts, near, MOST_AGAIN if near else MOST_MEASURED)
    best = run.best
    if best is not None and best.optimum is not None:
        levels, most = best.optimum.levels, MOST_AGAIN if near else MOST_IN_ALL
        run.use_the_rest(levels, *ended[levels], most)
        run.try_near(levels, most)
    return run.made


@dataclass
class _Exploration:
    """What is searched with, and `made`: what was measured. `usual`: how many measurements there usually are."""

    search: Search
    verifier: Verifier
    ready: Prepared
    station: Station
    seed: int
    stages: Stages
    judged: Judge
    usual: int
    made: list[Candidate] = field(default_factory=list)

    @property
    def best(self) -> Candidate | None:
        """Of those that hold the budget."""
        return min((c for c in self.made if c.feasible), key=lambda c: c.objective, default=None)

    @property
    def repeats(self) -> bool:
        """Whether the last one had been measured before."""
        return any(self.made[-1].config == other.config for other in self.made[:-1])

    def measured(self, found: Found, optimum: Optimum, correction: float, expected_us: float) -> Candidate:
        """The configuration at a point."""
        self.stages("verify in the runtime", len(self.made) / self.usual)
        config = self.ready.space.config(found.x, optimum.levels, f"{optimum.levels} levels")
        metrics = self.verifier.measured(config)
        value, fits = self.judged(config, metrics), holds(metrics, self.station)
        made = Candidate(config, found.predicted, metrics, value, fits, optimum, expected_us, found, correction)
        self.made.append(made)
        return made

    def answer(self, levels: int, found: Found, asked: Correction) -> Candidate:
        """What a search found, measured."""
        expected_us = asked.expected_us(found.predicted["loop_cost_p999_us"])
        optimum = Optimum(found.x, levels, limits_of(self.station, asked.value))
        return self.measured(found, optimum, asked.value, expected_us)

    def found(self, levels: int, asked: float, before: Found, seed: int) -> Found:
        """Searches on from what was found before."""
        self.stages("optimise", len(self.made) / self.usual)
        return self.search.best(levels, limits_of(self.station, asked), seed, before.x)

    def level_counts(
        self, counts: Sequence[int], near: Mapping[int, Candidate], most: int
    ) -> dict[int, tuple[Found, Correction]]:
        """Searches and measures level count by level count, and returns what each ended with.

        All are searched again as soon as it is known by how much costs are mispredicted: what further levels are worth
        under one budget says little of a smaller one. Where the full scan was believed to fit, it says nothing.
        """
        self.stages("optimise", 0.0)
        begin = {levels: before.optimum.x for levels, before in near.items() if before.optimum is not None}
        at = min(near.values(), key=lambda c: c.objective).correction if near else 1.0
        every = self.search.best_of_each(counts, limits_of(self.station, at), self.seed, begin)
        correction, searched_again = at, False
        ended: dict[int, tuple[Found, Correction]] = {}
        mispredicted: dict[int, float] = {}  # the objective, by what was measured last
        left = list(counts)
        while left:
            if not searched_again and abs(np.log(correction / at)) > AGREE:
                self.stages("optimise", len(self.made) / self.usual)
                every = self.search.best_of_each(counts, limits_of(self.station, correction), self.seed, {})
                at, searched_again = correction, True
            levels = min(left, key=lambda k: every[k].rank)
            left.remove(levels)
            best = self.best
            if best is not None and (HOPE * every[levels].objective > best.objective or len(self.made) >= most):
                continue
            if _hardly_used(every, levels):
                continue
            found, asked = every[levels], Correction(at)
            if abs(np.log(correction / at)) > AGREE:
                asked = Correction(correction)
                found = self.found(levels, correction, found, self.seed)
            promise = min((every[k].objective * factor for k, factor in mispredicted.items()), default=np.inf)
            for turn in range(ROUNDS + RESCUES):
                candidate = self.answer(levels, found, asked)
                mispredicted[levels] = candidate.mispredicted
                # Asked for less, the search gave what it gave before: there is nothing cheaper to be had of it.
                more = asked.corrected(candidate, self.station) and not (turn and self.repeats)
                if turn == 0 and every[levels].objective * candidate.mispredicted > (1.0 - WORTH) * promise:
                    break
                rounds = ROUNDS + RESCUES if self.best is None else min(ROUNDS, turn + 1 + most - len(self.made))
                if not more or turn + 1 >= rounds:
                    break
                found = self.found(levels, asked.value, found, self.seed + turn + 1)
            correction = asked.value
            ended[levels] = found, asked
        return ended

    def use_the_rest(self, levels: int, found: Found, asked: Correction, most: int) -> None:
        """Asks for more while the best leaves much of the budget."""
        for _ in range(FINISH):
            used_us = 0.0 if self.best is None else cost_us(self.best)
            if used_us > (1.0 - AGREE) * self.station.budget_us or len(self.made) >= most:
                return
            if not asked.goes_on(self.station, AGREE):
                return
            found = self.found(levels, asked.value, found, self.seed)
            asked.take(self.answer(levels, found, asked))
            if self.repeats:
                return

    def try_near(self, levels: int, most: int) -> None:
        """Measures what should gain most near the best."""
        trials = TRIALS
        if self.best is not None:
            large = _TRIED_TRIANGLES / sum(level.triangles for level in self.best.config.levels)
            trials = round(min(max(large, FEWEST_TRIALS), TRIALS))
        for turn in range(trials):
            best = self.best
            if best is None or best.optimum is None or len(self.made) >= most:
                return
            self.stages("optimise", 0.95)
            like = [c for c in self.made if c.optimum is not None and c.optimum.levels == levels]
            random = np.random.default_rng([self.seed, turn])
            trial = next_trial(best, like, levels, self.search, self.ready.space, self.station, random)
            if trial is None:
                return
            point, expected_us = trial
            whole = self.search.look(point.x, levels, limits_of(self.station, 1.0))
            self.measured(whole, best.optimum, best.correction, expected_us)


def _hardly_used(every: Mapping[int, Found], levels: int) -> bool:
    fewer = [found for count, found in every.items() if count < levels]
    return any(abs(found.objective - every[levels].objective) < ALIKE and found.excess <= 0.0 for found in fewer)
