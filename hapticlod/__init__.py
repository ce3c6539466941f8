"""Velocity-driven levels of detail for haptic rendering: scans, ladders, motions, replay, metrics, bundles.

Names are imported when they are first used, so that `import hapticlod` costs nothing.
The tuner builds on this package and lives in `tuning`; `hapticlod.tune` is its front door.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from hapticlod.bundle import read_bundle, write_bundle
    from hapticlod.config import LodConfig, load_config, save_config
    from hapticlod.dentition import make_dentition
    from hapticlod.errors import HapticLODError, InputError
    from hapticlod.ladder import Ladder, build_ladder
    from hapticlod.material_map import load_materials
    from hapticlod.metrics import measure
    from hapticlod.motion import Motion, load_motion, synthesise
    from hapticlod.replay import Record, replay
    from hapticlod.scan import Scan, load_scan, scan_from_arrays
    from hapticlod.scheme import Scheme, load_scheme
    from hapticlod.station import Station, load_station
    from hapticlod.tool import Tool, load_tool

    __version__: str
    tune: Callable[..., Any]

__all__ = [
    "HapticLODError",
    "InputError",
    "Ladder",
    "LodConfig",
    "Motion",
    "Record",
    "Scan",
    "Scheme",
    "Station",
    "Tool",
    "__version__",
    "build_ladder",
    "load_config",
    "load_materials",
    "load_motion",
    "load_scan",
    "load_scheme",
    "load_station",
    "load_tool",
    "make_dentition",
    "measure",
    "read_bundle",
    "replay",
    "save_config",
    "scan_from_arrays",
    "synthesise",
    "tune",
    "write_bundle",
]

_HOME = {
    "bundle": ("read_bundle", "write_bundle"),
    "config": ("LodConfig", "load_config", "save_config"),
    "dentition": ("make_dentition",),
    "errors": ("HapticLODError", "InputError"),
    "ladder": ("Ladder", "build_ladder"),
    "material_map": ("load_materials",),
    "metrics": ("measure",),
    "motion": ("Motion", "load_motion", "synthesise"),
    "replay": ("Record", "replay"),
    "scan": ("Scan", "load_scan", "scan_from_arrays"),
    "scheme": ("Scheme", "load_scheme"),
    "station": ("Station", "load_station"),
    "tool": ("Tool", "load_tool"),
}
_MODULE_OF = {name: f"hapticlod.{module}" for module, names in _HOME.items() for name in names}
# The one name from beyond this package, found when it is asked for: the model imports nothing of the tuner.
_MODULE_OF["tune"] = "tuning.tune"


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value = version("hapticlod")
    elif name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module 'hapticlod' has no attribute {name!r}")
    globals()[name] = value
    return value


class _Package(ModuleType):
    """`hapticlod.replay` is the function, also after the module of that name was imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "replay" and isinstance(value, ModuleType):
            value = value.replay
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
