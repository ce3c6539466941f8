"""`hapticlod report`: one self-contained page about a bundle or a comparison."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from hapticlod.errors import InputError
from hapticlod.files import write_atomic
from tuning.commands.outputs import check_writable

_SQLITE = b"SQLite format 3\0"


def report_command(
    source: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    front: Path | None = None,
    quality: Path | None = None,
    scan: Path | None = None,
    unit: str | None = None,
) -> None:
    """Write one HTML page that needs nothing else: no network, no folder beside it.

    Parameters
    ----------
    source
        A bundle (.hlod), or what `hapticlod compare` wrote.
    output
        The page to write (.html).
    front
        For a bundle: what `hapticlod pareto` wrote, to show what other budgets buy.
    quality
        For a bundle: what `make evaluate-surrogate JSON=FILE` wrote, to show how far the model can be trusted.
    scan
        For a bundle: the scan it was made of, for the 3-D view. Without it the view shows the finest level.
    unit
        Unit of that scan. Default: what the file says, else a guess by its size.
    """
    inputs = [path for path in (source, front, quality, scan) if path is not None]
    check_writable(output, inputs)
    from tuning.report import needed

    needed()
    if _is_ledger(source):
        if any(extra is not None for extra in (front, quality, scan)):
            raise InputError("--front, --quality, --scan", "go with a bundle, not with a comparison", "leave them out")
        from tuning.compare.ledger import Ledger
        from tuning.report.compare_report import compare_report

        with Ledger(source, writable=False) as ledger:
            rows, runs = ledger.latest(), ledger.runs()
        if not rows:
            raise InputError(str(source), "holds no cell yet", "run the comparison first")
        text = compare_report(source.stem, rows, runs)
    else:
        from hapticlod.bundle import read_bundle
        from tuning.report.bundle_report import bundle_report

        held = read_bundle(source)
        shown = None
        if scan is not None:
            from hapticlod.scan import load_scan

            shown = load_scan(scan, unit)
        text = bundle_report(held, _document(front, "points"), _document(quality, "metrics"), shown)
    write_atomic(output, text)
    Console(highlight=False).print(f"{output}: {len(text.encode()) / 1e6:.1f} MB", markup=False, soft_wrap=True)


def _is_ledger(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(len(_SQLITE)) == _SQLITE
    except OSError:
        return False  # what is wrong with it is said by the reader of bundles


def _document(path: Path | None, needed: str) -> dict[str, Any] | None:
    if path is None:
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", "check the path") from None
    except ValueError as error:
        raise InputError(str(path), f"is no JSON ({error})", "give the file that the command wrote") from None
    if not isinstance(found, dict) or needed not in found:
        raise InputError(str(path), f"has no {needed!r}", "give the file that the command wrote")
    return found
