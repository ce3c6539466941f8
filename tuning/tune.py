"""The tuning loop: ladder, replay, surrogate, optimise, verify in the runtime, correct, choose on measured numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder
from hapticlod.motion import Motion
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.baselines import baselines as baseline_configs
from tuning.candidate import Candidate, cost_us
from tuning.compile_cache import keep_compiled
from tuning.confirm import Clock, confirmed, merit
from tuning.correction import limits_of
from tuning.costing import Costing
from tuning.explain import agreement, explain, refusal
from tuning.explore import Judge, explore
from tuning.objective import felt_of, holds
from tuning.population import POOLED, check_over, measured_each, measured_objective
from tuning.prepare import Prepared, Progress, Stages, prepare
from tuning.search import Search
from tuning.sensitivity import UNBOUND, sensitivities, sentence
from tuning.verify import Verifier

SHOWN_S = 2.0  # what a baseline that cannot be chosen may cost to measure, s of loop cost


@dataclass(frozen=True)
class TuneResult:
    """What tuning gave.

    Attributes:
        config: the chosen configuration.
        predicted, measured: its metrics by the surrogate, and in the runtime on motions kept apart. Nothing is
            predicted of the full scan where it fits: it is what all others are measured against.
        clock: what the clock said of its loop cost, us: mean and quantiles of each tick's least time over `runs`.
        baselines: by name, measured alike: "finest only", "coarsest only", "the paper's".
        ticks: by name ("tuned" and the baselines), how many the measurement rests on.
        feasible: by name ("tuned" and the baselines), whether budget and memory hold.
        candidates: everything that was measured, best first.
        stages_s: seconds per stage.
        population: `over`, and what each motion kept apart makes of the configuration, unless they were pooled.
        sensitivities: what more budget or memory would change, by the surrogate: `tuning.sensitivity`.
        explanation: one paragraph.
        ladder, motions: what the bundle is made of; `motions` are those kept apart, `golden` the one of them that shows
            most of the configuration.
    """

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    clock: dict[str, float]
    baselines: dict[str, dict[str, float]]
    ticks: dict[str, int]
    feasible: dict[str, bool]
    candidates: tuple[Candidate, ...]
    stages_s: dict[str, float]
    population: dict[str, Any]
    sensitivities: dict[str, Any]
    explanation: str
    ladder: Ladder
    motions: tuple[Motion, ...]
    golden: Motion
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
        motions: recorded at the station's rate: in turn, parts of them make the surrogate and verify; over the mean
            or the worst of several motions, their halves.
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
    ready = prepare(scan, station, tool, motions, seed=seed, progress=stages, whole=over != POOLED)

    @cache
    def search() -> Search:
        """Made when it is needed: where the full scan fits, nothing is searched and nothing is compiled."""
        return Search(ready.measured, ready.space, station.budget_us, over, len(ready.seen), ready.key)

    verifier = Verifier(ready.ladder, tool, station, ready.apart, ready.costing, ready.key)

    def judged(config: LodConfig, metrics: dict[str, float]) -> float:
        """The objective by what was measured."""
        return measured_objective(verifier, config, metrics, over)

    counts = [k for k in range(levels[0], levels[1] + 1) if ready.space.fits(k)] or [1]
    baselines, ticks, candidates = _baselines(ready, verifier, tool, station, judged, stages)
    clock = Clock(verifier, station)

    def fits_whole(candidate: Candidate, allowed: Station) -> bool:
        """One level may be the answer, and nothing is felt of this: a search could only find a trace of cost."""
        return counts[0] == 1 and holds(candidate.measured, allowed) and felt_of(candidate.measured) == 0.0

    def explored(allowed: Station, near: Mapping[int, Candidate]) -> list[Candidate]:
        if any(fits_whole(candidate, allowed) for candidate in candidates):
            return []
        made = explore(search(), verifier, ready, allowed, list(near) or counts, seed, stages, judged, near)
        stages("ask the clock", 0.0)
        return made

    found = confirmed(explored, candidates, clock, station)
    if found is None:
        raise _nothing_fits(candidates, station, clock.ratio)
    chosen, said = found
    ranked = sorted(candidates, key=lambda c: (c is not chosen, not c.feasible, merit(c)))
    feasible = {name: holds(metrics, station) for name, metrics in baselines.items()}
    stages("differentiate the optimum", 0.0)
    predicted = chosen.predicted
    if not predicted and not fits_whole(chosen, station):
        predicted = search().look(ready.space.point(chosen.config), 1, limits_of(station, 1.0)).predicted
    feasible["tuned"] = True
    answers = UNBOUND if chosen.optimum is None else sensitivities(search(), ready.space, chosen.optimum, station)
    stages.close()
    reason = explain(ranked, baselines, station, scan.triangles, tool)
    refused = refusal(chosen, candidates, clock.ratio, said, station)
    reasons = reason, agreement(chosen), refused, sentence(answers, station)
    return TuneResult(
        config=chosen.config.changed(name="tuned"),
        predicted=predicted,
        measured=chosen.measured,
        clock=said,
        baselines=baselines,
        ticks={**ticks, "tuned": sum(motion.ticks for motion in ready.apart)},
        feasible=feasible,
        candidates=tuple(ranked),
        stages_s=stages.seconds,
        population=_population(over, verifier, chosen.config),
        sensitivities=answers,
        explanation=" ".join(filter(None, reasons)),
        ladder=ready.ladder,
        motions=ready.apart,
        golden=verifier.most_varied(chosen.config),
        costing=ready.costing,
    )


def _population(over: str, verifier: Verifier, config: LodConfig) -> dict[str, Any]:
    if over == POOLED:
        return {"over": over}
    keys = ("felt_error_jnd", "discontinuity_per_s")
    each = zip(verifier.motions, measured_each(verifier, config), strict=True)
    return {"over": over, "motions": [{"name": m.name, **{key: found[key] for key in keys}} for m, found in each]}


def _baselines(
    ready: Prepared, verifier: Verifier, tool: Tool, station: Station, judged: Judge, stages: Stages
) -> tuple[dict[str, dict[str, float]], dict[str, int], list[Candidate]]:
    """By name, what was measured of each and on how many ticks; and those that are candidates, too: one level alone."""
    stages("measure the baselines", 0.0)
    measured: dict[str, dict[str, float]] = {}
    ticks: dict[str, int] = {}
    alone: list[Candidate] = []
    fixed = baseline_configs(ready.ladder, tool)
    for i, config in enumerate(fixed):
        candidate = len(config.levels) == 1
        judge = verifier if candidate else verifier.affordable(config, SHOWN_S)
        ticks[config.name] = sum(motion.ticks for motion in judge.motions)
        found = measured[config.name] = judge.measured(config)
        if candidate:
            alone.append(Candidate(config, {}, found, judged(config, found), holds(found, station)))
        stages("measure the baselines", (i + 1) / len(fixed))
    return measured, ticks, alone


def _nothing_fits(candidates: list[Candidate], station: Station, ratio: float) -> InputError:
    """`ratio`: of the clock's times to counted costs."""
    small = [c for c in candidates if c.measured["memory_mb"] <= station.memory_mb] or candidates
    nearest = min(small, key=cost_us)
    needed = ratio * cost_us(nearest)
    return InputError(
        f"station {station.name}",
        f"no configuration holds a budget of {station.budget_us:g} us within {station.memory_mb:g} MB",
        f"the cheapest measured needs {needed:.3g} us and {nearest.measured['memory_mb']:.3g} MB: allow that much, "
        "lower the loop rate, or take a tool with fewer balls",
    )
