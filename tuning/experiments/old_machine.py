"""The paper's machine, as far as it can be assumed: every tick costs `slowdown` times what it is counted at here.

AN ASSUMPTION, NOT A MEASUREMENT: the factor is chosen so that 80 000 triangles of the plane at 80 mm/s just miss 1 kHz
(section 3.1 reports violent jumps above that speed). Ticks are counted, not timed, so that the figures are the same
wherever they are drawn. The loop runs late as a loop does: a tick that takes longer delays its own force and the next
tick, which then sees a longer step of the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod import _runtime
from hapticlod.config import LodConfig, load_config
from hapticlod.layout import RECORD_DTYPE
from hapticlod.motion import Motion
from hapticlod.replay import replay_levels
from hapticlod.shipped import shipped_config
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.calibrate import counted_cost_ns
from tuning.experiments.meshes import PLANE_TRIANGLES, mesh_level, plane
from tuning.experiments.slides import slide_on_plane

PERIOD_US = 1000.0
MISSED_MM_S = 80.0
ABOVE_MM = 0.3
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Loop:
    """A loop that was run late: (N,) ticks as they began, and (T,) what the hand felt at 1 kHz.

    Attributes:
        rows: (N,) of RECORD_DTYPE. started_s: (N,). cost_us: (N,) of each tick on the old machine.
        felt_n: (T, 3) force that was on the device at each period of the motion: the last one that was ready.
    """

    rows: NDArray[Any]
    started_s: Array
    cost_us: Array
    felt_n: Array

    @property
    def rate_hz(self) -> float:
        """Ticks per second, until the last one ended: where the loop breaks down that one may be most of the motion."""
        ended_s = self.started_s[-1] + 1e-6 * max(self.cost_us[-1], PERIOD_US)
        return len(self.started_s) / float(ended_s - self.started_s[0])

    @property
    def late_share(self) -> float:
        """Share of ticks that took longer than a period."""
        return float((self.cost_us > PERIOD_US).mean())


def without_short_way(tool: Tool) -> Tool:
    """The tool, for a machine whose ticks cost the more the faster the hand is.

    A point on one face has a way of its own here, whose cost hardly grows with speed (docs/decisions.md D89); in 2009
    there was none. A tool of several balls is never given that way: a second point, a little above, touches nothing.
    """
    if tool.balls > 1:
        return tool
    centres_mm = np.vstack([tool.centres_mm, tool.centres_mm + [0.0, 0.0, ABOVE_MM]])
    return Tool(tool.name, centres_mm, np.repeat(tool.radii_mm, 2))


def slowdown_of(station: Station, tool: Tool) -> float:
    """The factor that makes ticks on 80 000 triangles of the plane, at 80 mm/s, last one period in the mean."""
    scan = plane(PLANE_TRIANGLES[0])
    config = load_config(shipped_config("levels/paper_plane_80000.toml"))
    level = mesh_level(scan, scan.centre_mm, config.levels[0].cell_mm)
    # Constant speed: the strokes' mean is what the paper quotes, what a tick costs hangs on the speed it has.
    motion = slide_on_plane(MISSED_MM_S, 3.0)
    record = replay_levels([level], config, scan.centre_mm, motion, tool, station, 1, cut_short=False)
    speed = motion.speed_mm_s()
    near = np.abs(speed - MISSED_MM_S) < 0.2 * MISSED_MM_S
    cost_us = 1e-3 * cost_ns(record.rows[near], record.level_bytes, station)
    return float(PERIOD_US / np.mean(cost_us))


def cost_ns(rows: NDArray[Any], level_bytes: Sequence[int], station: Station) -> Array:
    """(T,) counted cost on the station, without its slowdown."""
    assert station.cost is not None
    return counted_cost_ns(rows, np.array(level_bytes, dtype=np.float64)[rows["level"]], station.cost)


def run_late(
    levels: list[Any], config: LodConfig, origin_mm: Array, motion: Motion, tool: Tool, station: Station, *,
    cut_short: bool = False,
) -> Loop:  # fmt: skip
    """Runs the loop on a machine that is `station.slowdown` times slower, while the hand goes on with its motion.

    `cut_short`: ticks end where a deployed runtime ends them on that station, else every tick is solved to the end.
    """
    data = config.to_runtime(station, tool, origin_mm, cut_short=cut_short)
    renderer = _runtime.Renderer(levels, data.tobytes(), tool.rows)
    level_bytes = [level.bytes for level in levels]
    period_s = 1.0 / motion.loop_hz
    rows, started, costs = [], [], []
    felt = np.zeros((motion.ticks, 3))
    force, shown, now_s = np.zeros(3), 0, 0.0
    while (tick := int(now_s / period_s + 1e-9)) < motion.ticks:
        orientation = None if motion.orientation is None else np.ascontiguousarray(motion.orientation[tick])
        raw = renderer.tick(now_s, np.ascontiguousarray(motion.position_mm[tick]), orientation)
        row = np.frombuffer(raw, dtype=RECORD_DTYPE)
        cost_us = 1e-3 * station.slowdown * float(cost_ns(row, level_bytes, station)[0])
        rows.append(row)
        started.append(now_s)
        costs.append(cost_us)
        ready = min(int(np.ceil((now_s + 1e-6 * cost_us) / period_s - 1e-9)), motion.ticks)
        felt[shown:ready] = force
        force, shown = row["force_n"][0], ready
        # Late: the next tick begins at once; in time: with the next period.
        now_s = max(now_s + 1e-6 * cost_us, (tick + 1) * period_s)
    felt[shown:] = force
    return Loop(np.concatenate(rows), np.array(started), np.array(costs), felt)
