"""A fixed course of timed replays that shows what this machine needs per counted thing.

Surfaces of three sizes, tools from a point to a burr of hundreds of balls, slow and fast motions, and a course with
level switches: together they vary every counter by orders of magnitude, which the fit of `tuning.calibrate` needs. One
tool on a surface of a fourth size is left out of the fit and says how well it holds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hapticlod import _runtime
from hapticlod.config import Level, LodConfig
from hapticlod.dentition import make_dentition
from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import Motion, synthesise
from hapticlod.scan import Scan
from hapticlod.station import CostCoefficients, Station
from hapticlod.tool import Tool
from tuning.calibrate import calibrate, counted_cost_ns, without_interrupts

Progress = Callable[[str, float], None]

SIZES = (8_000, 50_000, 300_000)
HELD_OUT_SIZE = 120_000
CELL_EDGES = 4.0
REPEATS = 3
# Slow, fast, and in and out of contact.
MODES = ("probe", "scan", "transfer")
_SECONDS = 1.0


@dataclass(frozen=True)
class Calibration:
    """Coefficients of this machine, and how they did on replays that they were not fitted to.

    `error_p50` is the median over the held-out ticks of |predicted / measured - 1|, `mean_ratio` and `p999_ratio` are
    predicted over measured mean and 99.9th percentile.
    """

    cost: CostCoefficients
    error_p50: float
    mean_ratio: float
    p999_ratio: float


@dataclass(frozen=True)
class _Surface:
    scan: Scan
    level: _runtime.Level
    cell_mm: float


def run_course(station: Station, tools: Sequence[Tool], held_out: Tool, seed: int, progress: Progress) -> Calibration:
    """Times the course on this machine and fits the coefficients. Some ten seconds.

    Args:
        station: its rate, stiffness and limits are used; its budget and own coefficients are not.
        tools: to fit with, of very different sizes.
        held_out: to check with.
        seed: of the motions.
        progress: told what is done.
    """
    progress("make the surfaces", 0.0)
    surfaces = {size: _surface(size, seed) for size in (*SIZES, HELD_OUT_SIZE)}
    middle = surfaces[SIZES[1]].scan  # motions are laid on it: all surfaces are one, more or less finely
    records: list[NDArray] = []
    level_bytes: list[int] = []
    level_balls: list[int] = []
    for i, tool in enumerate(tools):
        motions = _motions(middle, station, tool, seed)
        for k, (size, motion) in enumerate(product(SIZES, motions)):
            progress("time the course", (i + k / (len(SIZES) * len(motions))) / len(tools))
            records.append(_replay([surfaces[size]], station, tool, motion))
            level_bytes.append(surfaces[size].level.bytes)
            level_balls.append(tool.balls)
        # Mapping is counted where levels switch.
        pair = [surfaces[SIZES[1]], surfaces[SIZES[0]]]
        switched = _replay(pair, station, tool, motions[-1])
        for index, surface in enumerate(pair):
            records.append(switched[switched["level"] == index])
            level_bytes.append(surface.level.bytes)
            level_balls.append(tool.balls)
    kept = [place for place in zip(records, level_bytes, level_balls, strict=True) if len(place[0])]
    cost = calibrate(
        [rows for rows, _, _ in kept], [size for _, size, _ in kept], [count for _, _, count in kept], seed
    )

    progress("check the coefficients", 0.0)
    target = surfaces[HELD_OUT_SIZE]
    unseen = _motions(middle, station, held_out, seed + 1)
    rows = np.concatenate([_replay([target], station, held_out, motion) for motion in unseen])
    predicted = counted_cost_ns(rows, target.level.bytes, cost, held_out.balls)
    measured = without_interrupts(rows, predicted)
    return Calibration(
        cost=cost,
        error_p50=float(np.median(np.abs(predicted / np.maximum(measured, 1.0) - 1.0))),
        mean_ratio=float(predicted.mean() / measured.mean()),
        p999_ratio=float(np.quantile(predicted, 0.999) / np.quantile(measured, 0.999)),
    )


def _surface(triangles: int, seed: int) -> _Surface:
    scan = make_dentition(triangles, seed)
    vertices = np.ascontiguousarray(scan.vertices - scan.centre_mm, dtype=np.float32)
    corners = scan.vertices[scan.faces]
    edge_mm = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    level = _runtime.Level(vertices, np.ascontiguousarray(scan.faces, dtype=np.uint32), CELL_EDGES * edge_mm)
    return _Surface(scan, level, CELL_EDGES * edge_mm)


def _motions(scan: Scan, station: Station, tool: Tool, seed: int) -> list[Motion]:
    return [
        synthesise(
            scan, mode, seconds=_SECONDS, loop_hz=station.loop_hz, seed=seed, tool=tool,
            stiffness_n_mm=station.stiffness_n_mm,
        )
        for mode in MODES
    ]  # fmt: skip


def _replay(surfaces: Sequence[_Surface], station: Station, tool: Tool, motion: Motion) -> NDArray:
    """(T,) rows of RECORD_DTYPE; between two surfaces the level changes at the motion's median speed."""
    levels = tuple(Level(triangles=s.level.triangles, cell_mm=s.cell_mm, balls=tool.balls) for s in surfaces)
    speed_mm_s = np.linalg.norm(np.diff(motion.position_mm, axis=0), axis=1) * station.loop_hz
    speeds = (max(float(np.median(speed_mm_s)), 1.0),) * (len(surfaces) - 1)
    config = LodConfig(levels=levels, speeds_mm_s=speeds, l_in_mm=1.0, l_out_mm=1.0, hysteresis=0.1)
    scalar = config.to_runtime(station, tool, surfaces[0].scan.centre_mm, cut_short=False)
    renderer = _runtime.Renderer([s.level for s in surfaces], scalar.tobytes(), tool.rows)
    orientation = None if motion.orientation is None else np.ascontiguousarray(motion.orientation)
    raw = renderer.replay(motion.time_s, np.ascontiguousarray(motion.position_mm), orientation, REPEATS)
    return np.frombuffer(raw, dtype=RECORD_DTYPE)
