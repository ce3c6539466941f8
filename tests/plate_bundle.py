"""A small bundle for the bundle and station tests: a wavy plate in two levels, a tool of three balls, 1 kHz."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapticlod import _runtime
from hapticlod.layout import CONFIG_DTYPE, RECORD_DTYPE
from hapticlod.motion import Motion
from hapticlod.signature import Key
from hapticlod.tool import Tool, union

ORIGIN_MM = (0.0, 0.0, 20.0)
CELLS_MM = (1.5, 3.0)
TEST_KEY = Key("tests", bytes(range(32)))
"""Signs every bundle of `plate_parts`; the stations of the tests trust it (conftest.py)."""


def plate(squares: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float32 and faces (m, 3) uint32 of a 10 x 10 mm plate around the origin, facing +z."""
    at = np.linspace(-5.0, 5.0, squares + 1)
    y, x = np.meshgrid(at, at, indexing="ij")
    z = 0.1 * np.sin(x) * np.cos(y)
    corner = (np.arange(squares)[:, None] * (squares + 1) + np.arange(squares)).ravel()
    a, b, c, d = corner, corner + 1, corner + squares + 1, corner + squares + 2
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    return np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32), faces.astype(np.uint32)


def plate_config(levels: list[Any]) -> Any:
    """Two levels, two-sided mapping, blend."""
    config: Any = np.zeros((), dtype=CONFIG_DTYPE)
    config["version"], config["level_count"], config["mapping"] = 1, len(levels), 1
    config["origin_mm"] = ORIGIN_MM
    config["loop_hz"], config["budget_us"], config["stiffness_n_mm"], config["max_force_n"] = 1000.0, 800.0, 1.0, 4.0
    config["filter_hz"], config["hysteresis"], config["blend_s"] = 30.0, 0.1, 0.02
    config["l_in_mm"] = config["l_out_mm"] = config["closest_bound_mm"] = 0.5
    config["speeds_mm_s"][0] = 20.0
    for number, level in enumerate(levels):
        config["cell_mm"][number], config["triangles"][number] = level.cell_mm, level.triangles
        config["balls"][number] = 3 - 2 * number
    return config[()]


def plate_motion(ticks: int = 1500) -> Motion:
    """Comes down, slides slowly, then fast; turns about the vertical."""
    t = np.arange(ticks) / 1000.0
    x = 2.0 * np.sin(2.0 * t) + 6.0 * np.sin(15.0 * t) * np.clip(t - 0.3, 0.0, 0.5)
    z = 20.0 + 0.3 + 0.4 * np.cos(np.minimum(20.0 * t, np.pi))
    half = 0.25 * t
    orientation = np.stack([np.cos(half), 0 * t, 0 * t, np.sin(half)], 1)
    return Motion(t, np.stack([x, 0.7 + 0 * t, z], 1), orientation, 1000.0, "slide", {"kind": "test"})


def plate_tool() -> Tool:
    """Three balls in a row along the plate."""
    return union([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [-1.0, 0.0, 0.1]], [0.3, 0.3, 0.3], "three balls")


def plate_parts(ticks: int = 1500) -> dict[str, Any]:
    """Arguments of `write_bundle`."""
    levels = [_runtime.Level(*plate(squares), cell_mm) for squares, cell_mm in zip((6, 3), CELLS_MM, strict=True)]
    config, tool, motion = plate_config(levels), plate_tool(), plate_motion(ticks)
    manifest = {"tool": {"name": tool.name}, "golden_motion": {"name": "slide", "kind": "test"}, "scan": "plate é"}
    return {
        "levels": levels,
        "config": config,
        "tool": tool,
        "manifest": manifest,
        "golden_motion": motion,
        "golden_record": rendered(levels, config, tool, motion),
        "key": TEST_KEY,
    }


def rendered(levels: list[Any], config: Any, tool: Tool, motion: Motion) -> np.ndarray:
    """(T,) rows of the motion's replay in the runtime."""
    renderer = _runtime.Renderer(levels, config.tobytes(), tool.rows)
    raw = renderer.replay(motion.time_s, motion.position_mm, motion.orientation, 1)
    return np.frombuffer(raw, dtype=RECORD_DTYPE)


def station_program() -> Path:
    """The built hapticlod-station: $HAPTICLOD_STATION, beside this Python, or in the build tree. Skips without one."""
    if chosen := os.environ.get("HAPTICLOD_STATION"):
        return Path(chosen)
    for folder in (Path(sys.executable).parent, Path(__file__).resolve().parent.parent / "build" / "release"):
        if (folder / "hapticlod-station").is_file():
            return folder / "hapticlod-station"
    pytest.skip("hapticlod-station is not built: run make build")


def run_station(*words: object, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Runs the station with these words."""
    command = [str(station_program()), *(str(word) for word in words)]
    # No terminal, whose keys would be emergency stops; flight recordings of starved runs not into the user's home.
    environment = {**os.environ, "XDG_STATE_HOME": tempfile.gettempdir()}
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        stdin=subprocess.DEVNULL,
        env=environment,
    )
