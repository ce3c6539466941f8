"""Which configuration is best over everything that was compared.

Within a group (scan, tool, station, motion) configurations that hold the station's budget and memory come before those
that do not, and each kind is ordered by the tuner's own objective. Over groups: the mean of these ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median

from rich import box
from rich.table import Table

from hapticlod.station import Station
from tuning.compare.ledger import Row
from tuning.objective import holds as within_limits
from tuning.objective import objective


@dataclass(frozen=True)
class Standing:
    """One configuration. Medians are over the cells that are done; `budget_share`: p99.9 cost over the budget."""

    config: str
    mean_rank: float | None
    groups: int
    wins: int
    holds: int
    done: int
    failed: int
    budget_share: float | None
    felt_error_jnd: float | None
    discontinuity_per_s: float | None
    memory_mb: float | None


def holds(row: Row) -> bool:
    """Whether the cell keeps its station's budget and memory."""
    return within_limits(row.metrics, station_of(row))


def station_of(row: Row) -> Station:
    """The station the cell was measured for."""
    return Station.model_validate(row.about["station"])


def ranks(rows: Sequence[Row]) -> dict[tuple[str, ...], list[Row]]:
    """The cells that are done, by group, best first; only groups in which every configuration is done are ranked."""
    configs = {row.config for row in rows}
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        if row.is_done:
            groups.setdefault(row.group, []).append(row)
    whole = {group: found for group, found in groups.items() if {row.config for row in found} == configs}

    def place(row: Row) -> tuple[bool, float]:
        return not holds(row), float(objective(row.metrics, station_of(row).budget_us))

    return {group: sorted(found, key=place) for group, found in whole.items()}


def standings(rows: Sequence[Row]) -> list[Standing]:
    """Every configuration, best first; those without a rank last."""
    ranked = ranks(rows)
    made = []
    for config in sorted({row.config for row in rows}):
        own = [row for row in rows if row.config == config]
        done = [row for row in own if row.is_done]
        at = [1 + [row.config for row in group].index(config) for group in ranked.values()]
        made.append(
            Standing(
                config=config,
                mean_rank=mean(at) if at else None,
                groups=len(at),
                wins=at.count(1),
                holds=sum(holds(row) for row in done),
                done=len(done),
                failed=sum(not row.is_done and row.error is not None for row in own),
                budget_share=_median([row.metrics["loop_cost_p999_us"] / station_of(row).budget_us for row in done]),
                felt_error_jnd=_median([row.metrics["felt_error_jnd"] for row in done]),
                discontinuity_per_s=_median([row.metrics["discontinuity_per_s"] for row in done]),
                memory_mb=_median([row.metrics["memory_mb"] for row in done]),
            )
        )
    return sorted(made, key=lambda s: (s.mean_rank is None, s.mean_rank or 0.0, s.config))


HEADINGS = (
    "mean\nrank", "best\nof", "holds\nbudget", "p99.9 %\nbudget", "felt\nJND", "jumps\n1/s", "memory\nMB", "fail-\ned",
)  # fmt: skip


def cells_of(standing: Standing) -> list[str]:
    """The texts under `HEADINGS`."""
    s = standing

    def text(value: float | None, digits: int, factor: float = 1.0) -> str:
        return "-" if value is None else f"{factor * value:.{digits}f}"

    return [
        text(s.mean_rank, 2), f"{s.wins}/{s.groups}", f"{s.holds}/{s.done}", text(s.budget_share, 1, 100.0),
        text(s.felt_error_jnd, 2), text(s.discontinuity_per_s, 3), text(s.memory_mb, 1), str(s.failed),
    ]  # fmt: skip


def ranking_table(rows: Sequence[Row], title: str) -> Table:
    """One line per configuration, medians over its cells."""
    table = Table(
        title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False
    )
    table.add_column("\nconfiguration", no_wrap=True)
    for heading in HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    for standing in standings(rows):
        table.add_row(standing.config, *cells_of(standing))
    return table


def failures(rows: Sequence[Row]) -> list[str]:
    """One line per scan and reason: how many cells failed, and why."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.error is not None and not row.is_done:
            reasons.setdefault((row.scan, row.error), []).append(f"{row.config} with {row.tool}")
    return [
        f"{scan}: {cells[0] if len(cells) == 1 else f'{len(cells)} cells'}: {error}"
        for (scan, error), cells in reasons.items()
    ]


def _median(values: Sequence[float]) -> float | None:
    return float(median(values)) if values else None
