"""From what the user named to the cells of a comparison. Whatever cannot be is refused before anything is measured."""

from __future__ import annotations

import glob
import hashlib
import os
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import TypeVar

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.motion.strokes import MODES
from hapticlod.scan_unit import named_unit
from hapticlod.scheme import Scheme, load_scheme
from hapticlod.station import load_station
from hapticlod.tool import load_tool
from tuning.compare.cell import TUNED, Cell, MotionSet, ScanFile

STROKES = "strokes"
Named = TypeVar("Named")


def plan_cells(
    scans: Sequence[str],
    configs: Sequence[str],
    tools: Sequence[str],
    stations: Sequence[str],
    motions: Sequence[str],
    *,
    unit: str | None = None,
    seconds: float = 4.0,
    seed: int = 0,
) -> list[Cell]:
    """All combinations, ordered so that cells of one scan, tool and station stand together.

    Args:
        scans, tools, stations: paths and glob patterns.
        configs: the same, of configurations and schemes, and the word "tuned".
        motions: paths and patterns of recordings; names of stroke modes; "strokes": all modes, measured as one motion.
        unit: of the scans; None: found for each. seconds: of each mode of strokes. seed: of strokes and tuning.

    Raises:
        InputError: a pattern that matches nothing, a file that is no such thing, two of one kind with one name.
    """
    if unit is not None:
        named_unit(unit)
    if not 1.0 <= seconds <= 3600.0:
        raise InputError("--seconds", f"{seconds:g} s", "give 1 to 3600")
    files = matching("--scans", scans)
    base = Path(os.path.commonpath([str(path.parent) for path in files]))
    found = [ScanFile(path.relative_to(base).as_posix(), path, unit, _digest(path)) for path in files]
    written = [(path, load_scheme(path)) for path in matching("--configs", [c for c in configs if c != TUNED])]
    named: list[tuple[str, str, Scheme | LodConfig | None]] = [(str(p), c.name or p.stem, c) for p, c in written]
    named += [("the word tuned", TUNED, None)] if TUNED in configs else []
    held = [(str(path), load_tool(path)) for path in matching("--tools", tools)]
    places = [(str(path), load_station(path)) for path in matching("--stations", stations)]
    moved = _motion_sets(motions, seconds, seed)
    _all_different("configurations", [(where, name) for where, name, _ in named])
    _all_different("tools", [(where, tool.name) for where, tool in held])
    _all_different("stations", [(where, station.name) for where, station in places])
    _all_different("motions", [(str(motion.path or "--motions"), motion.name) for motion in moved])
    every = product(found, held, places, moved, named)
    return [Cell(s, name, config, tool, st, m, seed) for s, (_, tool), (_, st), m, (_, name, config) in every]


def matching(option: str, patterns: Iterable[str]) -> list[Path]:
    """Files that the patterns name, each once, in order. Raises InputError where a pattern names none."""
    paths: dict[Path, None] = {}
    for pattern in patterns:
        hits = [pattern] if os.path.isfile(pattern) else sorted(glob.glob(pattern, recursive=True))
        hits = [hit for hit in hits if os.path.isfile(hit)]
        if not hits:
            raise InputError(f"{option} {pattern}", "matches no file", "check folder and pattern")
        paths.update(dict.fromkeys(Path(hit).absolute() for hit in hits))
    return list(paths)


def _motion_sets(motions: Sequence[str], seconds: float, seed: int) -> list[MotionSet]:
    sets = []
    for word in motions:
        if word == STROKES or word in MODES:
            sets.append(MotionSet(word, tuple(m for m in MODES if word in (STROKES, m)), seconds, seed))
        else:
            sets += [MotionSet(p.stem, path=p, digest=_digest(p)) for p in matching("--motions", [word])]
    return sets


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", "check its permissions") from None


def _all_different(kind: str, named: Sequence[tuple[str, str]]) -> None:
    seen: dict[str, str] = {}
    for where, name in named:
        if name in seen:
            what = f"is named {name!r}, as {seen[name]} is: two {kind} with one name cannot be told apart"
            raise InputError(where, what, "give one of them another name")
        seen[name] = where
