"""`make bench`: what one tick costs at one fixed level, against goals and against CHAI3D, as a table.

    python -m benchmarks.contact_table [--quick] [--folder FOLDER]

A sphere of 100 mm with 2.6 M triangles (--quick: 100 k), slid over 0.5 to 1 mm deep for 10 s at 1 kHz by the program
contact_replay, which has no levels of detail: the contact solver alone. A tick's time is its least of the repeats.
Goals are for 2.6 M. CHAI3D: 3.3.0's finger-proxy algorithm on the same spheres and motions on a two-core EPYC, its full
solve for radii above 0. Compare ratios, not times, where the machine is another.
"""

import argparse
import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import contact_cases as cases

REPOSITORY = Path(__file__).resolve().parent.parent
PROGRAM = REPOSITORY / "build/release/bench/contact_replay"
BURR_BALLS = 500
CHAI3D = {
    2_600_000: {"p50": 2.4, "p99.9": 12.0, "r = 1": 208.0, "r = 3": 1051.0, "cold": 20.0, "bytes": 370.0, "build": 2.2},
    101_870: {"p50": 0.81, "p99.9": 4.7, "r = 1": 18.0, "r = 3": 60.0},
}


@dataclass(frozen=True)
class Row:
    """One line: measured against goal, and CHAI3D's figure where there is one, all in the same unit."""

    case: str
    figure: str
    unit: str
    goal: float
    measured: float
    chai3d: float | None = None

    def cells(self) -> list[str]:
        ratio = "" if self.chai3d is None else f"{self.chai3d / self.measured:.1f}"
        verdict = "reached" if self.measured <= self.goal else f"missed x {self.measured / self.goal:.2f}"
        theirs = "" if self.chai3d is None else f"{self.chai3d:.4g}"
        return [
            self.case,
            f"{self.figure}, {self.unit}",
            f"{self.goal:.4g}",
            f"{self.measured:.4g}",
            verdict,
            theirs,
            ratio,
        ]


def replay(mesh: Path, motion: Path, *options: object) -> tuple[dict, np.ndarray]:
    """contact_replay's summary with the only run's figures in it, and its rows (T, 8)."""
    out = motion.parent / "record.csv"
    command = [PROGRAM, mesh, motion, out, "--stiffness", "1", *options]
    done = subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True)
    summary = json.loads(done.stdout.splitlines()[-1])
    return summary | summary["runs"][0], np.loadtxt(out, delimiter=",", skiprows=1)


def sphere_rows(folder: Path, mesh: Path, ticks: int, theirs: dict[str, float]) -> list[Row]:
    point, _ = replay(mesh, cases.motion_on_sphere(folder, 200.0, 0.0, ticks), "--repeat", 5)
    one, _ = replay(mesh, cases.motion_on_sphere(folder, 80.0, 1.0, ticks), "--radius", 1, "--repeat", 3)
    three, _ = replay(mesh, cases.motion_on_sphere(folder, 80.0, 3.0, ticks), "--radius", 3, "--repeat", 3)
    cold, _ = replay(mesh, cases.motion_on_sphere(folder, 200.0, 0.0, 600), "--repeat", 3, "--cold", 48)
    return [
        Row("point, 200 mm/s", "p50", "us", 0.5, point["p50"] / 1e3, theirs["p50"]),
        Row("point, 200 mm/s", "p99.9", "us", 1.5, point["p999"] / 1e3, theirs["p99.9"]),
        Row("ball 1 mm, 80 mm/s", "mean", "us", 4.0, one["mean"] / 1e3, theirs["r = 1"]),
        Row("ball 3 mm, 80 mm/s", "mean", "us", 10.0, three["mean"] / 1e3, theirs["r = 3"]),
        Row("ball 3 mm, 80 mm/s", "p99.9", "us", 30.0, three["p999"] / 1e3),
        Row("point, 48 MB swept", "p50", "us", 3.0, cold["p50"] / 1e3, theirs.get("cold")),
        Row(
            "memory of one level",
            "per triangle",
            "bytes",
            140.0,
            point["level_bytes_per_triangle"],
            theirs.get("bytes"),
        ),
        Row(
            "build",
            "time",
            "s",
            1.5,
            min(point["build_ms"], one["build_ms"], three["build_ms"]) / 1e3,
            theirs.get("build"),
        ),
    ]


def burr_rows(folder: Path, mesh: Path, ticks: int) -> list[Row]:
    tool, radius_mm = cases.burr_file(folder, BURR_BALLS)
    motion = cases.motion_on_top(folder, 80.0, radius_mm, ticks)
    burr, _ = replay(mesh, motion, "--tool", tool, "--repeat", 3)
    ball, _ = replay(mesh, motion, "--radius", radius_mm, "--repeat", 3)
    return [
        Row(f"burr of {BURR_BALLS} balls, 80 mm/s", "mean", "us", 60.0, burr["mean"] / 1e3),
        Row(
            f"the same over {BURR_BALLS} ticks of its tip",
            "ratio",
            "1",
            0.2,
            burr["mean"] / (BURR_BALLS * ball["mean"]),
        ),
    ]


def roughness_row(folder: Path, cells: int, ticks: int) -> Row:
    """Ideal: the depth's own steps times the stiffness."""
    _, rows = replay(cases.plane_file(folder, cells), cases.motion_on_plane(folder, 500.0, ticks), "--repeat", 1)
    _, depth = cases.depth_mm(ticks)
    settled = slice(200, None)  # after the approach
    ideal_n = np.abs(np.diff(depth[settled])).max()
    step_n = np.linalg.norm(np.diff(rows[settled, :3], axis=0), axis=1).max()
    return Row("point on a plane, 500 mm/s", "largest force step", "mN", 1.05e3 * ideal_n, 1e3 * step_n, 500.0)


def main() -> None:
    arguments = argparse.ArgumentParser(description="What one tick costs at one fixed level.")
    arguments.add_argument("--quick", action="store_true", help="100 k triangles and 4 s: half a minute in all")
    arguments.add_argument("--folder", type=Path, default=REPOSITORY / "build/bench", help="meshes and motions, reused")
    chosen = arguments.parse_args()
    folder: Path = chosen.folder
    folder.mkdir(parents=True, exist_ok=True)
    triangles, ticks, cells = (101_870, 4_000, 200) if chosen.quick else (2_600_000, 10_000, 707)
    mesh = cases.sphere_file(folder, triangles)
    costs = sphere_rows(folder, mesh, ticks, CHAI3D[triangles])
    rows = [*costs, *burr_rows(folder, mesh, ticks), roughness_row(folder, cells, ticks)]
    title = f"{triangles} triangles, one thread" + ("; the goals are for 2.6 M" if chosen.quick else "")
    table = Table(title=title, title_justify="left", title_style="")
    for heading in ("case", "figure", "goal", "measured", "", "CHAI3D", "ratio"):
        table.add_column(heading, justify="left" if heading in ("case", "figure", "") else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row.cells())
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
