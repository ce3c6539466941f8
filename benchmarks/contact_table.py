"""`make bench`: what one tick costs at one fixed level, as a table.

A sphere of 100 mm, slid over at a depth of 0.5-1 mm.

    python benchmarks/contact_table.py [FOLDER]      (default build/bench; meshes and motions there are reused)

Uses the benchmark program contact_replay, which has no levels of detail: the contact solver alone.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

from hapticlod.shipped import shipped_config
from hapticlod.tool import Tool, ball, load_tool

REPOSITORY = Path(__file__).resolve().parent.parent
PROGRAM = REPOSITORY / "build/release/bench/contact_replay"
SPHERE_RADIUS_MM = 50.0
SUBDIVISIONS = (5, 7, 8)  # of an icosahedron: 20 k, 328 k, 1.3 M triangles
SPEEDS_MM_S = (30.0, 200.0, 500.0)
TICKS = 4_000
PERIOD_S = 1e-3


def sphere_file(folder: Path, subdivisions: int) -> Path:
    path = folder / f"sphere_{subdivisions}.stl"
    if not path.exists():
        trimesh.creation.icosphere(subdivisions=subdivisions, radius=SPHERE_RADIUS_MM).export(path)
    return path


def motion_file(folder: Path, speed_mm_s: float, radius_mm: float) -> Path:
    """A spiral over the sphere: free space for 0.1 s, then contact; the ball's centre is lifted by its radius."""
    path = folder / f"motion_r{radius_mm:g}_{speed_mm_s:g}.csv"
    time_s = np.arange(TICKS) * PERIOD_S
    depth_mm = np.minimum(-2.0 + 20.0 * time_s, 0.75 + 0.25 * np.sin(4.0 * np.pi * time_s))
    angle = speed_mm_s * time_s / SPHERE_RADIUS_MM
    tilt = 0.13 * angle + 0.3
    outward = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)])
    place = outward * (SPHERE_RADIUS_MM + radius_mm - depth_mm)[:, None]
    np.savetxt(path, place, fmt="%.6f", delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    return path


def tool_file(folder: Path, tool: Tool) -> Path:
    path = folder / f"{tool.name}.csv"
    np.savetxt(path, tool.rows, fmt="%.6f", delimiter=",", header="x_mm,y_mm,z_mm,radius_mm", comments="")
    return path


def measure(folder: Path, mesh: Path, tool: Tool) -> dict:
    pairs = [(motion_file(folder, speed, tool.reference_radius_mm), folder / "record.csv") for speed in SPEEDS_MM_S]
    files = [path for pair in pairs for path in pair]
    command = [PROGRAM, mesh, *files, "--tool", tool_file(folder, tool), "--repeat", "3"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/bench")
    folder.mkdir(parents=True, exist_ok=True)
    tools = [ball(0.0, "point"), ball(0.5), ball(1.0), ball(3.0), load_tool(shipped_config("tools/burr_flame.toml"))]
    table = Table(title="us per tick, p50 / p99.9 (least of 3 repeats per tick)", title_justify="left", title_style="")
    for heading in ("triangles", "tool", "balls", *(f"{speed:g} mm/s" for speed in SPEEDS_MM_S), "build ms", "B/tri"):
        table.add_column(heading, justify="right", no_wrap=True)
    for subdivisions in SUBDIVISIONS:
        mesh = sphere_file(folder, subdivisions)
        for tool in tools:
            got = measure(folder, mesh, tool)
            costs = [f"{run['p50'] * 1e-3:.2f} / {run['p999'] * 1e-3:.2f}" for run in got["runs"]]
            size = f"{got['level_bytes_per_triangle']:.0f}"
            table.add_row(f"{got['tris']}", tool.name, f"{tool.balls}", *costs, f"{got['build_ms']:.0f}", size)
        table.add_section()
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
