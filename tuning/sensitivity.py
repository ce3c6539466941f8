"""What more budget or memory would buy: the surrogate's optimum, differentiated in its limits."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.station import Station
from tuning.implicit import Response, differentiate_optimum
from tuning.sample import threads
from tuning.search import Limits, Search
from tuning.space import Space

LIMITS = ("budget_us", "memory_mb")
METRICS = ("felt_error_jnd", "discontinuity_per_s", "loop_cost_p999_us", "switches_per_s", "memory_mb")
# An optimum whose slopes do not cancel better than this was not reached: its derivatives would say nothing.
MOST_RESIDUAL, MOST_VIOLATION = 0.1, 2e-3
_LOOK = 2e-3  # how far x goes for differences of metrics
# A change below this is not worth a sentence, JND or jumps per second.
_NOTABLE = 0.01


@dataclass(frozen=True)
class Optimum:
    """Where the search ended: x for so many levels, under the limits that it was given."""

    x: NDArray[np.float64]
    levels: int
    limits: Limits


def moving(space: Space, levels: int) -> NDArray[np.bool_]:
    """(n,) coordinates that matter with so many levels; those of absent levels and of levers without room do not."""
    k = space.most_levels
    low, high = space.log_bounds
    free = high > low
    for start, used, size in ((0, levels, k), (k, levels, k), (2 * k, levels, k), (3 * k, levels - 1, k - 1)):
        free[start + used : start + size] = False
    if levels == 1:
        free[4 * k - 1 :] = False  # nothing to switch between
    return free


# Of the full scan alone: nothing binds.
_ZERO = {"binds": False, **dict.fromkeys(("objective", *METRICS), 0.0)}
UNBOUND: dict[str, Any] = {"residual": 0.0, "reliable": True, **dict.fromkeys(LIMITS, _ZERO)}


def sensitivities(search: Search, space: Space, optimum: Optimum, station: Station) -> dict[str, Any]:
    """Derivatives of objective and metrics at the surrogate's optimum, per us of budget and per MB of memory.

    Args:
        search: that found the optimum.
        optimum: where that search ended.
        station: its budget and memory limit are what is moved.

    Returns:
        dict: `residual` (0 at a minimum; null where slopes were not finite), `reliable`, and by limit `binds` and the
        derivatives. These are null where the search did not end at a minimum, 0 where the limit does not bind.
    """
    x, levels, limits = optimum.x, optimum.levels, optimum.limits
    with ThreadPoolExecutor(threads()) as pool:
        found = differentiate_optimum(
            lambda point: search.slopes(point, levels, limits), x, -np.eye(2), linear=space.order_rows(levels),
            moving=moving(space, levels), many=pool.map,
        )  # fmt: skip
    kept = found.violation <= MOST_VIOLATION
    reliable = bool(kept and found.residual <= MOST_RESIDUAL and np.isfinite(found.x).all())
    residual = float(found.residual) if np.isfinite(found.residual) else None
    told: dict[str, Any] = {"residual": residual, "reliable": reliable}
    for i, (name, value) in enumerate(zip(LIMITS, (station.budget_us, station.memory_mb), strict=True)):
        binds = bool(found.multipliers[i] > 1e-6)
        slopes = _metric_slopes(search, optimum, found, i)
        each = {key: float(slope / value) if reliable else None for key, slope in slopes.items()}
        told[name] = {"binds": binds, **each}
    return told


def marginal_value(search: Search, space: Space, optimum: Optimum, budget_us: float) -> float | None:
    """d(objective)/d(budget), per us, by the multiplier alone: one gradient. None where there is no minimum."""
    x, levels, limits = optimum.x, optimum.levels, optimum.limits
    found = differentiate_optimum(
        lambda point: search.slopes(point, levels, limits), x, np.zeros((2, 0)), linear=space.order_rows(levels),
        moving=moving(space, levels),
    )  # fmt: skip
    if found.violation > MOST_VIOLATION or found.residual > MOST_RESIDUAL:
        return None
    return -float(found.multipliers[0]) / budget_us


def _metric_slopes(search: Search, optimum: Optimum, found: Response, limit: int) -> dict[str, float]:
    """By ln of a limit: the objective's by its multiplier, the metrics' by looking along dx."""
    direction = found.x[:, limit]
    slopes = {"objective": float(found.objective[limit]), **dict.fromkeys(METRICS, 0.0)}
    reach = np.abs(direction).max(initial=0.0)
    if reach == 0.0 or not np.isfinite(reach):
        return slopes
    step = _LOOK / reach
    ends = [np.clip(optimum.x + sign * step * direction, 0.0, 1.0) for sign in (1.0, -1.0)]
    more, less = (search.look(end, optimum.levels, optimum.limits).predicted for end in ends)
    slopes.update({name: (more[name] - less[name]) / (2 * step) for name in METRICS})
    return slopes


def sentence(told: Mapping[str, Any], station: Station) -> str:
    """What a user wants to know of it, in one sentence; empty where there is nothing to say."""
    if not told["reliable"]:
        return ""
    budget, memory = told["budget_us"], told["memory_mb"]
    if not budget["binds"] and not memory["binds"]:
        return "Neither budget nor memory limit holds the feel back: more of them would not improve it."
    for limit, unit, at in ((budget, "us more budget", station.budget_us), (memory, "MB more", station.memory_mb)):
        amount = _round_amount(at)
        felt, jumps = (amount * limit[key] for key in ("felt_error_jnd", "discontinuity_per_s"))
        changes = [
            f"{'lower' if change < 0 else 'raise'} {name} by {abs(change):.2g}{of}"
            for change, name, of in ((felt, "the felt error", " JND"), (jumps, "noticed jumps", " per second"))
            if abs(change) >= _NOTABLE
        ]
        if limit["binds"] and changes and amount * limit["objective"] <= -_NOTABLE:
            return f"At this optimum, by the model, {amount:g} {unit} would {' and '.join(changes)}."
    return ""


def _round_amount(limit: float) -> float:
    """1, 2 or 5 times a power of ten, about a twentieth of the limit."""
    power = 10.0 ** np.floor(np.log10(limit / 20))
    return float(power * max(m for m in (1, 2, 5) if m * power <= limit / 20 * (1 + 1e-9)))
