"""A population of motions: what a configuration is judged by when several hands, or tasks, must be content with it.

Pooled, all motions count as one long one: those with much contact and large errors decide. By the mean every motion
has one vote; by the worst, only the motion that is served worst has. Limits of cost and memory hold for all motions
together whatever the objective is taken over.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.metrics import measure
from tuning import kept
from tuning.objective import disturbance, objective
from tuning.verify import Verifier

POOLED, MEAN, WORST = "pooled", "mean", "worst"
OVER = (POOLED, MEAN, WORST)
# JND by which the surrogate's worst is softened: motions closer than this share the blame.
_SOFT = 0.02


def check_over(over: str) -> None:
    """Raises InputError where it is none of `OVER`."""
    if over not in OVER:
        raise InputError("over", f"{over!r} is none of {', '.join(OVER)}", "give one of them")


def over_motions(each: Any, worst: Any) -> Any:
    """The mean of (M,) values, or where `worst` holds their largest, softened so that it has a gradient.

    `worst` may be traced: one compilation serves both.
    """
    import jax.numpy as jnp

    from hapticlod.surrogate.quantile import smooth_max

    return jnp.where(worst, smooth_max(each, _SOFT), jnp.mean(each))


def measured_each(verifier: Verifier, config: LodConfig) -> list[dict[str, float]]:
    """The metrics of every motion alone, in the runtime. Kept as the verifier's other measurements are."""
    key = kept.key_of("each", verifier.key, config.changed(name="").model_dump_json())
    found = kept.load("each", key) if verifier.key else None
    if found is None:
        pairs = zip(verifier.records(config), verifier.reference(), strict=True)
        found = [measure(record, reference) for record, reference in pairs]
        if verifier.key:
            kept.store("each", key, found)
    return found


def measured_over(disturbances: list[float], over: str) -> float:
    """The mean or the largest: exactly, as the final choice is made."""
    return float(np.mean(disturbances) if over == MEAN else np.max(disturbances))


def measured_objective(verifier: Verifier, config: LodConfig, metrics: dict[str, float], over: str) -> float:
    """What is minimised, by what was measured: `metrics` are the configuration's over all motions together."""
    pooled = float(objective(metrics, verifier.station.budget_us))
    if over == POOLED:
        return pooled
    felt = [disturbance(m["felt_error_jnd"], m["discontinuity_per_s"]) for m in measured_each(verifier, config)]
    together = disturbance(metrics["felt_error_jnd"], metrics["discontinuity_per_s"])
    return pooled - together + measured_over(felt, over)
