"""The page about a comparison: who ranks where, what every cell costs and feels like, what failed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tuning.compare.ledger import Row
from tuning.compare.measuring import bin_edges_us
from tuning.compare.ranking import HEADINGS, cells_of, failures, holds, standings, station_of
from tuning.report import plots
from tuning.report.page import figures, folded, page, section, table, words


def compare_report(name: str, rows: Sequence[Row], runs: Sequence[dict[str, Any]]) -> str:
    """HTML of the page about `rows` (`Ledger.latest`) and the `runs` that measured them."""
    done = [row for row in rows if row.is_done]
    parts = [section("Summary", *_summary(rows, done)), section("Ranking", _ranking(rows))]
    combinations = sorted({(row.tool, row.station) for row in done})
    for tool, station in combinations:
        here = [row for row in done if (row.tool, row.station) == (tool, station)]
        parts.append(section(f"{tool} on {station}", _drawn(here)))
    if failed := failures(rows):
        parts.append(section("Failed", *(words(line) for line in failed)))
    parts.append(section("Every cell", folded(f"{len(rows)} cells", _cells(rows))))
    parts.append(section("Provenance", *_provenance(rows, done, runs)))
    return page(f"Comparison: {name}", parts)


def _summary(rows: Sequence[Row], done: Sequence[Row]) -> list[str]:
    scans, configs = len({row.scan for row in rows}), len({row.config for row in rows})
    told = [
        f"{len(done)} of {len(rows)} cells are measured: {_many(configs, 'configuration')} on {_many(scans, 'scan')}, "
        f"with {_many(len({row.tool for row in rows}), 'tool')}."
    ]
    ranked = [standing for standing in standings(rows) if standing.mean_rank is not None]
    if ranked:
        best = ranked[0]
        told.append(
            f"{best.config} ranks best: {best.wins} of {best.groups} times first, mean rank {best.mean_rank:.2f}; it "
            f"holds the budget in {best.holds} of {best.done} cells."
        )
    for tool in sorted({row.tool for row in done}):
        within = [s for s in standings([row for row in rows if row.tool == tool]) if s.mean_rank is not None]
        if within and len({row.tool for row in done}) > 1:
            told.append(f"With {tool} it is {within[0].config} (mean rank {within[0].mean_rank:.2f}).")
    return [words(" ".join(told))]


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _ranking(rows: Sequence[Row]) -> str:
    headings = ["configuration", *(heading.replace("-\n", "").replace("\n", " ") for heading in HEADINGS)]
    made = [(standing.config, *cells_of(standing)) for standing in standings(rows)]
    caption = (
        "Ranks within each scan, tool, station and motion: what holds the budget first, then by felt error and noticed "
        "jumps. Medians over cells."
    )
    return table(headings, made, caption)


def _drawn(rows: Sequence[Row]) -> str:
    configs = sorted({row.config for row in rows})
    budget_us = station_of(rows[0]).budget_us

    def by_scan(metric: str, factor: float = 1.0) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, list[float]]] = {config: {} for config in configs}
        for row in rows:
            found[row.config].setdefault(row.scan, []).append(factor * row.metrics[metric])
        return {c: {scan: float(np.mean(values)) for scan, values in scans.items()} for c, scans in found.items()}

    pairs: dict[str, list[tuple[float, float]]] = {config: [] for config in configs}
    for row in rows:
        pairs[row.config].append((row.metrics["loop_cost_p999_us"] / budget_us, row.metrics["felt_error_jnd"]))
    edges = bin_edges_us()
    ticks = {config: np.zeros(len(edges) - 1) for config in configs}
    for row in rows:
        for level in (row.timing or {})["histograms"]:
            for place, count in level:
                ticks[row.config][place] += count
    return figures(
        (plots.cost_and_feel(pairs), "Every cell: down is better to feel, left is cheaper, right of the line misses."),
        (
            plots.cost_distribution_of_bins(edges, ticks, budget_us, title="Loop cost over all scans"),
            "How large a share of ticks takes longer than the time below, all scans together.",
        ),
        (
            plots.metric_by_scan(by_scan("felt_error_jnd"), "felt error (JND)", title="Felt error by scan"),
            "Felt error against the finest level; left is better.",
        ),
        (
            plots.metric_by_scan(
                by_scan("loop_cost_p999_us", 1.0 / budget_us), "p99.9 of the loop cost / budget", log=True, line=1.0,
                title="Loop cost by scan",
            ),
            "Left of the line the budget holds.",
        ),
    )  # fmt: skip


def _cells(rows: Sequence[Row]) -> str:
    made = []
    for row in rows:
        head = (row.scan, row.config, row.tool, row.station, row.motion)
        if not row.is_done:
            made.append((*head, *["-"] * 5, row.error or "not timed"))
            continue
        m, load = row.metrics, "counted" if _counted(row) else f"{(row.timing or {})['load']['others_cores']:.2f}"
        made.append(
            (
                *head, f"{m['loop_cost_p999_us']:.1f}", f"{m['felt_error_jnd']:.2f}", f"{m['discontinuity_per_s']:.3f}",
                f"{m['switches_per_s']:.2f}", "yes" if holds(row) else "no", load,
            )
        )  # fmt: skip
    numbers = ("p99.9 µs", "felt JND", "jumps 1/s", "switches 1/s", "holds", "other load, cores")
    headings = ("scan", "configuration", "tool", "station", "motion", *numbers)
    return table(headings, made, "In the order of names", texts=5)


def _counted(row: Row) -> bool:
    return row.about["station"].get("cost") is not None


def _provenance(rows: Sequence[Row], done: Sequence[Row], runs: Sequence[dict[str, Any]]) -> list[str]:
    codes = sorted({row.code for row in rows})
    loads = [(row.timing or {})["load"]["others_cores"] for row in done if not _counted(row)]
    told = [f"Code version {', '.join(codes)}."]
    if len(codes) > 1:
        told.append("Cells of several code versions are shown together: measure again to compare them.")
    if loads:
        told.append(
            f"While ticks were timed, other programs kept {np.median(loads):.2f} cores busy in the median and "
            f"{max(loads):.2f} at most; a tick's time is its least over three runs."
        )
    if len(loads) < len(done):
        told.append("What ticks cost on a station with coefficients of its own was counted, not timed.")
    keys = ("hapticlod", "processor", "kernels", "cells")
    started = [(f"{run['started'][:19]} UTC".replace("T", " "), *(run.get(key) for key in keys)) for run in runs]
    stations = {row.station: row.about["station"] for row in rows}
    about = [(name, f"{s['loop_hz']:g} Hz, budget {s['budget_us']:g} µs, slowdown {s['slowdown']:g}, "
              f"{'own' if s.get('cost') else 'no'} cost coefficients") for name, s in stations.items()]  # fmt: skip
    digests = sorted({(row.scan, row.about["scan_digest"]) for row in rows})
    return [
        words(" ".join(told)),
        table(("started", "HapticLOD", "processor", "kernels", "cells"), started, "Runs, oldest first", texts=4),
        table(("station", "as measured for"), about, "Stations", texts=2),
        folded("Digests of the scans", table(("scan", "BLAKE2b of its file"), digests, "", texts=2)),
    ]
