"""Runs the native runtime over a motion, offline: the same tick as the station's, with its counters and times."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hapticlod import _runtime
from hapticlod.config import LodConfig
from hapticlod.ladder import Ladder, Rung
from hapticlod.layout import RECORD_DTYPE
from hapticlod.material import to_runtime
from hapticlod.motion import Motion
from hapticlod.scene_ladder import SceneRung
from hapticlod.station import Station
from hapticlod.tool import Tool

DEFAULT_STATION = Station(
    name="desktop", loop_hz=1000.0, budget_us=1000.0, memory_mb=4096.0, stiffness_n_mm=1.0, max_force_n=20.0
)
"""What `replay` assumes where no station is given."""


@dataclass(frozen=True, eq=False)
class Record:
    """What a replay gave, one row per tick.

    Attributes:
        rows: (T,) of `hapticlod.layout.RECORD_DTYPE`.
        loop_hz: rate of the loop.
        budget_us: what a tick may cost.
        stiffness_n_mm: rendered stiffness.
        level_triangles: (K,) triangles per level.
        level_bytes: (K,) resident bytes per level.
        blend_s: how long a switch's offset decays: metrics look for its jump that long.
        slowdown: factor of a what-if station on measured cost.
    """

    rows: np.ndarray
    loop_hz: float
    budget_us: float
    stiffness_n_mm: float
    level_triangles: tuple[int, ...]
    level_bytes: tuple[int, ...]
    blend_s: float = 0.0
    slowdown: float = 1.0

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def time_s(self) -> np.ndarray:
        """(T,) s."""
        return self.rows["time_s"]

    @property
    def hip(self) -> np.ndarray:
        """(T, 3) HIP, mm, scan frame."""
        return self.rows["hip_mm"]

    @property
    def scp(self) -> np.ndarray:
        """(T, 3) rendered SCP, mm, scan frame."""
        return self.rows["scp_mm"]

    @property
    def force(self) -> np.ndarray:
        """(T, 3) N."""
        return self.rows["force_n"]

    @property
    def speed_mm_s(self) -> np.ndarray:
        """(T,) the speed that levels were chosen by."""
        return self.rows["speed_mm_s"]

    @property
    def level(self) -> np.ndarray:
        """(T,) level in use, 0 the finest."""
        return self.rows["level"]

    @cached_property
    def contact(self) -> np.ndarray:
        """(T,) bool."""
        return self.rows["contact"].astype(bool)

    @property
    def mapping(self) -> np.ndarray:
        """(T,) MAPPED_* of `hapticlod.layout`."""
        return self.rows["mapping"]

    @cached_property
    def cost_us(self) -> np.ndarray:
        """(T,) time of each tick, us: as measured, times the station's slowdown."""
        return self.rows["cost_ns"].astype(np.float64) * (1e-3 * self.slowdown)


def local_vertices(rung: Rung, origin_mm: np.ndarray) -> np.ndarray:
    """(n, 3) float32 vertices relative to the origin: what the runtime keeps."""
    return np.ascontiguousarray(rung.vertices - origin_mm, dtype=np.float32)


def runtime_level(rung: Rung, origin_mm: np.ndarray, cell_mm: float) -> Any:
    """A rung as a level of the runtime, its voxel hash built; of a scene, a level of every part.

    `cell_mm` is then for the scene's mean edge: each part has cells of as many of its own mean edges.
    """
    if isinstance(rung, SceneRung):
        return scene_level(rung, origin_mm, cell_mm, None, None)
    faces = np.ascontiguousarray(rung.faces, dtype=np.uint32)
    materials = None if rung.materials is None else to_runtime(rung.materials)
    return _runtime.Level(local_vertices(rung, origin_mm), faces, cell_mm, materials)


def runtime_levels(config: LodConfig, ladder: Ladder) -> list[Any]:
    """Every level of a configuration, built from the ladder of its scan."""
    origin = ladder.scan.centre_mm
    levels: list[Any] = []
    rung_before = None
    for level in config.levels:
        rung = ladder.at(level.triangles)
        if isinstance(rung, SceneRung):
            levels.append(scene_level(rung, origin, level.cell_mm, rung_before, levels[-1] if levels else None))
            rung_before = rung
        else:
            levels.append(runtime_level(rung, origin, level.cell_mm))
    return levels


def scene_level(
    rung: SceneRung, origin_mm: np.ndarray, cell_mm: float, finer: SceneRung | None, finer_level: Any
) -> Any:
    """A rung of a scene as a level of the runtime. Parts that are as on the finer level keep what was built for it."""
    edges = cell_mm / rung.mean_edge_mm
    made: list[Any] = []
    for i, part in enumerate(rung.parts):
        if finer is not None and finer.parts[i] is part:
            made.append(finer_level.parts[i])
        else:
            made.append(runtime_level(part, origin_mm, edges * part.mean_edge_mm))
    return _runtime.SceneLevel(made, cell_mm, rung.hidden)


def replay_levels(
    levels: list[Any],
    config: LodConfig,
    origin_mm: np.ndarray,
    motion: Motion,
    tool: Tool,
    station: Station,
    repeats: int,
    *,
    cut_short: bool = True,
) -> Record:
    """`replay` on levels that are already built (their meshes must be those the configuration names).

    `cut_short=False` solves every tick to the end: then forces do not depend on the station's budget.
    """
    balls = np.column_stack([tool.centres_mm, tool.radii_mm])
    data = config.to_runtime(station, tool, origin_mm, cut_short=cut_short)
    renderer = _runtime.Renderer(levels, data.tobytes(), balls)
    raw = renderer.replay(
        np.ascontiguousarray(motion.time_s, dtype=np.float64),
        np.ascontiguousarray(motion.position_mm, dtype=np.float64),
        None if motion.orientation is None else np.ascontiguousarray(motion.orientation, dtype=np.float64),
        repeats,
    )
    return Record(
        rows=np.frombuffer(raw, dtype=RECORD_DTYPE),
        loop_hz=station.loop_hz,
        budget_us=station.budget_us,
        stiffness_n_mm=station.stiffness_n_mm,
        level_triangles=tuple(level.triangles for level in levels),
        level_bytes=tuple(level.bytes for level in levels),
        blend_s=config.blend_ms * 1e-3,
        slowdown=station.slowdown,
    )


def replay(
    config: LodConfig,
    ladder: Ladder,
    motion: Motion,
    tool: Tool,
    station: Station | None = None,
    *,
    repeats: int = 1,
) -> Record:
    """Runs a configuration over a motion in the runtime.

    Args:
        config: levels and how to move between them; a fixed level is a configuration with one level.
        ladder: of the scan; each level is the prefix of its collapse list with that many triangles.
        motion: HIP positions at the loop rate.
        tool: union of balls.
        station: rate, stiffness, limits. Default: `DEFAULT_STATION` at the motion's rate.
        repeats: runs; a tick's time is its least over them, everything else is the same in each.

    Returns:
        Record: force, SCP, level, contact, mapping outcome, counters and nanoseconds per tick.

    Raises:
        InputError: the configuration does not fit the tool or the station.
    """
    if station is None:
        station = DEFAULT_STATION.model_copy(update={"loop_hz": motion.loop_hz, "budget_us": 1e6 / motion.loop_hz})
    levels = runtime_levels(config, ladder)
    return replay_levels(levels, config, ladder.scan.centre_mm, motion, tool, station, repeats)
