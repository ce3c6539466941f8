"""Budget against feel: the best that the surrogate can see at each of several budgets, after one preparation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.motion import Motion
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.baselines import finest_only
from tuning.compile_cache import keep_compiled
from tuning.population import POOLED, check_over, measured_objective
from tuning.prepare import Prepared, Progress, Stages, prepare
from tuning.search import MARGIN, Found, Limits, Search
from tuning.sensitivity import Optimum, marginal_value
from tuning.space import Space
from tuning.verified_front import Point, verified_points
from tuning.verify import Verifier

MOST_POINTS = 50
# Level counts that are optimised at each budget, and points of each level count that are looked at before.
FOLLOWED, LOOKS = 2, 16
_CHEAPER, _DEARER = 1.05, 1.05  # how far the default budgets stay inside what there is to choose
_HELD = 1e-3


@dataclass(frozen=True)
class FrontPoint:
    """The best configuration for one budget.

    Attributes:
        budget_us: p99.9 that a tick may cost.
        config: levels, speeds and the rest.
        predicted: its metrics by the surrogate. objective: what was minimised, by the surrogate; measured, if it was.
        fits: whether the surrogate sees it within budget and memory.
        marginal: d(objective)/d(budget), per us, at most 0; None where the search did not end at a minimum.
        measured: its metrics in the runtime on motions kept apart, if that was asked for.
        holds: whether budget and memory hold by what was measured.
    """

    budget_us: float
    config: LodConfig
    predicted: dict[str, float]
    objective: float
    fits: bool
    marginal: float | None
    measured: dict[str, float] | None = None
    holds: bool | None = None

    def document(self) -> dict[str, Any]:
        """As JSON types."""
        measured = None if self.measured is None else _numbers(self.measured)
        return {
            "budget_us": self.budget_us, "config": self.config.model_dump(mode="json"), "objective": self.objective,
            "fits_predicted": self.fits, "marginal_per_us": self.marginal, "predicted": _numbers(self.predicted),
            "measured": measured, "holds_measured": self.holds,
        }  # fmt: skip


@dataclass(frozen=True)
class Front:
    """Points by rising budget, and seconds per stage."""

    points: tuple[FrontPoint, ...]
    stages_s: dict[str, float]

    def document(self) -> dict[str, Any]:
        """As JSON types."""
        stages = {name: round(seconds, 3) for name, seconds in self.stages_s.items()}
        return {"points": [point.document() for point in self.points], "stages_s": stages}


def pareto(
    scan: Scan,
    station: Station,
    tool: Tool,
    motions: Sequence[Motion] | None = None,
    *,
    budgets_us: Sequence[float] | None = None,
    points: int = 8,
    levels: tuple[int, int] = (1, 5),
    over: str = POOLED,
    seed: int = 0,
    verify: bool = False,
    progress: Progress | None = None,
) -> Front:
    """The front of budget against feel.

    Args:
        scan, tool, motions, levels, over, seed, progress: as in `tuning.tune.tune`.
        station: its budget does not matter.
        budgets_us: the budgets; None: `points` of them, from a little more than the cheapest configuration costs to
            what the full scan costs, by the surrogate, and no more than the loop's period.
        verify: also measure every point in the runtime, on motions kept apart; what does not hold its budget is
            searched again, and the best that was measured to hold it is what is told.

    Raises:
        InputError: budgets that no station can have, or what `prepare` raises.
    """
    if budgets_us is None and not 1 <= points <= MOST_POINTS:
        raise InputError("points", f"{points} is no number of points", f"give 1 to {MOST_POINTS}")
    if budgets_us is not None:
        budgets_us = sorted(set(budgets_us))
        if not budgets_us or len(budgets_us) > MOST_POINTS:
            raise InputError("budgets", f"there are {len(budgets_us)}", f"give 1 to {MOST_POINTS}")
        for budget_us in budgets_us:
            station.adjusted(budget_us=budget_us)
    check_over(over)
    keep_compiled()
    stages = Stages(progress)
    ready = prepare(scan, station, tool, motions, seed=seed, progress=stages, whole=over != POOLED)
    stages("follow the front", 0.0)
    # One search, one objective: its trace of cost is measured by the station's budget at every point.
    search = Search(ready.measured, ready.space, station.budget_us, over, len(ready.seen), ready.key)
    counts = [k for k in range(levels[0], levels[1] + 1) if ready.space.fits(k)] or [1]
    asked = budgets_us or _budgets_us(search, ready, tool, station, points)
    best = follow(search, ready.space, counts, asked, station.memory_mb, seed, stages)
    made, optima = [], []
    for budget_us, (count, found) in zip(asked, best, strict=True):
        config = ready.space.config(found.x, count, f"{budget_us:g} us")
        # Predicted is what would be built: counts rounded.
        limits, used = Limits(budget_us, station.memory_mb), len(config.levels)
        built = search.look(ready.space.point(config), used, limits)
        optima.append(Optimum(found.x, count, limits))
        marginal = marginal_value(search, ready.space, optima[-1], budget_us)
        fits = found.excess <= _HELD
        made.append(FrontPoint(budget_us, config, built.predicted, built.objective, fits, marginal))
    if verify:
        verifier = Verifier(ready.ladder, tool, station, ready.apart, ready.costing, ready.key)
        found = [found for _, found in best]
        points_ = verified_points(
            optima, found, search, ready.space, verifier, station,
            lambda config, metrics: measured_objective(verifier, config, metrics, over), seed, stages,
        )  # fmt: skip
        made = [_measured(old, new) for old, new in zip(made, points_, strict=True)]
    stages.close()
    return Front(tuple(made), stages.seconds)


def follow(
    search: Search, space: Space, counts: Sequence[int], budgets_us: Sequence[float], memory_mb: float, seed: int,
    told: Progress,
) -> list[tuple[int, Found]]:  # fmt: skip
    """(levels, optimum) for every budget, rising.

    Everything that was looked at or found is kept: what a point costs does not depend on the budget, so each budget
    starts from the best that is known to fit it, which is what its neighbour found or lies in another valley; upward,
    then downward from what more budget found. What fits a small budget fits a larger one, so that the objective never
    rises with the budget.
    """
    limits = [Limits(budget_us, memory_mb) for budget_us in budgets_us]
    known: list[tuple[int, Found]] = []
    for i in sorted({len(limits) // 4, len(limits) // 2, 3 * len(limits) // 4}):
        known += list(search.best_of_each(counts, limits[i], seed).items())
    for levels in counts:
        drawn = list(space.sample(LOOKS, levels, seed + levels))
        known += [(levels, found) for found in search.glances(drawn, levels, limits[0])]
    known = [(levels, found) for levels, found in known if np.isfinite(found.objective)]

    def ranked(i: int) -> list[tuple[int, Found]]:
        under = [(levels, replace(found, excess=_excess(found, limits[i]))) for levels, found in known]
        return sorted(under, key=lambda each: (each[1].rank, each[0]))

    upward = [(i, FOLLOWED) for i in range(len(limits))]
    downward = [(i, 1) for i in range(len(limits) - 2, -1, -1)]
    for done, (i, count) in enumerate(upward + downward):
        told("follow the front", done / (len(upward) + len(downward)))
        # Downward from the neighbour above; upward from the best of all that fit, of different level counts.
        starts: dict[int, NDArray[np.float64]] = {}
        for levels, found in ranked(i) if done < len(upward) else ranked(i + 1):
            if len(starts) < count:
                starts.setdefault(levels, found.x)
        known += list(search.best_of_each(sorted(starts), limits[i], seed, starts).items())
    best = [ranked(i)[0] for i in range(len(limits))]
    return [(levels, search.look(found.x, levels, limit)) for (levels, found), limit in zip(best, limits, strict=True)]


def _excess(found: Found, limits: Limits) -> float:
    cost, memory = found.predicted["loop_cost_p999_us"], found.predicted["memory_mb"]
    return float(np.log(max(cost / limits.budget_us, memory / limits.memory_mb)))


def _budgets_us(search: Search, ready: Prepared, tool: Tool, station: Station, points: int) -> list[float]:
    """Log-spaced from what the cheapest configuration costs to what the full scan costs."""
    free = Limits(1e-3, station.memory_mb)
    cheapest = search.best(1, free, 0).predicted["loop_cost_p999_us"] / MARGIN * _CHEAPER
    full = search.look(ready.space.point(finest_only(ready.ladder, tool)), 1, free).predicted["loop_cost_p999_us"]
    most = min(full * _DEARER, station.period_us)
    least = min(cheapest, most)
    rounded = [float(f"{budget:.3g}") for budget in np.geomspace(least, most, points)]
    return sorted({min(budget, station.period_us) for budget in rounded})


def _measured(predicted: FrontPoint, found: Point) -> FrontPoint:
    """What stands for a budget once it was measured. The marginal value stays the surrogate's at this budget."""
    candidate = found.candidate
    config = candidate.config.changed(name=predicted.config.name)
    return replace(
        predicted,
        config=config,
        predicted=candidate.predicted,
        objective=candidate.objective,
        measured=candidate.measured,
        holds=found.holds,
    )


def _numbers(metrics: Mapping[str, float]) -> dict[str, float | None]:
    return {name: float(value) if math.isfinite(value) else None for name, value in metrics.items()}
