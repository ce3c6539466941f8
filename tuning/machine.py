"""What a timing hangs on, beside the program: the machine."""

from __future__ import annotations

import platform
from pathlib import Path

from hapticlod import _runtime


def this_machine() -> dict[str, str]:
    """Processor, kernel of the system, SIMD kernels in use."""
    model = platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return {"processor": model, "kernel": platform.release(), "kernels": _runtime.kernels()}
