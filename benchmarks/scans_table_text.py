"""Rows of `make scans-table` as Markdown for people and as CSV for programs."""

import csv
import io
from collections.abc import Sequence
from typing import Any

_SHORT = {
    "not_finite_vertices": "NaN vertices",
    "faces_on_not_finite": "faces on NaN",
    "near_vertices": "welded near",
    "degenerate_faces": "flat faces",
    "duplicate_faces": "duplicates",
    "inconsistent_edges": "inconsistent edges",
    "inside_out_components": "inside out",
}
_KEPT = {"boundary_edges": "border edges", "non_manifold_edges": "non-manifold"}
COLUMNS = (
    "scan", "outcome", "triangles_read", "triangles", "unit", "repairs", "kept", "rungs", "coarsest", "area_part",
    "turned_part", "levels", "p999_us", "felt_error_jnd", "discontinuity_per_s", "switches_per_s", "memory_mb",
    "check_s", "tune_s", "processor_s", "peak_mb", "message",
)  # fmt: skip


def plain(row: dict[str, Any]) -> dict[str, Any]:
    """One row by COLUMNS; what there is nothing of is an empty string."""
    cells: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    cells |= {"scan": row["scan"], "outcome": row["outcome"], "message": row["message"]}
    if "check_s" in row:
        cells["check_s"] = round(row["check_s"], 1)
    if checked := row.get("check"):
        report = checked["report"]
        cells |= {"triangles_read": report["triangles_read"], "triangles": report["triangles"], "unit": checked["unit"]}
        mended = {_SHORT[name]: report[name]["fixed"] for name in _SHORT if report[name]["fixed"]}
        if report["turned_faces"]:
            mended["faces turned"] = report["turned_faces"]
        left = {short: report[name]["found"] for name, short in _KEPT.items() if report[name]["found"]}
        if report["components"] > 1:
            left["parts"] = report["components"]
        cells |= {"repairs": _counted(mended), "kept": _counted(left)}
    if "processor_s" in row:
        cells |= {"tune_s": round(row["wall_s"]), "processor_s": round(row["processor_s"])}
        cells["peak_mb"] = round(row["peak_mb"])
    if told := row.get("tuned"):
        rungs, measured = told["ladder"]["rungs"], told["measured"]
        levels = [f"{x['triangles']}" for x in told["levels"]]
        cells |= {
            "rungs": len(rungs),
            "coarsest": rungs[-1]["triangles"],
            "area_part": round(min(rung["area_part"] for rung in rungs), 3),
            "turned_part": round(max(rung["turned_part"] for rung in rungs), 4),
            "levels": f"{len(levels)}: {' > '.join(levels)}",
            "p999_us": _figures(measured["loop_cost_p999_us"]),
            "felt_error_jnd": _figures(measured["felt_error_jnd"]),
            "discontinuity_per_s": _figures(measured["discontinuity_per_s"]),
            "switches_per_s": _figures(measured["switches_per_s"]),
            "memory_mb": _figures(measured["memory_mb"]),
        }
    return cells


def as_csv(rows: Sequence[dict[str, Any]]) -> str:
    """The table with a head line."""
    text = io.StringIO()
    writer: csv.DictWriter[str] = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(plain(row) for row in rows)
    return text.getvalue()


def as_markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Two tables: what was mended and what came of it; what was refused, and why."""
    cells = [plain(row) for row in rows]
    good = [x for x in cells if x["outcome"] == "tuned"]
    bad = [x for x in cells if x["outcome"] != "tuned"]
    mended = _table(
        ("scan", "triangles", "mended", "kept", "check s"),
        [(x["scan"], _changed(x), x["repairs"] or "-", x["kept"] or "-", x["check_s"]) for x in good],
    )
    head = ("scan", "rungs", "coarsest", "area kept", "turned", "levels", "p99.9 us", "felt JND", "jumps 1/s")
    head += ("switches 1/s", "MB", "time s", "CPU s", "peak MB")
    names = ("rungs", "coarsest", "area_part", "turned_part", "levels", "p999_us", "felt_error_jnd")
    names += ("discontinuity_per_s", "switches_per_s", "memory_mb", "tune_s", "processor_s", "peak_mb")
    came = _table(head, [(x["scan"], *(x[name] for name in names)) for x in good])
    refused = _table(
        ("scan", "outcome", "check s", "message"), [(x["scan"], x["outcome"], x["check_s"], x["message"]) for x in bad]
    )
    return "\n".join(part for part in (mended, came, refused) if part)


def _changed(cells: dict[str, Any]) -> str:
    if cells["triangles"] == cells["triangles_read"]:
        return str(cells["triangles"])
    return f"{cells['triangles_read']} to {cells['triangles']}"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    if not rows:
        return ""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell).replace("|", "/") for cell in line) + " |\n" for line in lines)


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _figures(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
