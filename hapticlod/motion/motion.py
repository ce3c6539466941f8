"""A hand motion: HIP positions at the loop rate, and where they came from."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.files import write_atomic


@dataclass(frozen=True, eq=False)
class Motion:
    """HIP positions at the loop rate.

    Attributes:
        time_s: (T,) from 0, one step per loop period.
        position_mm: (T, 3) HIP in the scan's frame.
        orientation: (T, 4) unit quaternions w x y z, tool frame to scan frame; None: the tool keeps the scan's axes.
        loop_hz: the loop rate.
        name: what reports call it.
        provenance: where it came from and what was done to it; JSON types only.
    """

    time_s: NDArray[np.float64]
    position_mm: NDArray[np.float64]
    orientation: NDArray[np.float64] | None
    loop_hz: float
    name: str
    provenance: dict[str, Any]

    def __post_init__(self) -> None:
        ticks = len(self.time_s)
        if self.position_mm.shape != (ticks, 3) or ticks < 2:
            raise ValueError(f"positions {self.position_mm.shape} do not fit {ticks} ticks, or fewer than 2 ticks")
        if self.orientation is not None and self.orientation.shape != (ticks, 4):
            raise ValueError(f"orientations {self.orientation.shape} do not fit {ticks} ticks")

    @property
    def ticks(self) -> int:
        """Number of ticks, T."""
        return len(self.time_s)

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return self.ticks / self.loop_hz

    @property
    def digest(self) -> str:
        """Content hash, hex: equal for equal positions, orientations and rate, whatever name and provenance."""
        hasher = hashlib.blake2b(repr(float(self.loop_hz)).encode(), digest_size=16)
        for part in (self.time_s, self.position_mm, self.orientation):
            hasher.update(b"-" if part is None else np.ascontiguousarray(part, dtype="<f8").tobytes())
        return hasher.hexdigest()

    def speed_mm_s(self, cutoff_hz: float = 15.0) -> NDArray[np.float64]:
        """(T,) speed after a zero-phase low-pass on position, mm/s: a raw difference shows the encoder's steps."""
        from hapticlod.motion.smooth import low_passed

        smooth = low_passed(self.position_mm, cutoff_hz, self.loop_hz)
        return np.linalg.norm(np.gradient(smooth, 1.0 / self.loop_hz, axis=0), axis=1)

    def part(self, start_s: float, stop_s: float) -> "Motion":
        """The ticks from `start_s` up to `stop_s`; its time starts at 0 again."""
        first, last = (max(round(at * self.loop_hz), 0) for at in (start_s, stop_s))
        time_s = self.time_s[first:last]
        orientation = None if self.orientation is None else self.orientation[first:last]
        provenance = {**self.provenance, "part_s": [start_s, stop_s]}
        shifted = time_s - time_s[0] if len(time_s) else time_s
        return Motion(shifted, self.position_mm[first:last], orientation, self.loop_hz, self.name, provenance)


def save_motion(path: str | Path, motion: Motion) -> None:
    """Writes a motion as CSV that `load_motion` reads back to 1e-9 mm. Raises InputError where it cannot be written."""
    header = ["t_s", "x_mm", "y_mm", "z_mm"]
    columns = [motion.time_s[:, None], motion.position_mm]
    if motion.orientation is not None:
        header += ["qw", "qx", "qy", "qz"]
        columns.append(motion.orientation)
    lines = [f"# {motion.name}, {motion.loop_hz:g} Hz", ",".join(header)]
    lines += [",".join(f"{value:.9f}" for value in row) for row in np.hstack(columns).tolist()]
    write_atomic(path, "\n".join(lines) + "\n")
