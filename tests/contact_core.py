"""Drives the runtime on bare meshes: the thin layer between the contact tests and `hapticlod._runtime`."""

from typing import Any

import numpy as np

from hapticlod import _runtime
from hapticlod.layout import CONFIG_DTYPE, RECORD_DTYPE


def core_config(levels: int = 1, **fields: Any) -> np.ndarray:
    """A configuration scalar with quiet defaults (no damping, friction, blend or limits)."""
    config = np.zeros((), dtype=CONFIG_DTYPE)
    config["version"], config["level_count"], config["mapping"] = 1, levels, 1
    config["loop_hz"], config["budget_us"], config["stiffness_n_mm"] = 1000.0, 1000.0, 1.0
    config["hysteresis"], config["speeds_mm_s"] = 0.1, 1e9
    config["l_in_mm"] = config["l_out_mm"] = config["closest_bound_mm"] = 1.0
    config["balls"] = 4096
    for name, value in fields.items():
        config[name] = value
    return config


def point_or_ball(radius_mm: float) -> np.ndarray:
    """(1, 4) tool of one ball at its reference point."""
    return np.array([[0.0, 0.0, 0.0, radius_mm]])


class Core:
    """Levels, one tool, one configuration. `materials`: per level (n, 3) at its vertices, or None."""

    def __init__(
        self, meshes: list, tool: np.ndarray, cell_mm: float = 1.0, *, materials: list | None = None, **fields: Any
    ) -> None:
        self.levels = [
            _runtime.Level(
                np.ascontiguousarray(v, dtype=np.float32),
                np.ascontiguousarray(f, dtype=np.uint32),
                cell_mm,
                None if made_of is None else np.ascontiguousarray(made_of, dtype=np.float32),
            )
            for (v, f), made_of in zip(meshes, materials or [None] * len(meshes), strict=True)
        ]
        self.config = core_config(len(meshes), **fields)
        self.renderer = _runtime.Renderer(self.levels, self.config.tobytes(), np.ascontiguousarray(tool, np.float64))

    def replay(self, hip_mm: np.ndarray, orientation: np.ndarray | None = None) -> np.ndarray:
        """(T,) records of a path at the configuration's rate."""
        time_s = np.arange(len(hip_mm)) / float(self.config["loop_hz"])
        raw = self.renderer.replay(time_s, np.ascontiguousarray(hip_mm, dtype=np.float64), orientation, 1)
        return np.frombuffer(raw, dtype=RECORD_DTYPE)

    def tick(self, time_s: float, hip_mm: np.ndarray, orientation: np.ndarray | None = None) -> np.void:
        """One record."""
        raw = self.renderer.tick(time_s, np.asarray(hip_mm, dtype=np.float64), orientation)
        return np.frombuffer(raw, dtype=RECORD_DTYPE)[0]
