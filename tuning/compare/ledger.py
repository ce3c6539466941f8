"""The ledger: one SQLite file that holds what a comparison has found so far. A committed cell is never lost.

Only the process that started the comparison writes. Every result is one transaction with SQLite's rollback journal and
full syncing: after kill -9 or a power cut the next reader rolls an unfinished one back.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from hapticlod.errors import InputError
from tuning.compare.cell import Cell, measuring_digest

APPLICATION_ID = 0x484C4F44  # "HLOD"
VERSION = 1
_SCHEMA = """
CREATE TABLE cells (
    key TEXT PRIMARY KEY, scan TEXT NOT NULL, config TEXT NOT NULL, tool TEXT NOT NULL, station TEXT NOT NULL,
    motion TEXT NOT NULL, code TEXT NOT NULL, about TEXT NOT NULL, feel TEXT, timing TEXT, error TEXT,
    changed TEXT NOT NULL
);
CREATE TABLE tunings (key TEXT PRIMARY KEY, result TEXT NOT NULL, changed TEXT NOT NULL);
CREATE TABLE runs (started TEXT NOT NULL, about TEXT NOT NULL);
"""


@dataclass(frozen=True)
class Row:
    """A cell as the ledger has it. `feel` and `timing` are what `measuring` gave; None where that is still to come."""

    key: str
    scan: str
    config: str
    tool: str
    station: str
    motion: str
    code: str
    about: dict[str, Any]
    feel: dict[str, Any] | None
    timing: dict[str, Any] | None
    error: str | None
    changed: str

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to measure."""
        return self.feel is not None and self.timing is not None

    @property
    def metrics(self) -> dict[str, float]:
        """All metrics of a cell that is done."""
        assert self.feel is not None and self.timing is not None
        return {**self.feel["metrics"], **self.timing["metrics"]}

    @property
    def group(self) -> tuple[str, str, str, str]:
        """Scan, tool, station, motion: within it configurations are compared."""
        return self.scan, self.tool, self.station, self.motion


class Ledger:
    """An open ledger; use it in a `with` block.

    Raises:
        InputError: not a ledger, a newer one, one that another comparison is writing, a full disk.
    """

    def __init__(self, path: Path, *, writable: bool = True) -> None:
        self.path = path
        self._lock: socket.socket | None = None
        if path.is_dir():
            raise InputError(str(path), "is a folder", "give the name of a file")
        if not path.exists() and not writable:
            raise InputError(str(path), "does not exist", "check the path")
        if not path.resolve().parent.is_dir():
            raise InputError(str(path), f"the folder {path.resolve().parent} does not exist", "create it first")
        if writable:
            self._lock = _locked(path)
        try:
            # Opened for reading too, a ledger that was left in the middle of a commit is rolled back: this writes.
            self._base = sqlite3.connect(path, timeout=30.0, isolation_level=None)
            with self._said():
                self._open(writable)
        except BaseException:
            self.close()
            raise

    def _open(self, writable: bool) -> None:
        def one(what: str) -> Any:
            return self._base.execute(what).fetchone()[0]

        if one("SELECT count(*) FROM sqlite_master") == 0 and one("PRAGMA application_id") == 0 and writable:
            self._base.execute("BEGIN IMMEDIATE")
            for statement in _SCHEMA.split(";"):
                self._base.execute(statement)
            self._base.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            self._base.execute(f"PRAGMA user_version = {VERSION}")
            self._base.execute("COMMIT")
        if one("PRAGMA application_id") != APPLICATION_ID:
            raise InputError(str(self.path), "is no ledger of a comparison", "give another name")
        version = one("PRAGMA user_version")
        if version > VERSION:
            what = f"was written by a newer HapticLOD (ledger version {version}, this program knows {VERSION})"
            raise InputError(str(self.path), what, "update HapticLOD, or give another name")
        self._base.execute("PRAGMA synchronous = FULL")

    def __enter__(self) -> Ledger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Gives the file free."""
        if hasattr(self, "_base"):
            self._base.close()
        if self._lock is not None:
            self._lock.close()

    @contextmanager
    def _said(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            what, remedy = f"cannot be used ({error})", "check that it is a ledger and can be written"
            if "full" in str(error) or "disk I/O" in str(error):
                what = f"cannot be written ({error}); every cell that was finished is kept"
                remedy = "make room and run the same command again"
            raise InputError(str(self.path), what, remedy) from error

    def _write(self, statement: str, values: tuple[Any, ...]) -> None:
        with self._said():
            self._base.execute(statement, values)  # without BEGIN: one statement, one transaction

    def note_run(self, about: dict[str, Any]) -> None:
        """Remembers that a comparison was started, and with what."""
        self._write("INSERT INTO runs VALUES (?, ?)", (_now(), _json(about)))

    def runs(self) -> list[dict[str, Any]]:
        """Every start, oldest first."""
        with self._said():
            found = self._base.execute("SELECT started, about FROM runs ORDER BY rowid").fetchall()
        return [{"started": started, **json.loads(about)} for started, about in found]

    def put_feel(self, cell: Cell, feel: dict[str, Any]) -> None:
        """Commits what a cell feels like."""
        self._put(cell, "feel", _json(feel))

    def put_timing(self, cell: Cell, timing: dict[str, Any]) -> None:
        """Commits what a cell costs."""
        self._put(cell, "timing", _json(timing))

    def put_error(self, cell: Cell, error: str) -> None:
        """Commits why a cell could not be measured; the next run tries again."""
        self._put(cell, "error", error)

    def _put(self, cell: Cell, column: str, value: str) -> None:
        about = {
            "scan": str(cell.scan.path), "unit": cell.scan.unit, "scan_digest": cell.scan.digest,
            "tool": {"balls": cell.tool.balls, "digest": cell.tool.digest},
            "station": cell.station.model_dump(mode="json"),
            "motion": {"modes": cell.motion.modes, "seconds": cell.motion.seconds, "seed": cell.motion.seed,
                       "path": str(cell.motion.path or ""), "digest": cell.motion.digest},
        }  # fmt: skip
        clear = "" if column == "error" else ", error = NULL"
        self._write(
            f"INSERT INTO cells (key, scan, config, tool, station, motion, code, about, changed, {column}) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET "
            f"{column} = excluded.{column}, changed = excluded.changed{clear}",
            (cell.key, *cell.names, measuring_digest(), _json(about), _now(), value),
        )

    def put_tuning(self, key: str, result: dict[str, Any]) -> None:
        """Commits a tuned configuration."""
        self._write("INSERT OR REPLACE INTO tunings VALUES (?, ?, ?)", (key, _json(result), _now()))

    def tunings(self) -> dict[str, dict[str, Any]]:
        """Tuned configurations by key."""
        with self._said():
            found = self._base.execute("SELECT key, result FROM tunings").fetchall()
        return {key: json.loads(result) for key, result in found}

    def rows(self) -> list[Row]:
        """Every cell, in the order of names."""
        names = "key, scan, config, tool, station, motion, code, about, feel, timing, error, changed"
        with self._said():
            found = self._base.execute(f"SELECT {names} FROM cells ORDER BY scan, tool, station, motion, config, rowid")
            rows = found.fetchall()
        return [Row(*row[:7], *map(_unpacked, row[7:10]), *row[10:]) for row in rows]

    def latest(self) -> list[Row]:
        """As `rows`, where a cell was measured again with other inputs or code, only its newest."""
        newest: dict[tuple[str, ...], Row] = {}
        for row in self.rows():
            place = (row.config, *row.group)
            if place not in newest or newest[place].changed <= row.changed:
                newest[place] = row
        return list(newest.values())


def _locked(path: Path) -> socket.socket:
    """Holds the ledger for this process; the kernel gives it free however the process ends, and no file is left."""
    name = hashlib.blake2b(os.fsencode(path.resolve()), digest_size=16).hexdigest()
    held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        held.bind(f"\0hapticlod-ledger-{name}")
    except OSError:
        held.close()
        raise InputError(
            str(path), "another comparison is writing to it", "wait for it, or give another name"
        ) from None
    return held


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")


def _unpacked(text: str | None) -> Any:
    return None if text is None else json.loads(text)


def _json(value: Any) -> str:
    return json.dumps(value, allow_nan=False)
