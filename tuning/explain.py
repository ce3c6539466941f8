"""Why this configuration: one paragraph that a user can read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from tuning.objective import holds

if TYPE_CHECKING:
    from hapticlod.station import Station
    from hapticlod.tool import Tool
    from tuning.candidate import Candidate


# A refusal by the clock is told where it cost this part of the objective, and the machine is called busy where other
# programs kept so many of its cores.
TOLD, BUSY_CORES = 0.02, 0.3


def explain(
    ranked: Sequence[Candidate],
    baselines: Mapping[str, Mapping[str, float]],
    station: Station,
    triangles: int,
    tool: Tool,
) -> str:
    """From the measured candidates, best first, and the baselines' metrics."""
    chosen = ranked[0]
    config, measured = chosen.config, chosen.measured
    finest = baselines["finest only"]
    cost, budget = measured["loop_cost_p999_us"], station.budget_us
    held = f"{tool.name} ({tool.balls} balls)" if tool.balls > 1 else tool.name
    where = f"at {station.loop_hz:g} Hz with a budget of {budget:g} us"
    fits = finest["loop_cost_p999_us"] <= budget and finest["memory_mb"] <= station.memory_mb
    finest_says = (
        f"The full scan of {triangles} triangles costs {finest['loop_cost_p999_us']:.3g} us at p99.9 with {held}"
    )
    if len(config.levels) == 1:
        level = config.levels[0]
        if fits and level.triangles == triangles:
            return (
                f"One level, the full scan. {finest_says}, {where}: it fits, so a second level could only take detail "
                f"away. Measured felt error {measured['felt_error_jnd']:.2f} JND."
            )
        return (
            f"One level of {level.triangles} triangles and {level.balls} of the tool's balls. {finest_says}, {where}. "
            f"This level costs {cost:.3g} us; switching to coarser ones at speed was measured to feel worse than "
            f"that is worth. Felt error {measured['felt_error_jnd']:.2f} JND."
        )
    sizes = ", ".join(f"{level.triangles} triangles with {level.balls} balls" for level in config.levels)
    speeds = ", ".join(f"{speed:.0f}" for speed in config.speeds_mm_s)
    reason = "which fits, but levels feel no worse and cost less" if fits else "which is over it"
    return (
        f"{len(config.levels)} levels ({sizes}), changing at {speeds} mm/s. {finest_says}, {where}, {reason}. "
        f"The tuned levels cost {cost:.3g} us at p99.9; on motions that the model had not seen they were measured at a "
        f"felt error of {measured['felt_error_jnd']:.2f} JND, {measured['discontinuity_per_s']:.3f} noticed jumps per "
        f"second of contact and {measured['switches_per_s']:.2f} switches per second."
    )


def agreement(chosen: Candidate) -> str:
    """What the corrected model expected of the cost, and what was measured; empty where nothing was predicted."""
    if chosen.expected_us is None or chosen.disagreement is None:
        return ""
    told = f"The model, corrected by what had been measured before, expected {chosen.expected_us:.3g} us at p99.9"
    return (
        f"{told}; measured were {chosen.measured['loop_cost_p999_us']:.3g} us, {100 * chosen.disagreement:.1f} % apart."
    )


def refusal(
    chosen: Candidate, candidates: Sequence[Candidate], ratio: float, clock: Mapping[str, float], station: Station
) -> str:
    """What the clock refused although it holds the budget by its counters; empty where that is hardly better.

    `ratio`: of times to counted costs. `clock`: what was said of the chosen, with the machine's load.
    """
    held = [c for c in candidates if holds(c.measured, station)]
    best = min(held, key=lambda c: c.objective, default=chosen)
    if best.objective >= (1.0 - TOLD) * chosen.objective:
        return ""
    cores = clock.get("load_others_cores", 0.0)
    busy = (
        f" while other programs kept {cores:.1f} cores busy: tune again on a quiet machine"
        if cores > BUSY_CORES
        else ""
    )
    return (
        f"By its counters a configuration with a felt error of {best.measured['felt_error_jnd']:.2f} JND holds the "
        f"budget, too ({best.measured['loop_cost_p999_us']:.3g} us), but the clock said up to {ratio:.2f} times as "
        f"much as the counters{busy}."
    )
