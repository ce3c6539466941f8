"""From opening a bundle to its first tick: cold, warm, known. The goal is 50 ms warm for 2.6 million triangles.

Without a bundle: a closed, bumpy torus of so many triangles, one level, signed by nobody. Times on a shared machine say
more about the others than about this: look at `least_processor_ms`, too.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from hapticlod import _runtime
from hapticlod.bundle import write_bundle
from hapticlod.config import Level, LodConfig
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station, load_tool

TRIANGLES = 2_600_000
PROGRAM = Path(__file__).resolve().parent.parent / "build" / "release" / "bench" / "open_bundle"


def torus(triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """About so many triangles: (n, 3) float32 vertices in mm, (m, 3) uint32 faces."""
    side = round((triangles / 2) ** 0.5)
    angle = 2 * np.pi * np.arange(side) / side
    a, b = np.meshgrid(angle, angle, indexing="ij")
    tube = 10 + 0.3 * np.sin(40 * a) * np.sin(30 * b)
    ring = 25 + tube * np.cos(b)
    vertices = np.stack([ring * np.cos(a), ring * np.sin(a), tube * np.sin(b)], axis=-1).reshape(-1, 3)
    at = np.arange(side * side, dtype=np.uint32).reshape(side, side)
    right, up = np.roll(at, -1, axis=0), np.roll(at, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = np.stack([at, right, both, at, both, up], axis=-1).reshape(-1, 3)
    return vertices.astype(np.float32), faces


def make_bundle(path: Path, triangles: int) -> None:
    """One level, a ball of 1 mm."""
    vertices, faces = torus(triangles)
    edges = np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1)
    level = _runtime.Level(vertices, faces, 4.0 * float(edges.mean()))
    tool = load_tool(shipped_config("tools/ball_1mm.toml"))
    config = LodConfig(
        levels=(Level(triangles=level.triangles, cell_mm=level.cell_mm, balls=tool.balls),), speeds_mm_s=()
    )
    station = load_station(shipped_config("stations/desktop_1khz.toml"))
    scalar = config.to_runtime(station, tool, np.zeros(3))
    write_bundle(path, levels=[level], config=scalar, tool=tool, manifest={"scan": {"name": "torus"}})


def main() -> None:
    """Prints one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bundle", type=Path, help="a bundle of yours; default: a generated one")
    parser.add_argument("--triangles", type=int, default=TRIANGLES, help="of the generated one")
    parser.add_argument("--runs", type=int, default=5, help="of each way")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bundle = options.bundle or Path(folder) / "torus.hlod"
        if not options.bundle:
            make_bundle(bundle, options.triangles)
        print(f"{bundle.stat().st_size / 1e6:.0f} MB, {options.runs} runs each, ms")
        said = subprocess.run([PROGRAM, bundle, str(options.runs)], stdout=subprocess.PIPE, text=True, check=False)
    if said.returncode:
        sys.exit(said.returncode)
    columns = ("least_ms", "median_ms", "open_ms", "renderer_ms", "first_tick_ms", "least_processor_ms", "page_faults")
    print(f"{'':>18} " + " ".join(f"{name:>18}" for name in columns))
    for line in said.stdout.splitlines():
        row = json.loads(line)
        print(f"{row['way']:>18} " + " ".join(f"{row[name]:>18}" for name in columns))


if __name__ == "__main__":
    main()
