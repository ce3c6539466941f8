"""The tuning loop: ladder, replay, surrogate, optimise, verify in the runtime, correct, choose on measured numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder
from hapticlod.motion import Motion
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.baselines import baselines as baseline_configs
from tuning.compile_cache import keep_compiled
from tuning.explain import explain
from tuning.population import POOLED, check_over, measured_each, measured_over
from tuning.prepare import Prepared, Progress, Stages, prepare
from tuning.sample import Costing
from tuning.search import Found, Limits, Search, disturbance, objective
from tuning.sensitivity import Optimum, sensitivities, sentence
from tuning.verify import Verifier

ROUNDS = 4
RESCUES = 4  # further rounds while nothing that was measured holds the budget
LEADERS = 2  # level counts that are looked at again when prediction and measurement differ
AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected


@dataclass(frozen=True)
class Candidate:
    """A configuration with what was predicted of it and what was measured; `optimum`: of the search it came from."""

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    objective: float
    feasible: bool
    optimum: Optimum | None = None


@dataclass(frozen=True)
class TuneResult:
    """What tuning gave.

    Attributes:
        config: the chosen configuration.
        predicted, measured: its metrics by the surrogate, and in the runtime on motions kept apart.
        baselines: by name, measured alike: "finest only", "coarsest only", "the paper's".
        feasible: by name ("tuned" and the baselines), whether budget and memory hold.
        candidates: everything that was measured, best first.
        stages_s: seconds per stage.
        population: `over`, and what each motion kept apart makes of the configuration, unless they were pooled.
        sensitivities: what more budget or memory would change, by the surrogate: `tuning.sensitivity`.
        explanation: one paragraph.
        ladder, motions: what the bundle is made of; `motions` are those kept apart.
    """

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    baselines: dict[str, dict[str, float]]
    feasible: dict[str, bool]
    candidates: tuple[Candidate, ...]
    stages_s: dict[str, float]
    population: dict[str, Any]
    sensitivities: dict[str, Any]
    explanation: str
    ladder: Ladder
    motions: tuple[Motion, ...]
    costing: Costing


def tune(
    scan: Scan,
    station: Station,
    tool: Tool,
    motions: Sequence[Motion] | None = None,
    *,
    levels: tuple[int, int] = (1, 5),
    over: str = POOLED,
    seed: int = 0,
    progress: Progress | None = None,
) -> TuneResult:
    """Tunes the levels of detail of a scan for a station and a tool.

    Args:
        scan: cleaned. station: rate, budget, limits; cost coefficients of its own where it is another machine.
        tool: 1 to 4096 balls.
        motions: recorded at the station's rate: the first halves make the surrogate, the second halves verify.
            None: strokes of all four modes, made on the scan.
        levels: fewest and most levels to consider.
        over: what is minimised of several motions: "pooled", as one long motion; "mean" or "worst" of them.
        seed: of motions and starts.
        progress: told every stage's name and the part done.

    Raises:
        InputError: no configuration holds the budget (it says which budget would), or the motions never touch.
    """
    check_over(over)
    keep_compiled()
    stages = Stages(progress)
    ready = prepare(scan, station, tool, motions, seed=seed, progress=stages)
    search = Search(ready.measured, ready.space, station.budget_us, over, len(ready.seen))
    verifier = Verifier(ready.ladder, tool, station, ready.apart, ready.costing, ready.key)

    def judged(config: LodConfig, metrics: dict[str, float]) -> float:
        """The objective by what was measured."""
        pooled = float(objective(metrics, station.budget_us))
        if over == POOLED:
            return pooled
        felt = [disturbance(m["felt_error_jnd"], m["discontinuity_per_s"]) for m in measured_each(verifier, config)]
        together = disturbance(metrics["felt_error_jnd"], metrics["discontinuity_per_s"])
        return pooled - together + measured_over(felt, over)

    counts = [k for k in range(levels[0], levels[1] + 1) if ready.space.fits(k)] or [1]
    candidates = _explore(search, verifier, ready, station, counts, seed, stages, judged)
    stages("measure the baselines", 0.0)
    baselines, feasible = {}, {}
    fixed = baseline_configs(ready.ladder, tool)
    for i, config in enumerate(fixed):
        baselines[config.name] = verifier.measured(config)
        feasible[config.name] = holds(baselines[config.name], station)
        stages("measure the baselines", (i + 1) / len(fixed))
    # The finest and the coarsest level alone are candidates like any other.
    for alone in fixed[:2]:
        found = baselines[alone.name]
        candidates.append(Candidate(alone, {}, found, judged(alone, found), feasible[alone.name]))
    ranked = sorted(candidates, key=lambda c: (not c.feasible, c.objective))
    chosen = ranked[0]
    if not chosen.feasible:
        raise _nothing_fits(candidates, station)
    predicted = chosen.predicted or search.look(ready.space.point(chosen.config), 1, _limits(station, 1.0)).predicted
    feasible["tuned"] = True
    stages("differentiate the optimum", 0.0)
    answers = sensitivities(search, ready.space, chosen.optimum, station)
    stages.close()
    reasons = explain(ranked, baselines, station, scan.triangles, tool), sentence(answers, station)
    return TuneResult(
        config=chosen.config.changed(name="tuned"),
        predicted=predicted,
        measured=chosen.measured,
        baselines=baselines,
        feasible=feasible,
        candidates=tuple(ranked),
        stages_s=stages.seconds,
        population=_population(over, verifier, chosen.config),
        sensitivities=answers,
        explanation=" ".join(filter(None, reasons)),
        ladder=ready.ladder,
        motions=ready.apart,
        costing=ready.costing,
    )


def _population(over: str, verifier: Verifier, config: LodConfig) -> dict[str, Any]:
    if over == POOLED:
        return {"over": over}
    keys = ("felt_error_jnd", "discontinuity_per_s")
    each = zip(verifier.motions, measured_each(verifier, config), strict=True)
    return {"over": over, "motions": [{"name": m.name, **{key: found[key] for key in keys}} for m, found in each]}


def _explore(
    search: Search, verifier: Verifier, ready: Prepared, station: Station, counts: Sequence[int], seed: int,
    stages: Stages, judged: Callable[[LodConfig, dict[str, float]], float],
) -> list[Candidate]:  # fmt: skip
    """The best of every level count, measured; then the leaders again, with the surrogate's budget corrected."""
    made: list[Candidate] = []
    warm: dict[int, np.ndarray] = {}

    def verified(count: int, found: Found, limits: Limits) -> Candidate:
        stages("verify in the runtime", len(made) / (len(counts) + LEADERS))
        warm[count] = found.x
        config = ready.space.config(found.x, count, f"{count} levels")
        metrics = verifier.measured(config)
        value = judged(config, metrics)
        optimum = Optimum(found.x, count, limits)
        made.append(Candidate(config, found.predicted, metrics, value, holds(metrics, station), optimum))
        return made[-1]

    stages("optimise", 0.0)
    every = search.best_of_each(counts, _limits(station, 1.0), seed)
    latest = {count: verified(count, found, _limits(station, 1.0)) for count, found in every.items()}
    used = dict.fromkeys(latest, 1.0)
    for turn in range(1, ROUNDS + RESCUES):
        rescuing = not any(candidate.feasible for candidate in made)
        if turn >= ROUNDS and not rescuing:
            break
        corrections = {count: _correction(latest[count], station) for count in latest}
        wrong = [count for count in latest if corrections[count] is not None]
        # Those that could still win: the best by what was measured, whether or not they held the budget. While none
        # did, those that came nearest to holding it.
        for count in sorted(wrong, key=lambda k: _cost_us(latest[k]) if rescuing else latest[k].objective)[:LEADERS]:
            stages("optimise", len(made) / (len(counts) + LEADERS))
            correction = float(corrections[count] or 1.0)
            if not latest[count].feasible:
                correction = min(correction, 0.7 * used[count])  # what was asked for last time was too much
            used[count] = correction
            limits = _limits(station, correction)
            latest[count] = verified(count, search.best(count, limits, seed + turn, warm[count]), limits)
    return made


def _cost_us(candidate: Candidate) -> float:
    return candidate.measured["loop_cost_p999_us"]


def _correction(candidate: Candidate, station: Station) -> float | None:
    """What the surrogate's budget must be multiplied by so that the measured cost meets it; None: they agree."""
    predicted, measured = candidate.predicted["loop_cost_p999_us"], _cost_us(candidate)
    apart = measured / station.budget_us
    if candidate.feasible and apart > 1.0 - 2 * AGREE:
        return None  # as near to the budget as makes sense
    if candidate.feasible and predicted < (1.0 - 2 * AGREE) * station.budget_us:
        return None  # the budget does not bind
    return float(np.clip(predicted / measured, 0.1, 2.0))


def _limits(station: Station, correction: float) -> Limits:
    return Limits(station.budget_us * correction, station.memory_mb)


def holds(metrics: dict[str, float], station: Station) -> bool:
    """Whether budget and memory hold."""
    return metrics["loop_cost_p999_us"] <= station.budget_us and metrics["memory_mb"] <= station.memory_mb


def _nothing_fits(candidates: list[Candidate], station: Station) -> InputError:
    small = [c for c in candidates if c.measured["memory_mb"] <= station.memory_mb] or candidates
    nearest = min(small, key=_cost_us)
    needed = _cost_us(nearest)
    return InputError(
        f"station {station.name}",
        f"no configuration holds a budget of {station.budget_us:g} us within {station.memory_mb:g} MB",
        f"the cheapest measured needs {needed:.3g} us and {nearest.measured['memory_mb']:.3g} MB: allow that much, "
        "lower the loop rate, or take a tool with fewer balls",
    )
