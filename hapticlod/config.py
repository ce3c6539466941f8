"""LodConfig: everything that is tuned, as one immutable value with a TOML form (configs/levels/).

The paper (Zhou et al. 2009) set all of it by hand: three levels, the speeds V01 and V12, the mapping length L.
"""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from hapticlod.layout import CONFIG_DTYPE, CONFIG_VERSION, MAX_BALLS, MAX_LEVELS
from hapticlod.toml import TomlModel, checked, fault_at, load_toml, save_toml

if TYPE_CHECKING:
    from hapticlod.station import Station
    from hapticlod.tool import Tool

MAPPINGS = ("paper", "two-sided")  # the position is the runtime's code (core/layout.hpp)
POLICIES = ("velocity", "distance")

# Work (in triangle distances, TickCounters::work() in the core) per microsecond of budget at which a tick is cut short:
# 30 ns each at most on a 3 GHz core (docs/decisions.md), and one and a half budgets. What meets its budget is never
# cut, what misses it by far does not stall the loop.
WORK_PER_US = 50.0

Positive = Annotated[float, Field(gt=0)]


class Level(TomlModel):
    """One level: how many triangles, the edge of its voxels, how many of the tool's balls touch it."""

    triangles: int = Field(ge=1, le=2**32 - 2)
    cell_mm: Positive
    balls: int = Field(default=MAX_BALLS, ge=1, le=MAX_BALLS, description="at most; a smaller tool uses all it has")


class RungLike(Protocol):
    """What `LodConfig.scaled_to` needs of a rung."""

    @property
    def triangles(self) -> int: ...
    @property
    def mean_edge_mm(self) -> float: ...


class LadderLike(Protocol):
    """What `LodConfig.scaled_to` needs of a ladder."""

    def at(self, triangles: int, /) -> RungLike: ...


class LodConfig(TomlModel):
    """Levels, finest first, and how the loop moves between them. `speeds_mm_s[i]` separates level i from i + 1."""

    name: str = ""
    speeds_mm_s: tuple[Positive, ...] = ()
    hysteresis: float = Field(default=0.0, ge=0, lt=1, description="eta: up above V (1 + eta), down below V (1 - eta)")
    dwell_ms: float = Field(default=0.0, ge=0, description="least time between two switches")
    filter_hz: float = Field(default=0.0, ge=0, description="low-pass on velocity; 0: raw difference, as the paper")
    l_in_mm: float = Field(default=0.0, ge=0, description="mapping segment inward from the SCP; the paper has none")
    l_out_mm: float = Field(default=5.0, ge=0, description="and outward, along the force: the paper's L")
    closest_bound_mm: float | None = Field(default=None, ge=0, description="two-sided only; none: the longer of the L")
    blend_ms: float = Field(default=0.0, ge=0, description="a switch's offset decays over this time; 0: at once")
    mapping: Literal["paper", "two-sided"] = "two-sided"
    policy: Literal["velocity", "distance"] = "velocity"
    shading: bool = Field(default=False, description="force along interpolated normals")
    crack_mm: float = Field(default=0.0, ge=0, description="gaps up to this width hold a tool of radius 0")
    levels: tuple[Level, ...] = Field(min_length=1, max_length=MAX_LEVELS)

    @model_validator(mode="after")
    def _ordered(self) -> "LodConfig":
        for i, (finer, coarser) in enumerate(pairwise(self.levels)):
            if coarser.triangles > finer.triangles:
                raise fault_at("levels", f"level {i + 1} has more triangles than level {i}: finest first")
            if (coarser.triangles, coarser.balls) == (finer.triangles, finer.balls):
                raise fault_at("levels", f"levels {i} and {i + 1} are alike: drop one")
        if len(self.speeds_mm_s) != len(self.levels) - 1:
            needed = len(self.levels) - 1
            raise fault_at(
                "speeds_mm_s", f"{len(self.levels)} levels need {needed} speeds, not {len(self.speeds_mm_s)}"
            )
        if any(upper <= lower for lower, upper in pairwise(self.speeds_mm_s)):
            raise fault_at("speeds_mm_s", "must increase")
        if self.levels[1:] and self.l_in_mm + self.l_out_mm == 0.0:
            raise fault_at("l_out_mm", "l_in_mm and l_out_mm are both 0: no switch in contact could be mapped")
        return self

    def changed(self, **fields: Any) -> "LodConfig":
        """A copy with other values, checked. Raises InputError."""
        return checked(LodConfig, {**self.model_dump(), **fields}, f"config {self.name or '(unnamed)'}")

    def scaled_to(self, ladder: LadderLike, triangles: int, cell_edges: float = 4.0) -> "LodConfig":
        """The same proportions of triangles on another scan: level 0 gets `triangles`, cells `cell_edges` mean edges.

        Levels that come out alike on a small scan are dropped with the speed below them.

        Raises:
            InputError: the result is no configuration.
        """
        levels: list[Level] = []
        speeds: list[float] = []
        for i, level in enumerate(self.levels):
            rung = ladder.at(max(1, round(triangles * level.triangles / self.levels[0].triangles)))
            made = Level(triangles=rung.triangles, cell_mm=cell_edges * rung.mean_edge_mm, balls=level.balls)
            if levels and made == levels[-1]:
                continue
            if levels:
                speeds.append(self.speeds_mm_s[i - 1])
            levels.append(made)
        return self.changed(levels=levels, speeds_mm_s=speeds)

    def to_runtime(self, station: "Station", tool: "Tool", origin_mm: ArrayLike, *, cut_short: bool = True) -> Any:
        """This configuration as the runtime's ConfigData: a numpy scalar of `hapticlod.layout.CONFIG_DTYPE`.

        Args:
            station: gives rate, budget, stiffness and limits.
            tool: bounds the number of balls per level.
            origin_mm: (3,) place of the scan frame that level vertices are relative to.
            cut_short: end a tick whose work is far beyond the budget; False: every tick is solved to the end.
        """
        data: Any = np.zeros((), dtype=CONFIG_DTYPE)
        data["version"] = CONFIG_VERSION
        data["level_count"] = len(self.levels)
        data["mapping"] = MAPPINGS.index(self.mapping)
        data["policy"] = POLICIES.index(self.policy)
        data["shading"] = self.shading
        data["origin_mm"] = np.asarray(origin_mm, dtype=np.float64)
        for field in (
            "loop_hz",
            "budget_us",
            "stiffness_n_mm",
            "damping_n_s_mm",
            "friction_static",
            "friction_dynamic",
        ):
            data[field] = getattr(station, field)
        data["max_force_n"] = station.max_force_n
        data["max_slew_n_s"] = station.max_slew_n_s
        data["engage_s"] = station.engage_ms * 1e-3
        data["work_limit"] = WORK_PER_US * station.budget_us / station.slowdown if cut_short else 0.0
        for field in ("filter_hz", "hysteresis", "l_in_mm", "l_out_mm", "crack_mm"):
            data[field] = getattr(self, field)
        longer = max(self.l_in_mm, self.l_out_mm)
        data["closest_bound_mm"] = longer if self.closest_bound_mm is None else self.closest_bound_mm
        data["dwell_s"] = self.dwell_ms * 1e-3
        data["blend_s"] = self.blend_ms * 1e-3
        data["speeds_mm_s"][: len(self.speeds_mm_s)] = self.speeds_mm_s
        for i, level in enumerate(self.levels):
            data["cell_mm"][i] = level.cell_mm
            data["triangles"][i] = level.triangles
            data["balls"][i] = min(level.balls, tool.balls)
        return data[()]


def load_config(path: str | Path) -> LodConfig:
    """Reads a configuration. Raises InputError naming file, line, column and field of every fault."""
    return load_toml(path, LodConfig)


def save_config(path: str | Path, config: LodConfig, comment: str = "") -> None:
    """Writes a configuration that `load_config` gives back equal."""
    save_toml(path, config, comment)
