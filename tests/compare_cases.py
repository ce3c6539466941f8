"""Small comparisons: a globe, two schemes, one second of tracing."""

import struct
from pathlib import Path

import numpy as np
from contact_shapes import sphere

from tuning.compare.cell import Cell
from tuning.compare.plan import plan_cells

POLICIES = Path(__file__).parents[1] / "configs" / "policies"
TOOLS = Path(__file__).parents[1] / "configs" / "tools"
STATIONS = Path(__file__).parents[1] / "configs" / "stations"


def write_globe(path: Path, radius_mm: float = 10.0, fineness: int = 3) -> Path:
    """A sphere as binary STL."""
    vertices, faces = sphere(radius_mm, fineness)
    corners = vertices[faces].astype("<f4")
    rows = b"".join(struct.pack("<3f", 0, 0, 0) + corner.tobytes() + b"\0\0" for corner in corners)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(corners)) + rows)
    return path


def words(folder: Path, *names: str) -> list[str]:
    """What a small comparison is asked with, on the command line."""
    scans = [str(folder / name) for name in names]
    configs = [str(POLICIES / f"{name}.toml") for name in ("fixed_finest", "velocity_ours")]
    return ["--scans", *scans, "--configs", *configs, "--motions", "trace", "--seconds", "1"]


def cells(folder: Path, *names: str, configs: tuple[str, ...] = ("fixed_finest", "velocity_ours")) -> list[Cell]:
    """The same as cells."""
    return plan_cells(
        [str(folder / name) for name in names],
        [str(POLICIES / f"{name}.toml") for name in configs],
        [str(TOOLS / "point.toml")],
        [str(STATIONS / "desktop_1khz.toml")],
        ["trace"],
        seconds=1.0,
    )


def same_numbers(a: dict, b: dict) -> bool:
    """Whether two results of feel agree in everything."""
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a)
