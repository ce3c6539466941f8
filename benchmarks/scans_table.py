"""`make scans-table`: every scan of a folder is checked and tuned in a process of its own; one table says what came.

    python -m benchmarks.scans_table [--data FOLDER] [--only NAME ...] [--tool FILE] [--station FILE] [--out FOLDER]

Each scan's row is a file, written when it is done: an interrupted run goes on where it was, and a scan that fails,
hangs or takes all memory leaves a row that says so. Rows are made again where scan, tool, station or this program have
changed (--keep: not for the program). Every tuning starts with an empty cache. Exit status 1 where a scan was neither
tuned nor refused.
"""

import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from benchmarks.measured_process import Taken, run_measured
from benchmarks.scans_table_text import as_csv, as_markdown
from hapticlod.errors import InputError
from hapticlod.files import write_atomic, write_json
from hapticlod.shipped import shipped_config
from tuning.commands.tune import DEFAULT_STATION
from tuning.kept import code_digest

REPOSITORY = Path(__file__).resolve().parent.parent
FOLDERS = ("dirty", "meshes")
TOOL = "tools/ball_1mm.toml"
app = App(name="scans_table")


@app.default
def scans_table_command(
    *,
    data: Path = REPOSITORY.parent / "shared" / "data",
    only: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    tool: Path | None = None,
    station: Path | None = None,
    out: Path = REPOSITORY / "build" / "scans",
    limit_s: float = 7200.0,
    keep: bool = False,
    show: bool = False,
) -> int:
    """Check and tune every scan, smallest first, and write OUT/scans.md and OUT/scans.csv.

    Parameters
    ----------
    data
        The folder that holds dirty/ and meshes/.
    only
        Parts of file names; other scans are passed over.
    tool
        Tool file. Default: a ball of 1 mm.
    station
        Station file. Default: a desktop at 1 kHz.
    out
        Where rows and tables go.
    limit_s
        Longest time for one scan; then it counts as hung.
    keep
        Keep rows that an older version of this program made.
    show
        Make the tables of the rows that are there, and nothing else.
    """
    files = sorted(scans_of(data), key=lambda path: path.stat().st_size)
    files = [path for path in files if not only or any(part in path.name for part in only)]
    held_tool, held_station = tool or shipped_config(TOOL), station or shipped_config(DEFAULT_STATION)
    rows_folder = out / "rows"
    rows_folder.mkdir(parents=True, exist_ok=True)
    setting = hashlib.blake2b(held_tool.read_bytes() + held_station.read_bytes(), digest_size=8).hexdigest()
    rows: list[dict[str, Any]] = []
    for path in files:
        kept = rows_folder / f"{path.name}.{setting}.json"
        row = _row_of(kept, path, None if keep or show else code_digest())
        if row is None and not show:
            print(f"{time.strftime('%H:%M:%S')} {path.name} ...", file=sys.stderr, flush=True)
            row = measured_row(path, held_tool, held_station, limit_s)
            write_json(kept, row)
            print(f"         {row['outcome']} in {row['wall_s']:.0f} s", file=sys.stderr, flush=True)
        if row is not None:
            rows.append(row)
            write_atomic(out / "scans.md", as_markdown(rows))
            write_atomic(out / "scans.csv", as_csv(rows))
    print(as_markdown(rows), end="")
    return int(any(row["outcome"] == "FAILED" for row in rows))


def scans_of(data: Path) -> Iterator[Path]:
    """Every file of dirty/ and meshes/. Raises InputError where they are missing."""
    for name in FOLDERS:
        if not (data / name).is_dir():
            raise InputError(str(data), f"has no folder {name}", "say make scans-table DATA=folder")
        yield from (path for path in (data / name).iterdir() if path.is_file())


def _row_of(kept: Path, scan: Path, code: str | None) -> dict[str, Any] | None:
    """The row that is there already, if it is of this very scan and, unless None, of this code."""
    try:
        row = json.loads(kept.read_text())
    except (OSError, ValueError):
        return None
    fits = row.get("digest") == _digest(scan) and (code is None or row.get("code") == code)
    return row if fits else None


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def measured_row(scan: Path, tool: Path, station: Path, limit_s: float) -> dict[str, Any]:
    """Check and tune one scan.

    `outcome`: tuned, refused (status 2 and one line), or FAILED: anything else, with `message`.
    """
    row: dict[str, Any] = {"scan": scan.name, "bytes": scan.stat().st_size, "digest": _digest(scan)}
    row |= {"code": code_digest(), "outcome": "FAILED", "message": "", "wall_s": 0.0}
    with tempfile.TemporaryDirectory(prefix="hapticlod-scans-") as name:
        folder = Path(name)
        environment = {"HAPTICLOD_CACHE": str(folder / "cache"), "HAPTICLOD_CONFIG": str(folder / "config")}
        program = [sys.executable, "-m", "tuning.cli"]
        checked = run_measured([*program, "check", str(scan), "--json"], limit_s, environment)
        row |= {"check_s": checked.wall_s, "check_mb": checked.peak_mb, "wall_s": checked.wall_s}
        if checked.status != 0:
            return row | _refusal(checked, scan)
        row["check"] = json.loads(checked.out)
        bundle, said = folder / "out.hlod", folder / "out.json"
        command = [*program, "tune", str(scan), "--tool", str(tool), "--station", str(station)]
        tuned = run_measured([*command, "-o", str(bundle), "--json", str(said)], limit_s, environment)
        row |= {"wall_s": tuned.wall_s, "processor_s": tuned.processor_s, "peak_mb": tuned.peak_mb}
        if tuned.status != 0:
            return row | _refusal(tuned, scan)
        looked = run_measured([*program, "inspect", str(bundle)], limit_s, environment)
        if looked.status != 0:
            return row | {"message": f"the bundle cannot be read: {looked.last_line}"}
        row["tuned"] = json.loads(said.read_text())
        return row | {"outcome": "tuned", "bundle_bytes": bundle.stat().st_size}


def _refusal(taken: Taken, scan: Path) -> dict[str, Any]:
    """A status of 2 with a line that names the scan or the station is a refusal; all else is a failure."""
    if taken.status is None:
        return {"outcome": "FAILED", "message": f"stopped after {taken.wall_s:.0f} s"}
    line = taken.last_line.replace(f"{scan.parent}/", "")
    if taken.status == 2 and "; " in line:
        return {"outcome": "refused", "message": line}
    return {"outcome": "FAILED", "message": f"status {taken.status}: {line}"}


if __name__ == "__main__":
    try:
        sys.exit(app(result_action="return_value"))
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted; what is done is kept", file=sys.stderr)
        sys.exit(130)
