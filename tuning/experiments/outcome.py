"""What an experiment gives: figures by file name, numbers for its table, and the assumptions behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hapticlod.config import LodConfig
from hapticlod.metrics import measure
from hapticlod.motion import Motion
from hapticlod.replay import Record, replay_levels
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.experiments.old_machine import Loop, cost_ns, run_late
from tuning.report.plots import forces_over_time

Array = NDArray[np.float64]
SHOWN = (
    "felt_error_jnd", "switch_jump_max_n", "discontinuity_per_s", "facet_vibration_n", "switches_per_s",
    "mapping_hit_rate", "false_release_per_min",
)  # fmt: skip
SETTLED_S = 0.2  # a slide starts on the surface: how the first ticks come in is no part of it


@dataclass
class Outcome:
    """Figures by name (without ending), one row of numbers per run, and what was assumed."""

    figures: dict[str, Figure] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    assumed: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Surface:
    """Levels that stand by, finest first, and where they are."""

    levels: Sequence[Any]
    origin_mm: Array


def run_both(
    name: str, config: LodConfig, surface: Surface, motion: Motion, tool: Tool, station: Station, reference: Record, *,
    cut_short: bool = False,
) -> tuple[Record, Loop, dict[str, Any]]:  # fmt: skip
    """One configuration on time and on the old machine (there with ticks `cut_short` or not), its row of numbers."""
    levels = list(surface.levels)
    record = replay_levels(levels, config, surface.origin_mm, motion, tool, station, 1, cut_short=False)
    late = run_late(levels, config, surface.origin_mm, motion, tool, station, cut_short=cut_short)
    metrics = measure(record, reference)
    cost_us = 1e-3 * station.slowdown * cost_ns(record.rows, record.level_bytes, station)
    touching = reference.contact & (motion.time_s > SETTLED_S)
    error = np.linalg.norm(late.felt_n - reference.force, axis=1)[touching]
    settled = late.felt_n[motion.time_s > SETTLED_S]
    row = {
        "run": name,
        "mean_speed_mm_s": round(float(motion.speed_mm_s().mean()), 1),
        **{key: metrics[key] for key in SHOWN},
        "old_cost_p50_us": float(np.median(cost_us)),
        "old_cost_p99_us": float(np.quantile(cost_us, 0.99)),
        "old_rate_hz": late.rate_hz,
        "old_late_share": late.late_share,
        "old_force_error_rms_n": float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
        "old_force_error_max_n": float(error.max(initial=0.0)),
        "old_force_range_n": (settled.max(axis=0) - settled.min(axis=0)).round(6).tolist(),
    }
    return record, late, row


def figure_of(title: str, record: Record, late: Loop | None, motion: Motion, station: Station, **how: Any) -> Figure:
    """The paper's kind of figure; `late`: as the old machine rendered it, otherwise on time."""
    level = record.level if len(record.level_triangles) > 1 else None
    if late is None:
        cost_us = 1e-3 * station.slowdown * cost_ns(record.rows, record.level_bytes, station)
        return forces_over_time(
            motion.time_s, record.force, motion.speed_mm_s(), cost_us, title=title, level=level, **how
        )
    begun = np.searchsorted(late.started_s, motion.time_s, side="right") - 1
    level = late.rows["level"][begun] if level is not None else None
    cost_us = late.cost_us[begun]
    return forces_over_time(motion.time_s, late.felt_n, motion.speed_mm_s(), cost_us, title=title, level=level, **how)
