"""How busy the machine was while something was timed."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Mapping, Sequence
from pathlib import Path


class LoadMeter:
    """From its making to `read`."""

    def __init__(self) -> None:
        self._wall_s, self._own_s = time.monotonic(), time.process_time()
        self._busy_s, self._stolen_s = _busy()
        self._interrupted = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw
        self._average = os.getloadavg()[0]

    def read(self) -> dict[str, float]:
        """Load averages before and after; cores that other programs kept busy; times this process had to wait.

        `stolen_cores` is what the host of a virtual machine took away.
        """
        wall_s = max(time.monotonic() - self._wall_s, 1e-9)
        busy_s, stolen_s = _busy()
        own_s = time.process_time() - self._own_s
        interrupted = resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw - self._interrupted
        return {
            "average_before": round(self._average, 2),
            "average_after": round(os.getloadavg()[0], 2),
            "others_cores": round(max(busy_s - self._busy_s - own_s, 0.0) / wall_s, 3),
            "stolen_cores": round(max(stolen_s - self._stolen_s, 0.0) / wall_s, 3),
            "interruptions": float(interrupted),
            "own_share": round(own_s / wall_s, 3),
        }


def mean_load(readings: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """What several readings come to: the mean of each figure, in the meter's digits; empty where there is none."""
    keys = readings[0] if readings else ()
    return {key: round(sum(reading[key] for reading in readings) / len(readings), 3) for key in keys}


def load_in_words(reading: Mapping[str, object]) -> str:
    """A reading as a user reads it; of one that lacks figures, what it has."""
    words = {
        "average_before": "load average {:.2f} before", "average_after": "{:.2f} after",
        "others_cores": "{:.2f} cores busy with other programs", "stolen_cores": "{:.2f} taken by the host",
        "interruptions": "{:.0f} interruptions", "own_share": "{:.2f} cores its own",
    }  # fmt: skip
    told = [text.format(reading[key]) for key, text in words.items() if isinstance(reading.get(key), int | float)]
    return ", ".join(told) or "not recorded"


def _busy() -> tuple[float, float]:
    """Seconds that all cores were busy since start, and seconds stolen by the host."""
    tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
    try:
        fields = [int(field) for field in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    except (OSError, ValueError):
        return 0.0, 0.0
    user, nice, system, _idle, _wait, irq, soft, stolen = fields[:8]
    return (user + nice + system + irq + soft) * tick_s, stolen * tick_s
