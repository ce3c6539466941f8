"""Tuners that know nothing of the problem: each proposes configurations and is told what the runtime measured of them.

All work on one objective: what tuning minimises, measured, plus a penalty for every per cent over budget or memory, so
that searches find their way back. The penalty never decides what is reported: that is the best that holds its limits.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hapticlod.config import Level, LodConfig
from hapticlod.station import Station
from tuning.baselines import CELL_EDGES, PAPER_TRIANGLES, papers_rule
from tuning.objective import objective
from tuning.prepare import Prepared
from tuning.verify import Verifier

PENALTY = 10.0  # JND for a factor e over a limit
# What a person would take who lays a grid over sizes and speeds: the paper's proportions, a loop that does not chatter.
GRID_SIZES, GRID_SPEEDS = 6, 6
GRID_HYSTERESIS, GRID_FILTER_HZ, GRID_BLEND_MS = 0.1, 20.0, 30.0


@dataclass(frozen=True)
class Evaluation:
    """One measured configuration. `after_s`: of the method's start."""

    config: LodConfig
    metrics: dict[str, float]
    objective: float
    excess: float
    after_s: float

    @property
    def holds(self) -> bool:
        """Budget and memory."""
        return self.excess <= 0.0


@dataclass
class Trials:
    """What one method has measured, and when it must end: after so many evaluations, and not before so many seconds."""

    verifier: Verifier
    station: Station
    evaluations: int
    seconds: float
    made: list[Evaluation] = field(default_factory=list)
    began_s: float = field(default_factory=time.monotonic)

    @property
    def done(self) -> bool:
        """Whether the method has had its share."""
        return len(self.made) >= self.evaluations and time.monotonic() - self.began_s >= self.seconds

    def score(self, config: LodConfig) -> float:
        """Measures a configuration; what a method is told of it."""
        metrics = self.verifier.measured(config)
        value = float(objective(metrics, self.station.budget_us))
        over = metrics["loop_cost_p999_us"] / self.station.budget_us, metrics["memory_mb"] / self.station.memory_mb
        excess = float(np.log(max(over)))
        self.made.append(Evaluation(config, metrics, value, excess, time.monotonic() - self.began_s))
        return value + PENALTY * max(excess, 0.0)

    def best(self, within_s: float = float("inf")) -> list[Evaluation]:
        """Those that held their limits, best first, of those measured within a time."""
        return sorted((e for e in self.made if e.holds and e.after_s <= within_s), key=lambda e: e.objective)


Method = Callable[[Trials, Prepared, Sequence[int], int], None]


def random_search(trials: Trials, ready: Prepared, counts: Sequence[int], seed: int) -> None:
    """Level counts in turn, every lever uniform over its bounds."""
    random = np.random.default_rng(seed)
    for levels in itertools.cycle(counts):
        if trials.done:
            return
        x = ready.space.ordered(random.random(ready.space.size), levels)
        trials.score(ready.space.config(x, levels))


def tpe(trials: Trials, ready: Prepared, counts: Sequence[int], seed: int) -> None:
    """Optuna's tree-structured Parzen estimator, multivariate."""
    from optuna.samplers import TPESampler  # pyright: ignore[reportMissingImports] - an extra

    _optuna(trials, ready, counts, TPESampler(seed=seed, multivariate=True))


def cma_es(trials: Trials, ready: Prepared, counts: Sequence[int], seed: int) -> None:
    """CMA-ES by Optuna; the number of levels is one more coordinate, rounded."""
    from optuna.samplers import CmaEsSampler  # pyright: ignore[reportMissingImports] - an extra

    _optuna(trials, ready, counts, CmaEsSampler(seed=seed))


def _optuna(trials: Trials, ready: Prepared, counts: Sequence[int], sampler) -> None:
    import optuna  # pyright: ignore[reportMissingImports] - an extra

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=sampler)
    low, high = ready.space.log_bounds
    free = np.flatnonzero(high > low)
    while not trials.done:
        trial = study.ask()
        levels = trial.suggest_int("levels", counts[0], counts[-1]) if len(counts) > 1 else counts[0]
        x = np.zeros(ready.space.size)
        for i in free:
            x[i] = trial.suggest_float(f"x{i}", 0.0, 1.0)
        study.tell(trial, trials.score(ready.space.config(ready.space.ordered(x, levels), levels)))


def grid(trials: Trials, ready: Prepared, counts: Sequence[int], seed: int) -> None:
    """Sizes of the finest level times pairs of speeds; evenly thinned to the evaluations that there are."""
    made = list(grid_configs(ready))
    for i in np.unique(np.linspace(0, len(made) - 1, min(trials.evaluations, len(made))).round().astype(int)):
        trials.score(made[i])


def grid_configs(ready: Prepared) -> Iterator[LodConfig]:
    """Three levels in the paper's proportions, two-sided mapping, and one level for every size."""
    space, ladder = ready.space, ready.ladder
    balls = round(space.balls[1])
    speeds = np.geomspace(*space.speeds_mm_s, GRID_SPEEDS + 2)[1:-1]
    for finest in np.geomspace(space.triangles[1], 10 * space.triangles[0], GRID_SIZES):
        rungs = [ladder.at(max(round(finest * n / PAPER_TRIANGLES[0]), 4)) for n in PAPER_TRIANGLES]
        levels = [Level(triangles=r.triangles, cell_mm=CELL_EDGES * r.mean_edge_mm, balls=balls) for r in rungs]
        yield LodConfig(levels=(levels[0],))
        if not levels[0].triangles > levels[1].triangles > levels[2].triangles:
            continue
        for slow, fast in itertools.combinations(speeds, 2):
            yield LodConfig(
                levels=tuple(levels), speeds_mm_s=(float(slow), float(fast)), hysteresis=GRID_HYSTERESIS,
                filter_hz=GRID_FILTER_HZ, blend_ms=GRID_BLEND_MS, l_in_mm=4 * space.l_mm[0],
                l_out_mm=4 * space.l_mm[0],
            )  # fmt: skip


def paper(trials: Trials, ready: Prepared, counts: Sequence[int], seed: int) -> None:
    """The paper's configuration, as it is."""
    trials.score(papers_rule(ready.ladder, trials.verifier.tool))


# With how many times the evaluations asked for.
METHODS: dict[str, tuple[Method, float]] = {
    "Optuna TPE": (tpe, 1.0),
    "CMA-ES": (cma_es, 1.0),
    "random": (random_search, 2.5),
    "grid": (grid, 1.0),
    "the paper's": (paper, 1.0),
}
