"""Measures one cell, in the process that calls: what it feels like, and, alone on a core, what it costs."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from hapticlod.config import LodConfig
from hapticlod.metrics import measure, measurement
from hapticlod.replay import Record
from tuning.compare.cell import Cell
from tuning.compare.ground import ground_of, reference_of, scan_of
from tuning.load import LoadMeter

REPEATS = 3  # a tick's time is its least over so many runs: other programs take time, the tick does not
# Histogram of costs: bins per decade, from 10^LOWEST us.
BINS_PER_DECADE, LOWEST_DECADE, DECADES = 20, -2, 8
COST_KEYS = (
    "loop_cost_mean_us", "loop_cost_p50_us", "loop_cost_p99_us", "loop_cost_p999_us", "loop_cost_max_us",
    "deadline_miss_rate", "longest_miss_run",
)  # fmt: skip


def tune_cell(cell: Cell) -> dict[str, Any]:
    """The configuration that the tuner finds for the cell's scan, tool and station, and what it predicts of it."""
    from tuning.deliver import as_built
    from tuning.tune import tune

    result = tune(scan_of(cell.scan), cell.station, cell.tool, seed=cell.tuning_seed)
    return {
        "config": as_built(result).model_dump(mode="json"),
        "predicted": {key: float(value) for key, value in result.predicted.items() if np.isfinite(value)},
        "explanation": result.explanation,
    }


def feel_of(cell: Cell, tuned: dict[str, Any] | None) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Everything but time: the metrics of feel against the finest level, and how the levels were used.

    And what `timing_of` would give, where that is counted: this very replay has counted it. None where it is timed.

    `tuned`: what `tune_cell` gave, for a cell whose configuration is to be tuned.
    """
    ground = ground_of(cell)
    config = configuration(cell, tuned)
    meter, begun = LoadMeter(), time.monotonic()
    records = ground.records(config, 1)
    load, seconds = meter.read(), time.monotonic() - begun
    found = measurement(records, reference_of(cell))
    feel = {
        "metrics": {key: value for key, value in found.metrics.items() if key not in COST_KEYS},
        "config": config.model_dump(mode="json"),
        "levels": _levels(records),
        "counts": {
            "n_ticks": found.n_ticks, "n_contact_ticks": found.n_contact_ticks, "n_switches": found.n_switches,
            "n_switches_in_contact": found.n_switches_in_contact,
        },
        "scan": {"triangles": ground.ladder.scan.triangles, "digest": ground.ladder.scan.digest},
    }  # fmt: skip
    return feel, None if cell.station.cost is None else _timing(cell, config, records, None, seconds, load)


def timing_of(cell: Cell, tuned: dict[str, Any] | None, core: int | None) -> dict[str, Any]:
    """What a tick costs. Where the station has cost coefficients its ticks are counted, otherwise timed here.

    Timed on one core (`core`, else the last that this process may use), with the machine's load beside it. What is
    counted is the same on every core, however busy.
    """
    ground = ground_of(cell)
    config = configuration(cell, tuned)
    counted = cell.station.cost is not None
    allowed = os.sched_getaffinity(0)
    chosen = None if counted else max(allowed) if core is None else core
    if chosen is not None:
        os.sched_setaffinity(0, {chosen})
    try:
        meter = LoadMeter()
        begun = time.monotonic()
        records = ground.records(config, 1 if counted else REPEATS)
        load, seconds = meter.read(), time.monotonic() - begun
    finally:
        os.sched_setaffinity(0, allowed)
    return _timing(cell, config, records, chosen, seconds, load)


def _timing(
    cell: Cell, config: LodConfig, records: list[Record], core: int | None, seconds: float, load: dict[str, float]
) -> dict[str, Any]:
    counted = cell.station.cost is not None
    if counted:
        records = [_counted(record, cell, config) for record in records]
    metrics = measure(records, records)  # against itself: only what it costs is taken
    return {
        "metrics": {key: metrics[key] for key in COST_KEYS},
        "basis": f"counted, {cell.station.name}'s coefficients" if counted else "timed here",
        "histograms": _histograms(records),
        "core": core,
        "seconds": seconds,
        "load": load,
    }


def configuration(cell: Cell, tuned: dict[str, Any] | None) -> LodConfig:
    """The cell's configuration on its scan."""
    if cell.config is None:
        if tuned is None:
            raise ValueError(f"{cell.names}: was not tuned")
        return LodConfig.model_validate(tuned["config"])
    if isinstance(cell.config, LodConfig):
        return cell.config
    return cell.config.on(ground_of(cell).ladder, cell.tool)


def bin_edges_us() -> np.ndarray:
    """(n + 1,) edges of the cost histogram's bins, us."""
    return 10.0 ** (LOWEST_DECADE + np.arange(DECADES * BINS_PER_DECADE + 1) / BINS_PER_DECADE)


def _counted(record: Record, cell: Cell, config: LodConfig) -> Record:
    from dataclasses import replace

    from tuning.calibrate import counted_cost_ns

    assert cell.station.cost is not None
    rows = record.rows.copy()
    used = np.array(record.level_bytes, dtype=np.float64)[rows["level"]]
    balls = np.array([min(level.balls, cell.tool.balls) for level in config.levels])[rows["level"]]
    rows["cost_ns"] = counted_cost_ns(record.rows, used, cell.station.cost, balls)
    return replace(record, rows=rows)


def _levels(records: list[Record]) -> list[dict[str, float]]:
    level = np.concatenate([record.level for record in records])
    speed = np.concatenate([record.speed_mm_s for record in records]).astype(np.float64)
    contact = np.concatenate([record.contact for record in records])
    told = []
    for number, triangles in enumerate(records[0].level_triangles):
        here = level == number
        told.append(
            {
                "triangles": triangles,
                "share": float(here.mean()),
                "contact_share": float((here & contact).sum() / max(int(contact.sum()), 1)),
                "mean_speed_mm_s": float(speed[here].mean()) if here.any() else 0.0,
            }
        )
    return told


def _histograms(records: list[Record]) -> list[list[tuple[int, int]]]:
    """Per level, (bin, ticks) of every bin that holds some."""
    level = np.concatenate([record.level for record in records])
    cost = np.concatenate([record.cost_us for record in records])
    edges = bin_edges_us()
    place = np.clip(np.searchsorted(edges, cost, side="right") - 1, 0, len(edges) - 2)
    made = []
    for number in range(len(records[0].level_triangles)):
        bins, ticks = np.unique(place[level == number], return_counts=True)
        made.append([(int(b), int(n)) for b, n in zip(bins, ticks, strict=True)])
    return made
