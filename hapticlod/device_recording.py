"""Watching and recording a device's positions, without forces: nothing is ever written to it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.device_profile import DeviceProfile
from hapticlod.errors import InputError

_TIMEOUT_MS = 1000
_MOST_BYTES = 1025


@dataclass(frozen=True)
class Sample:
    """One report. `host_s`: when it was read, this machine's monotonic clock. `position_mm`: (3,), world axes."""

    host_s: float
    position_mm: NDArray[np.float64]
    buttons: int


def samples(handle: Any, profile: DeviceProfile, path: str) -> Iterator[Sample]:
    """Reports of an open device as they come.

    Raises:
        InputError: nothing comes for a second, or a report has a length that the profile does not know.
    """
    lengths = {report.bytes + (1 if report.report_id else 0) for report in profile.input}
    while True:
        raw = bytes(handle.read(_MOST_BYTES, _TIMEOUT_MS))
        if not raw:
            raise InputError(path, f"sent nothing for {_TIMEOUT_MS} ms", "move it; check its cable and its profile")
        if len(raw) not in lengths:
            known = " or ".join(map(str, sorted(lengths)))
            raise InputError(path, f"sent a report of {len(raw)} bytes, not {known}", "use the profile of this device")
        position = profile.position_mm(raw)
        if position is not None:
            yield Sample(time.monotonic(), position, _buttons(profile, raw))


def _buttons(profile: DeviceProfile, raw: bytes) -> int:
    for report in profile.input:
        payload = raw[1:] if report.report_id else raw
        if report.fields.buttons is not None and len(payload) == report.bytes:
            return int(report.values(payload, "buttons")[0])
    return 0


def as_csv(recorded: list[Sample]) -> str:
    """Text that `load_motion` reads: time from the first sample, s, and positions, mm."""
    start = recorded[0].host_s
    rows = [f"{s.host_s - start:.6f},{','.join(f'{x:.6g}' for x in s.position_mm)}" for s in recorded]
    # Two reports read at one instant would be two rows of one time, which no motion has.
    kept = [row for i, row in enumerate(rows) if i == 0 or row.split(",")[0] != rows[i - 1].split(",")[0]]
    return "# recorded by hapticlod devices\nt_s,x_mm,y_mm,z_mm\n" + "\n".join(kept) + "\n"
