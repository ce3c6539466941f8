"""Velocity-driven levels of detail for haptic rendering: scans, ladders, replay and metrics.

Names are imported when they are first used, so that ``import hapticlod`` costs nothing.
The tuner builds on this package and lives in `tuning` (``from tuning import tune``).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapticlod.errors import HapticLODError as HapticLODError
    from hapticlod.errors import InputError as InputError

_HOME = {
    "HapticLODError": "hapticlod.errors",
    "InputError": "hapticlod.errors",
    "LodConfig": "hapticlod.config",
    "Ladder": "hapticlod.ladder",
    "build_ladder": "hapticlod.ladder",
    "make_dentition": "hapticlod.dentition",
    "Motion": "hapticlod.motion",
    "load_motion": "hapticlod.motion",
    "synthesise": "hapticlod.motion",
    "measure": "hapticlod.metrics",
    "Record": "hapticlod.replay",
    "replay": "hapticlod.replay",
    "Scan": "hapticlod.scan",
    "load_scan": "hapticlod.scan",
    "Station": "hapticlod.station",
    "load_station": "hapticlod.station",
    "Tool": "hapticlod.tool",
    "load_tool": "hapticlod.tool",
    "read_bundle": "hapticlod.bundle",
    "write_bundle": "hapticlod.bundle",
}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("hapticlod")
    if name not in _HOME:
        raise AttributeError(f"module 'hapticlod' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
