"""The plots. Each is a function of records or numbers that returns a matplotlib figure; none of them computes a metric.

In a notebook: `from tuning.report import plots; plots.force_and_speed(record)`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import ArrayLike, NDArray

from hapticlod.metrics import switch_jumps_n
from hapticlod.replay import Record
from tuning.report.style import BLUE, COLOURS, DASHES, GREEN, LEVEL_SHADES, MARKERS, VERMILION, panels, styled, thinned

Array = NDArray[np.float64]
_COLUMNS = 1000  # of level shading: changes that are quicker than a column cannot be seen


def shade_levels(axes: Axes, time_s: ArrayLike, level: ArrayLike) -> None:
    """Fills the background by the level in use: white for the finest, darker for coarser ones."""
    at, used = np.asarray(time_s, dtype=np.float64), np.asarray(level)
    every = max(len(at) // _COLUMNS, 1)
    at, used = np.append(at[::every], at[-1]), used[::every]
    edges = np.flatnonzero(np.diff(used)) + 1
    starts, stops = np.array([0, *edges]), np.array([*edges, len(used)])
    for number in range(1, int(used.max(initial=0)) + 1):
        here = used[starts] == number
        spans = [
            (float(at[first]), float(at[last] - at[first]))
            for first, last in zip(starts[here], stops[here], strict=True)
        ]
        shade = LEVEL_SHADES[number]
        axes.broken_barh(
            spans, (0.0, 1.0), transform=axes.get_xaxis_transform(), facecolor=shade, edgecolor="none", zorder=0
        )


@styled
def force_and_speed(
    record: Record,
    reference: Record | None = None,
    *,
    thresholds_mm_s: Sequence[float] = (),
    title: str = "Force and speed over time, levels shaded",
) -> Figure:
    """Force, speed and level of one replay over time; `reference`: the finest level's force, for comparison."""
    figure, (force, speed, level) = panels(title, (1.7, 1.3, 0.6))
    at = record.time_s
    if reference is not None:
        force.plot(*thinned(at, np.linalg.norm(reference.force, axis=1)), color="#7F7F7F", lw=2.2, label="finest level")
    force.plot(*thinned(at, np.linalg.norm(record.force, axis=1)), color=VERMILION, label="rendered")
    force.set_ylabel("force (N)")
    force.set_ylim(bottom=0.0)
    if reference is not None:
        force.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2)
    speed.plot(*thinned(at, record.speed_mm_s), color=BLUE)
    for threshold in thresholds_mm_s:
        speed.axhline(threshold, color="black", lw=0.8, ls=(0, (4, 2)))
    speed.set_ylabel("speed (mm/s)")
    speed.set_ylim(bottom=0.0)
    _level_strip(level, record)
    for axes in (force, speed):
        shade_levels(axes, at, record.level)
    level.set_xlabel("time (s)")
    return figure


def _level_strip(axes: Axes, record: Record) -> None:
    axes.step(record.time_s, record.level, where="post", color="black", lw=0.9)
    count = len(record.level_triangles)
    axes.set_yticks(range(count))
    axes.set_ylim(count - 0.6, -0.4)
    axes.set_ylabel("level")


@styled
def cost_distribution(
    costs_us: Mapping[str, ArrayLike], budget_us: float, *, title: str = "Loop cost: share of ticks that take longer"
) -> Figure:
    """Share of ticks that cost more than x, one line per level (or whatever the keys name), and the budget.

    Args:
        costs_us: by name, (T,) cost of each tick, us. Empty ones are left out.
    """
    curves = {}
    for name, costs in costs_us.items():
        ordered = np.sort(np.asarray(costs, dtype=np.float64))
        if len(ordered):
            above = 1.0 - np.arange(1, len(ordered) + 1) / len(ordered)
            curves[name] = (ordered, np.maximum(above, 0.5 / len(ordered)))
    return _exceedance(curves, budget_us, title)


@styled
def cost_distribution_of_bins(
    edges_us: ArrayLike, ticks: Mapping[str, ArrayLike], budget_us: float, *,
    title: str = "Loop cost: share of ticks that take longer",
) -> Figure:  # fmt: skip
    """As `cost_distribution`, from histograms: edges (n + 1,) and ticks (n,) per name."""
    edges = np.asarray(edges_us, dtype=np.float64)
    curves = {}
    for name, counted in ticks.items():
        counts = np.asarray(counted, dtype=np.float64)
        if counts.sum() > 0:
            some = np.flatnonzero(counts)
            used = slice(some[0], some[-1] + 1)
            above = 1.0 - np.cumsum(counts[used]) / counts.sum()
            curves[name] = (edges[1:][used], np.maximum(above, 0.5 / counts.sum()))
    return _exceedance(curves, budget_us, title)


def _exceedance(curves: Mapping[str, tuple[Array, Array]], budget_us: float, title: str) -> Figure:
    figure, (axes,) = panels(title, (2.7,))
    for i, (name, (cost, above)) in enumerate(curves.items()):
        kept = np.unique(np.geomspace(1, len(cost), 400).astype(int) - 1)  # the tail is what matters
        kept = np.unique(np.concatenate([kept, len(cost) - 1 - kept]))
        axes.step(
            cost[kept], above[kept], where="post", color=COLOURS[i % 8], ls=DASHES[i % 8], label=name,
            lw=1.8 if name == "all" else 1.2,
        )  # fmt: skip
    _budget_line(axes, budget_us, f"budget {budget_us:g} µs", 0.03)  # below the curves
    axes.axhline(1e-3, color="black", lw=0.7, ls=(0, (1, 2)))
    axes.annotate("p99.9", (0.005, 1e-3), xycoords=("axes fraction", "data"), fontsize=8, va="bottom")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("cost of one tick (µs)")
    axes.set_ylabel("share of ticks above")
    figure.legend(loc="outside lower left", ncols=3)
    return figure


def _budget_line(axes: Axes, at: float, text: str, height: float) -> None:
    """An upright line that says what it is, beside it, at the height of a share of the axes."""
    axes.axvline(at, color="black", lw=1.4)
    axes.annotate(
        text, (at, height), xycoords=("data", "axes fraction"), xytext=(-3, 0), textcoords="offset points",
        rotation=90, va="bottom" if height < 0.5 else "top", ha="right", fontsize=8,
    )  # fmt: skip


@styled
def jumps_at_switches(
    record: Record, reference: Record, *, title: str = "Force jumps at level changes in contact"
) -> Figure:
    """Jump of every switch in contact (as `switch_jump_n` is measured) over the speed at which it happened."""
    figure, (axes,) = panels(title, (2.2,))
    level = record.level.astype(np.int64)
    switches = np.flatnonzero(np.diff(level)) + 1
    touching = record.contact[switches] | record.contact[switches - 1]
    jumps = switch_jumps_n(record.force, reference.force, switches, round(record.blend_s * record.loop_hz))[touching]
    coarser = (level[switches] > level[switches - 1])[touching]
    speed = record.speed_mm_s[switches[touching]]
    for chosen, name, colour, marker in ((coarser, "to coarser", BLUE, "v"), (~coarser, "to finer", VERMILION, "^")):
        axes.plot(speed[chosen], 1e3 * jumps[chosen], marker, color=colour, ms=5, mfc="none", label=name)
    if len(jumps):
        axes.legend(loc="upper left")
    else:
        axes.text(0.5, 0.5, "no level changed in contact", transform=axes.transAxes, ha="center")
        axes.set_xlim(0.0, 1.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("speed at the switch (mm/s)")
    axes.set_ylabel("jump (mN)")
    return figure


@styled
def predicted_and_measured(
    predicted: Mapping[str, float], measured: Mapping[str, float], *, title: str = "Predicted against measured"
) -> Figure:
    """Predicted over measured, one line per metric that both have and that is not 0."""
    shown = [
        (key, predicted[key], measured[key])
        for key in _RATIO_METRICS
        if (predicted.get(key) or 0.0) > 1e-9 and (measured.get(key) or 0.0) > 1e-9
    ]
    figure, (axes,) = panels(title, (0.6 + 0.26 * max(len(shown), 1),))
    axes.axvspan(0.8, 1.25, color="#E6E6E6", zorder=0)
    axes.axvline(1.0, color="black", lw=0.9)
    for i, (_, said, was) in enumerate(shown):
        axes.plot(said / was, i, "o", color=BLUE)
        text = f"{_three_digits(said)} / {_three_digits(was)}"
        axes.annotate(text, (1.01, i), xycoords=("axes fraction", "data"), va="center", fontsize=8)
    axes.set_yticks(range(len(shown)), [_RATIO_METRICS[key] for key, _, _ in shown])
    axes.set_ylim(max(len(shown), 1) - 0.5, -0.5)
    axes.set_xscale("log")
    axes.set_xlim(0.2, 5.0)
    axes.set_xticks([0.2, 0.5, 1.0, 2.0, 5.0], ["0.2", "0.5", "1", "2", "5"])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("predicted / measured (values at the right; grey: within 0.8 to 1.25)")
    if not shown:
        axes.text(0.5, 0.5, "nothing to compare", transform=axes.transAxes, ha="center")
    return figure


def _three_digits(value: float) -> str:
    return np.format_float_positional(value, precision=3, fractional=False, trim="-")


_RATIO_METRICS = {
    "loop_cost_mean_us": "loop cost, mean", "loop_cost_p50_us": "loop cost, p50", "loop_cost_p99_us": "loop cost, p99",
    "loop_cost_p999_us": "loop cost, p99.9", "felt_error_jnd": "felt error", "force_error_rms_n": "force error, rms",
    "facet_vibration_n": "facet vibration", "switches_per_s": "switches", "switch_jump_p50_n": "switch jump, p50",
    "switch_jump_p99_n": "switch jump, p99", "discontinuity_per_s": "discontinuity", "memory_mb": "memory",
}  # fmt: skip


@styled
def pareto_front(
    points: Sequence[Mapping[str, Any]], *, chosen: tuple[float, float] | None = None,
    title: str = "What each budget buys",
) -> Figure:  # fmt: skip
    """Felt error over budget. `points` as `hapticlod pareto` writes them; `chosen`: (budget us, felt error JND)."""
    figure, (axes,) = panels(title, (2.4,))
    budgets = [point["budget_us"] for point in points]
    axes.plot(budgets, [p["predicted"]["felt_error_jnd"] for p in points], "-o", color=BLUE, ms=4, label="predicted")
    measured = [(p["budget_us"], p["measured"]["felt_error_jnd"]) for p in points if p.get("measured")]
    if measured:
        axes.plot(*zip(*measured, strict=True), "s", color=VERMILION, mfc="none", label="measured")
    if chosen is not None:
        axes.plot(*chosen, "*", color="black", ms=10, label="this bundle, measured")
    axes.set_xscale("log")
    # Budgets are few and near each other: written out, where powers of ten would leave one tick or overlap.
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("budget for the loop cost at p99.9 (µs)")
    axes.set_ylabel("felt error (JND)")
    axes.legend(loc="upper right")
    return figure


@styled
def surrogate_quality(metrics: Mapping[str, Mapping[str, Any]], *, title: str = "How well the model ranks") -> Figure:
    """Spearman's rank correlation per metric beside its ceiling; `metrics` as `make evaluate-surrogate` writes them."""
    shown = [(key, m) for key, m in metrics.items() if m.get("spearman") is not None]
    figure, (axes,) = panels(title, (0.6 + 0.22 * max(len(shown), 1),))
    for i, (_, found) in enumerate(shown):
        axes.plot([0.0, found["spearman"]], [i, i], color=BLUE, lw=1.5)
        axes.plot(found["spearman"], i, "o", color=BLUE, label="model" if i == 0 else None)
        if found.get("ceiling") is not None:
            label = "ceiling: two measurements" if i == 0 else None
            axes.plot(found["ceiling"], i, "|", color="black", ms=11, mew=2, label=label)
    axes.set_yticks(range(len(shown)), [_RATIO_METRICS.get(key, key) for key, _ in shown])
    axes.set_ylim(max(len(shown), 1) - 0.5, -0.5)
    axes.set_xlim(min(0.0, *(m["spearman"] for _, m in shown), 0.0), 1.02)
    axes.set_xlabel("Spearman's rank correlation with measurements")
    if shown:
        figure.legend(loc="outside lower left", ncols=2)
    return figure


@styled
def cost_and_feel(
    points: Mapping[str, Sequence[tuple[float, float]]], *, title: str = "Cost and feel of every cell"
) -> Figure:
    """p99.9 cost over the budget against felt error; by configuration, one (cost share, JND) per cell."""
    figure, (axes,) = panels(title, (3.2,))
    for i, (name, found) in enumerate(points.items()):
        if found:
            share, jnd = np.array(found).T
            axes.plot(share, jnd, MARKERS[i % 8], color=COLOURS[i % 8], mfc="none", ms=5, label=name)
    _budget_line(axes, 1.0, "budget", 0.97)
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=0.1)
    most = max((jnd for found in points.values() for _, jnd in found), default=1.0)
    axes.set_ylim(-0.01, max(1.4 * most, 0.2))
    axes.set_xlabel("loop cost at p99.9 / budget")
    axes.set_ylabel("felt error (JND)")
    figure.legend(loc="outside lower left", ncols=3)
    return figure


@styled
def metric_by_scan(
    values: Mapping[str, Mapping[str, float]], unit: str, *, title: str, log: bool = False, line: float | None = None
) -> Figure:
    """One metric: a row per scan, a mark per configuration. values: configuration -> scan -> number."""
    scans = sorted({scan for found in values.values() for scan in found})
    figure, (axes,) = panels(title, (0.9 + 0.27 * max(len(scans), 1),))
    for i, (name, found) in enumerate(values.items()):
        known = [(found[scan], row) for row, scan in enumerate(scans) if scan in found]
        if known:
            axes.plot(*zip(*known, strict=True), MARKERS[i % 8], color=COLOURS[i % 8], mfc="none", ms=5.5, label=name)
    axes.set_yticks(range(len(scans)), [scan if len(scan) <= 26 else f"{scan[:12]}…{scan[-12:]}" for scan in scans])
    axes.set_ylim(max(len(scans), 1) - 0.5, -0.5)
    if log:
        axes.set_xscale("log")
    else:
        axes.set_xscale("symlog", linthresh=0.1)
        most = max((value for found in values.values() for value in found.values()), default=1.0)
        axes.set_xlim(-0.01, max(1.4 * most, 0.2))
    if line is not None:
        axes.axvline(line, color="black", lw=1.4)
    axes.set_xlabel(unit)
    figure.legend(loc="outside lower left", ncols=3)
    return figure


@styled
def forces_over_time(
    time_s: ArrayLike, force_n: ArrayLike, speed_mm_s: ArrayLike, cost_us: ArrayLike, *, title: str,
    level: ArrayLike | None = None, budget_us: float = 1000.0, magnitude: bool = False,
) -> Figure:  # fmt: skip
    """As the paper's figures: force (x, y, z, or its magnitude) and speed over time, and what each tick cost."""
    at, force = np.asarray(time_s, dtype=np.float64), np.asarray(force_n, dtype=np.float64)
    figure, (upper, middle, lower) = panels(title, (1.6, 1.0, 1.0))
    if magnitude:
        upper.plot(*thinned(at, np.linalg.norm(force, axis=1)), color=VERMILION, lw=0.9)
        upper.set_ylabel("force (N)")
    else:
        for axis, colour, dashes in ((0, BLUE, DASHES[1]), (1, GREEN, DASHES[2]), (2, VERMILION, DASHES[0])):
            upper.plot(*thinned(at, force[:, axis]), color=colour, ls=dashes, lw=0.9, label="xyz"[axis])
        upper.set_ylabel("force (N)")
        upper.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3)
    middle.plot(*thinned(at, np.asarray(speed_mm_s, dtype=np.float64)), color=BLUE)
    middle.set_ylabel("speed\n(mm/s)")
    lower.plot(*thinned(at, np.asarray(cost_us, dtype=np.float64)), color="black", lw=0.7)
    lower.axhline(budget_us, color=VERMILION, lw=1.3)
    lower.set_yscale("log")
    lower.set_ylabel("cost (µs)\nline: budget")
    lower.set_xlabel("time (s)")
    for axes in (middle, lower):
        axes.set_xlim(at[0], at[-1])
    middle.set_ylim(bottom=0.0)
    if level is not None:
        for axes in (upper, middle):
            shade_levels(axes, at, level)
    return figure
