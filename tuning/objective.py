"""What a configuration is judged by: what is minimised, and the limits that must hold. Plain arithmetic, on numbers or
on JAX arrays: `hapticlod compare` ranks with it and does not import JAX.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapticlod.station import Station

# One noticed jump per second weighs as much as one JND of felt error. Needs people; a preset of the preference.
DISCONTINUITY_WEIGHT = 1.0
# Ties go to less work: a hundredth of a JND for a budget's worth of mean cost.
COST_WEIGHT = 0.01
ROUNDED_JND = 1e-3


def objective(metrics: Any, budget_us: Any) -> Any:
    """What is minimised: felt error plus noticed jumps, and a trace of cost to settle ties."""
    return felt_of(metrics) + COST_WEIGHT * metrics["loop_cost_mean_us"] / budget_us


def felt_of(metrics: Any) -> Any:
    """The `disturbance` of all motions together."""
    return disturbance(metrics["felt_error_jnd"], metrics["discontinuity_per_s"])


def disturbance(felt_error_jnd: Any, discontinuity_per_s: Any) -> Any:
    """What is felt of a configuration: the objective without its trace of cost."""
    return felt_error_jnd + DISCONTINUITY_WEIGHT * discontinuity_per_s


def rounded(felt: Any) -> Any:
    """What a search minimises of a disturbance: the same but for a thousandth of a JND, and with slopes at nothing.

    Felt error grows like a root from the full scan on. Where a smaller budget takes the full scan away, a search that
    begins there would not leave: to keep the budget seems worth less than the root's slope, which has no bound.
    """
    return (felt * felt + ROUNDED_JND * ROUNDED_JND) ** 0.5 - ROUNDED_JND


def holds(metrics: Mapping[str, float], station: Station) -> bool:
    """Whether budget and memory hold."""
    return metrics["loop_cost_p999_us"] <= station.budget_us and metrics["memory_mb"] <= station.memory_mb
