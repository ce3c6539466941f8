"""Recorded motions: CSV or TSV with a header, at any rate, resampled to the loop rate.

    # comments may stand anywhere
    seg,t_s,x_mm,y_mm,z_mm
    0,0.000,12.1,-3.0,5.5

`seg` splits the file into motions; a missing `z_mm` means a planar motion; `qw,qx,qy,qz` are optional. A file named
`*.mcap` is a recording of the station.
"""

import hashlib
import math
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from hapticlod.errors import InputError
from hapticlod.motion.motion import Motion
from hapticlod.motion.recording_mcap import motion_lines

FEWEST_ROWS = 4
MOST_TICKS = 50_000_000
_REQUIRED = ("t_s", "x_mm", "y_mm")
_QUATERNION = ("qw", "qx", "qy", "qz")
_HEADER = "t_s,x_mm,y_mm,z_mm"

Array = NDArray[np.float64]


def load_motion(path: str | Path, loop_hz: float, *, time_scale: float = 1.0) -> list[Motion]:
    """Reads the motions of a file, resampled to `loop_hz` by monotone cubics (PCHIP: no overshoot).

    Args:
        path: CSV, TSV where the header has tabs, or a station's recording (.mcap). Time in s, places in mm.
        loop_hz: the loop rate, Hz.
        time_scale: above 1 slows the hand down; said in the provenance.

    Returns:
        One motion per segment, in file order; one motion where there is no `seg` column.

    Raises:
        InputError: no header, a column missing, not a number, not finite, time that does not advance, fewer than 4
            rows in a segment; names file and line.
    """
    path = Path(path)
    if not (loop_hz > 0 and math.isfinite(loop_hz)):
        raise InputError("loop_hz", f"{loop_hz} is no rate", "give a positive number of Hz")
    if not (time_scale > 0 and math.isfinite(time_scale)):
        raise InputError("time_scale", f"{time_scale} is no factor", "give a positive number")
    try:
        content = path.read_bytes()
    except OSError as error:
        reason = "is a folder" if path.is_dir() else (error.strerror or str(error))
        raise InputError(str(path), reason, "give the path of a motion CSV") from None
    try:
        mcap = path.suffix.lower() == ".mcap"
        lines = motion_lines(path) if mcap else content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"not text (byte {error.start})", "give a CSV file") from None
    names, rows = _rows(lines, str(path))
    comments = [line.lstrip("# ").strip() for line in lines if line.startswith("#")][:5]
    common = {
        "kind": "recorded",
        "file": path.name,
        "file_digest": hashlib.blake2b(content, digest_size=16).hexdigest(),
        "comments": comments,
        "planar": "z_mm" not in names,
        "ignored_columns": [name for name in names if name not in (*_REQUIRED, "z_mm", "seg", *_QUATERNION)],
        "time_scale": time_scale,
    }
    motions: list[Motion] = []
    for label, group in groupby(rows, key=lambda row: row[1]):
        motions.append(_motion(list(group), names, label, common, loop_hz, time_scale, path))
    return motions


def _rows(lines: list[str], file: str) -> tuple[list[str], list[tuple[int, str, list[float]]]]:
    """Column names and (line number, segment, numbers by column) per row."""
    names: list[str] = []
    delimiter = ","
    rows: list[tuple[int, str, list[float]]] = []
    seg = -1
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        if not names:
            delimiter = "\t" if "\t" in line else ","
            names = _header([cell.strip().strip('"') for cell in line.split(delimiter)], f"{file}:{number}")
            seg = names.index("seg") if "seg" in names else -1
            used = [at for at, name in enumerate(names) if name in (*_REQUIRED, "z_mm", *_QUATERNION)]
            continue
        cells = line.split(delimiter)
        if len(cells) != len(names):
            what = f"{len(cells)} values under {len(names)} columns"
            raise InputError(f"{file}:{number}", what, "give every row all columns of the header")
        values = [0.0] * len(names)
        for at in used:
            try:
                values[at] = float(cells[at])
            except ValueError:
                what = f"{names[at]} is {cells[at].strip()!r}, not a number"
                raise InputError(f"{file}:{number}", what, "mend or drop this row") from None
            if not math.isfinite(values[at]):
                raise InputError(f"{file}:{number}", f"{names[at]} is not finite", "mend or drop this row")
        rows.append((number, cells[seg].strip() if seg >= 0 else "", values))
    if not names:
        raise InputError(file, "is empty", f"give a CSV whose first line is {_HEADER}")
    if not rows:
        raise InputError(file, "holds a header and no rows", f"give at least {FEWEST_ROWS} rows")
    return names, rows


def _header(names: list[str], where: str) -> list[str]:
    if any(_is_number(name) for name in names):
        raise InputError(where, "numbers where the header should be", f"put the line {_HEADER} on top")
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        what = f"the header lacks {', '.join(missing)} (it has {', '.join(names)[:120]})"
        raise InputError(where, what, f"name the columns {_HEADER}, in s and mm")
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise InputError(where, f"the header names {doubled[0]} twice", "give every column its own name")
    given = [name for name in _QUATERNION if name in names]
    if given and len(given) < 4:
        raise InputError(where, f"of the orientation only {', '.join(given)} is given", "give qw,qx,qy,qz or none")
    return names


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _motion(
    rows: list[tuple[int, str, list[float]]],
    names: list[str],
    label: str,
    common: dict[str, Any],
    loop_hz: float,
    time_scale: float,
    path: Path,
) -> Motion:
    first = rows[0][0]
    segment = f" in segment {label}" if label else ""
    if len(rows) < FEWEST_ROWS:
        raise InputError(f"{path}:{first}", f"only {len(rows)} rows{segment}", f"give at least {FEWEST_ROWS}")
    table = np.array([values for _, _, values in rows])
    time_s = table[:, names.index("t_s")]
    steps = np.diff(time_s)
    if (steps <= 0).any():
        at = int(np.argmax(steps <= 0)) + 1
        what = f"t_s goes from {time_s[at - 1]:g} to {time_s[at]:g}: time does not advance{segment}"
        raise InputError(f"{path}:{rows[at][0]}", what, "sort the rows by time and drop repeated times")
    time_s = (time_s - time_s[0]) * time_scale
    ticks = int(np.floor(time_s[-1] * loop_hz + 1e-6)) + 1
    if not 2 <= ticks <= MOST_TICKS:
        what = f"{time_s[-1]:g} s{segment} make {ticks} ticks at {loop_hz:g} Hz"
        raise InputError(f"{path}:{first}", what, f"give at least two loop periods and at most {MOST_TICKS} ticks")
    at_s = np.arange(ticks) / loop_hz
    zero = np.zeros(len(rows))
    places = [table[:, names.index(name)] if name in names else zero for name in ("x_mm", "y_mm", "z_mm")]
    position = _resampled(time_s, np.stack(places, axis=1), at_s)
    orientation = None
    if "qw" in names:
        quaternions = _continuous(table[:, [names.index(name) for name in _QUATERNION]], rows, path)
        orientation = _resampled(time_s, quaternions, at_s)
        orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    provenance = {
        **common,
        "segment": label,
        "rows": len(rows),
        "source_hz": round(float(1.0 / np.median(steps)), 6),
        "longest_gap_s": round(float(steps.max()), 6),
    }
    name = f"{path.stem}:{label}" if label else path.stem
    return Motion(at_s, position, orientation, float(loop_hz), name, provenance)


def _resampled(time_s: Array, values: Array, at_s: Array) -> Array:
    return np.asarray(PchipInterpolator(time_s, values, axis=0)(np.minimum(at_s, time_s[-1])))


def _continuous(quaternions: Array, rows: list[tuple[int, str, list[float]]], path: Path) -> Array:
    """Unit quaternions with neighbouring signs alike."""
    norms = np.linalg.norm(quaternions, axis=1)
    if ((norms < 0.9) | (norms > 1.1)).any():
        at = int(np.argmax((norms < 0.9) | (norms > 1.1)))
        raise InputError(f"{path}:{rows[at][0]}", f"a quaternion of length {norms[at]:.3g}", "give unit quaternions")
    unit = quaternions / norms[:, None]
    signs = np.where(np.einsum("ij,ij->i", unit[1:], unit[:-1]) < 0, -1.0, 1.0)
    unit[1:] *= np.cumprod(signs)[:, None]
    return unit
