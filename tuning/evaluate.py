"""How far the surrogate can be trusted: random configurations, predicted and measured, compared metric by metric.

Predictions come from the motions of the surrogate, measurements from motions kept apart, so that what is judged is
what tuning relies on: that a configuration which looks better is better. Measured on the very motions that a prediction
was made from (`own`), what is left is the model's error alone: the difference is that between two hands.

The ceiling of a metric is the rank correlation of two measurements that share nothing: the first and the second half
of every motion kept apart. A prediction is made from motions of its own and cannot be expected to agree with a
measurement better than measurements agree with each other. Each half is shorter than the whole, so the ceiling is a
little low: a surrogate made from more ticks than a half may rise above it.

Costs are measured as tuning measures them, by counters at this machine's prices. `clock` sets them against the clock:
counted cost over the time that the same run took, interrupts taken out; single runs, so the machine's noise is in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau, spearmanr

from hapticlod.config import LodConfig
from hapticlod.metrics import METRIC_KEYS, measure
from hapticlod.replay import Record
from hapticlod.station import Station
from tuning.objective import objective
from tuning.prepare import Prepared
from tuning.search import Limits, Search
from tuning.verify import Verifier, clock_metrics

OBJECTIVE = "objective"
Metrics = dict[str, float]


@dataclass(frozen=True)
class Trial:
    """One configuration: predicted, measured, measured on either half of the motions; its loop cost by the clock.

    `own`: measured on the motions that the prediction was made from.
    """

    config: LodConfig
    predicted: Metrics
    measured: Metrics
    own: Metrics
    halves: tuple[Metrics, Metrics]
    clock: Metrics

    @property
    def triangles(self) -> int:
        """Of all levels together."""
        return sum(level.triangles for level in self.config.levels)


def random_points(ready: Prepared, count: int, seed: int) -> list[tuple[NDArray[np.float64], int]]:
    """(x, levels) of `count` configurations, all level counts that fit in turn, every lever spread over its bounds."""
    fitting = [k for k in range(1, ready.space.most_levels + 1) if ready.space.fits(k)] or [1]
    each = -(-count // len(fitting))
    drawn = {k: ready.space.sample(each, k, seed + k) for k in fitting}
    return [(drawn[k][i], k) for i in range(each) for k in fitting][:count]


def evaluate(
    ready: Prepared, verifier: Verifier, station: Station, count: int, seed: int, told: Callable[[str, float], None]
) -> list[Trial]:
    """Predicts and measures `count` configurations; `verifier` measures on the motions kept apart."""
    search = Search(ready.measured, ready.space, station.budget_us)
    limits = Limits(station.budget_us, station.memory_mb)
    references = verifier.reference()
    seen = replace(verifier, motions=ready.seen, key="", runs=0, _reference=[])
    trials: list[Trial] = []
    for i, (x, levels) in enumerate(random_points(ready, count, seed)):
        told("predict and measure", i / count)
        config = ready.space.config(x, levels, f"random {i}")
        # Predicted is what will be measured: counts rounded, as the configuration has them.
        point = ready.space.point(config)
        predicted = _with_objective(search.look(point, len(config.levels), limits).predicted, station)
        records, times = verifier.runs_of(config)
        whole = _with_objective(measure(records, references), station)
        halves = tuple(
            _with_objective(measure(_half(records, part), _half(references, part)), station) for part in (0, 1)
        )
        own = _with_objective(measure(seen.records(config), seen.reference()), station)
        trials.append(Trial(config, predicted, whole, own, (halves[0], halves[1]), clock_metrics(times)))
    told("predict and measure", 1.0)
    return trials


def _with_objective(metrics: Mapping[str, float], station: Station) -> Metrics:
    return {**metrics, OBJECTIVE: float(objective(metrics, station.budget_us))}


def _half(records: Sequence[Record], part: int) -> list[Record]:
    cut = [len(record) // 2 for record in records]
    return [
        replace(record, rows=record.rows[at:] if part else record.rows[:at])
        for record, at in zip(records, cut, strict=True)
    ]


def scores(trials: Sequence[Trial]) -> dict[str, Any]:
    """Per metric: rank correlations, quantiles of predicted over measured, the ceiling; and of trivial predictors.

    A rank correlation is null where predictions or measurements are all alike, a ratio where all measurements are 0.
    `baselines.total_triangles` ranks by the triangles of all levels (either way round: its sign is dropped),
    `baselines.constant` predicts every measurement by their median: it ranks nothing, its ratios show the spread.
    `own_motions` has what `metrics` has, measured on the motions of the predictions.
    """
    triangles = np.array([float(trial.triangles) for trial in trials])
    metrics: dict[str, Any] = {}
    own_motions: dict[str, Any] = {}
    by_triangles: dict[str, Any] = {}
    by_constant: dict[str, Any] = {}
    for key in (*METRIC_KEYS, OBJECTIVE):
        predicted, measured, own, first, second = (
            np.array([float(values[key]) for values in column])
            for column in (
                [trial.predicted for trial in trials],
                [trial.measured for trial in trials],
                [trial.own for trial in trials],
                [trial.halves[0] for trial in trials],
                [trial.halves[1] for trial in trials],
            )
        )
        ceiling = rank_correlation(spearmanr, first, second)
        metrics[key] = {**_score(predicted, measured), "ceiling": ceiling}
        own_motions[key] = _score(predicted, own)
        trivial = _score(triangles, measured)
        by_triangles[key] = {name: _unsigned(trivial[name]) for name in ("spearman", "kendall")}
        by_constant[key] = _score(np.full_like(measured, np.median(measured)), measured)
    clock = {
        key: _score(np.array([t.measured[key] for t in trials]), np.array([t.clock[key] for t in trials]))
        for key in trials[0].clock
    }
    trivial = {"total_triangles": by_triangles, "constant": by_constant}
    return {"metrics": metrics, "own_motions": own_motions, "clock": clock, "baselines": trivial}


def _score(predicted: NDArray[np.float64], measured: NDArray[np.float64]) -> dict[str, float | None]:
    some = np.abs(measured) > 1e-12
    ratio = predicted[some] / measured[some]
    quantiles = [float(q) for q in np.quantile(ratio, (0.05, 0.5, 0.95))] if some.any() else [None] * 3
    return {
        "spearman": rank_correlation(spearmanr, predicted, measured),
        "kendall": rank_correlation(kendalltau, predicted, measured),
        **dict(zip(("ratio_p5", "ratio_p50", "ratio_p95"), quantiles, strict=True)),
    }


def _unsigned(value: float | None) -> float | None:
    return None if value is None else abs(value)


def rank_correlation(kind: Callable[..., Any], a: NDArray[np.float64], b: NDArray[np.float64]) -> float | None:
    """By `scipy.stats.spearmanr` or `kendalltau`; None where either ranks nothing."""
    # Rounded: equal to the last bits is alike.
    a, b = (np.array([float(f"{value:.9g}") for value in values]) for values in (a, b))
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    found = float(kind(a, b).statistic)
    return found if math.isfinite(found) else None
