"""The loop on this machine, at 1 and 4 kHz: how late it wakes up and what its ticks cost, apart.

Nothing is asserted: on a shared or virtual machine wake-ups of milliseconds are the host's.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hapticlod import _runtime
from hapticlod.bundle import write_bundle
from hapticlod.config import Level, LodConfig
from hapticlod.dentition import make_dentition
from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import synthesise
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station, load_tool

TRIANGLES = 100_000
RATES_HZ = (1000.0, 4000.0)


def make_bundle(path: Path, loop_hz: float, triangles: int = TRIANGLES) -> None:
    """One level of a generated dentition, touched by a ball of 1 mm."""
    scan = make_dentition(triangles, 0)
    station = load_station(shipped_config("stations/desktop_1khz.toml")).adjusted(loop_hz=loop_hz)
    tool = load_tool(shipped_config("tools/ball_1mm.toml"))
    corners = scan.vertices[scan.faces]
    cell_mm = 4.0 * float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    vertices = np.ascontiguousarray(scan.vertices - scan.centre_mm, dtype=np.float32)
    level = _runtime.Level(vertices, np.ascontiguousarray(scan.faces, dtype=np.uint32), cell_mm)
    config = LodConfig(levels=(Level(triangles=level.triangles, cell_mm=cell_mm, balls=tool.balls),), speeds_mm_s=())
    motion = synthesise(scan, "scan", seconds=5.0, loop_hz=loop_hz, seed=0, tool=tool, stiffness_n_mm=1.0)
    scalar = config.to_runtime(station, tool, scan.centre_mm)
    renderer = _runtime.Renderer([level], scalar.tobytes(), tool.rows)
    position_mm = np.ascontiguousarray(motion.position_mm)
    record = np.frombuffer(renderer.replay(motion.time_s, position_mm, motion.orientation, 1), dtype=RECORD_DTYPE)
    write_bundle(
        path, levels=[level], config=scalar, tool=tool,
        manifest={"scan": scan.name}, golden_motion=motion, golden_record=record,
    )  # fmt: skip


def run(bundle: Path, seconds: float) -> dict[str, Any]:
    """What the station says at the end of a run."""
    program = Path(sys.executable).parent / "hapticlod-station"
    command = [
        str(program),
        "run",
        str(bundle),
        "--device",
        "sim",
        "--seconds",
        str(seconds),
        "--json",
        "--accept-unsigned",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    sys.stderr.write(result.stderr)
    if result.returncode not in (0, 1):
        raise SystemExit(result.returncode)
    return json.loads(result.stdout)


def main() -> None:
    """Prints one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bundle", type=Path, help="a bundle of yours; default: generated ones")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run")
    options = parser.parse_args()
    header = f"{'rate Hz':>8} {'ticks':>8} {'':>9} {'mean':>9} {'p50':>9} {'p99':>9} {'p99.9':>9} {'max us':>9}"
    print(header)
    with tempfile.TemporaryDirectory() as folder:
        bundles = [options.bundle] if options.bundle else [Path(folder) / f"{hz:g}.hlod" for hz in RATES_HZ]
        for bundle, hz in zip(bundles, RATES_HZ, strict=False):
            if not options.bundle:
                make_bundle(bundle, hz)
            said = run(bundle, options.seconds)
            for name, key in (("wake-up", "wake_up"), ("computing", "loop_cost")):
                row = " ".join(f"{said[f'{key}_{q}_us']:9.1f}" for q in ("mean", "p50", "p99", "p999", "max"))
                print(f"{said['loop_hz']:8g} {said['ticks']:8d} {name:>9} {row}")
            print(
                f"{'':>8} late periods {said['late_periods']}, left out {said['skipped_ticks']}, fault {said['fault']}"
            )


if __name__ == "__main__":
    main()
