"""`hapticlod recording`: a station's MCAP recording as CSV, for spreadsheets and for `hapticlod tune --motions`."""

from pathlib import Path
from typing import Any

from rich.console import Console

from hapticlod.files import write_atomic
from hapticlod.motion.recording_mcap import motion_lines, recorded_ticks


def recording_command(recording: Path, /, *, out: Path, motion: bool = False) -> None:
    """Turn a recording of `hapticlod-station run --record` into CSV.

    Parameters
    ----------
    recording
        The MCAP file; also a flight recording.
    out
        The CSV to write: one row per tick, with everything that was recorded.
    motion
        Only the hand's way, as a motion file (hapticlod tune reads the MCAP itself, too).
    """
    if motion:
        lines = motion_lines(recording)
    else:
        rows = [_flat(tick) for tick in recorded_ticks(recording)]
        names = list(rows[0])
        lines = [",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]
    write_atomic(out, "\n".join(lines) + "\n")
    Console(highlight=False).print(f"{out}: {len(lines) - 1} rows")


def _flat(tick: dict[str, Any]) -> dict[str, Any]:
    """{"force_n": {"x": 1}} -> {"force_n_x": 1}; true -> 1."""
    row: dict[str, Any] = {}
    for name, value in tick.items():
        if isinstance(value, dict):
            row.update({f"{name}_{axis}": number for axis, number in value.items()})
        else:
            row[name] = int(value) if isinstance(value, bool) else value
    return row
