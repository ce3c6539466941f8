"""The ledger's cells as a flat table: CSV for everything, Parquet for data frames."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hapticlod.errors import InputError
from hapticlod.files import write_atomic
from hapticlod.metrics import METRIC_KEYS
from tuning.compare.ledger import Row

TEXTS = ("scan", "config", "tool", "station", "motion", "state", "error", "basis", "code", "key", "changed")
COUNTS = ("triangles", "levels", "n_ticks", "n_contact_ticks", "n_switches", "core")
NUMBERS = (*METRIC_KEYS, "budget_us", "load_average", "load_others_cores", "load_stolen_cores")
COLUMNS: tuple[str, ...] = (*TEXTS, *COUNTS, *NUMBERS)
Value = str | int | float | None


def flat(row: Row) -> dict[str, Value]:
    """One cell under `COLUMNS`; None where there is no value."""
    feel, timing = row.feel or {}, row.timing or {}
    load = timing.get("load", {})
    state = "done" if row.is_done else "failed" if row.error is not None else "not timed"
    values: dict[str, Value] = {
        "scan": row.scan, "config": row.config, "tool": row.tool, "station": row.station, "motion": row.motion,
        "state": state, "error": row.error, "basis": timing.get("basis"), "code": row.code, "key": row.key,
        "changed": row.changed, "triangles": feel.get("scan", {}).get("triangles"),
        "levels": len(feel["levels"]) if feel else None, "core": timing.get("core"),
        "budget_us": float(row.about["station"]["budget_us"]), "load_average": load.get("average_before"),
        "load_others_cores": load.get("others_cores"), "load_stolen_cores": load.get("stolen_cores"),
    }  # fmt: skip
    known = {**feel.get("metrics", {}), **timing.get("metrics", {}), **feel.get("counts", {})}
    return {column: values.get(column, known.get(column)) for column in COLUMNS}


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """RFC 4180, UTF-8, one header line; an empty field is no value. Raises InputError where it cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(flat(row) for row in rows)
    write_atomic(path, text.getvalue())


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Columns of strings, int64 and float64. Raises InputError where pyarrow is missing or the file unwritable."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError("--parquet", "pyarrow is not installed", "install hapticlod[report], or use --csv") from None
    types: dict[str, Any] = {column: pyarrow.string() for column in TEXTS}
    types |= {column: pyarrow.int64() for column in COUNTS}
    schema = pyarrow.schema([(column, types.get(column, pyarrow.float64())) for column in COLUMNS])
    table = pyarrow.Table.from_pylist([flat(row) for row in rows], schema=schema)
    held = io.BytesIO()
    pyarrow.parquet.write_table(table, held)
    write_atomic(path, held.getvalue())
