"""The closing table of `hapticlod tune`: measured numbers of the tuned configuration beside what it has to beat."""

from collections.abc import Mapping
from dataclasses import dataclass

from rich import box
from rich.table import Table


@dataclass(frozen=True)
class Column:
    """One metric as users read it: its key (as in JSON), name, broken heading and number format."""

    key: str
    name: str
    heading: str
    digits: int

    def text(self, metrics: Mapping[str, float]) -> str:
        return f"{metrics[self.key]:.{self.digits}f}"


COLUMNS = (
    Column("loop_cost_p999_us", "loop cost p99.9 us", "loop cost\np99.9 us", 1),
    Column("felt_error_jnd", "felt error JND", "felt error\nJND", 2),
    Column("discontinuity_per_s", "discontinuity 1/s", "disconti-\nnuity 1/s", 3),
    Column("switches_per_s", "switches 1/s", "switches\n1/s", 2),
    Column("memory_mb", "memory MB", "memory\nMB", 1),
)


def comparison_table(measured: Mapping[str, Mapping[str, float]], feasible: Mapping[str, bool], title: str) -> Table:
    """A table with one row per configuration.

    Args:
        measured: metrics by name of the configuration, in row order.
        feasible: by the same names, whether budget and memory hold.
        title: says under which conditions it was measured.
    """
    table = Table(title=title, title_justify="left", title_style="", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for column in COLUMNS:
        table.add_column(column.heading, justify="right", no_wrap=True)
    table.add_column("feasible", no_wrap=True)
    for name, metrics in measured.items():
        cells = [column.text(metrics) for column in COLUMNS]
        table.add_row(name, *cells, "yes" if feasible[name] else "no")
    return table
