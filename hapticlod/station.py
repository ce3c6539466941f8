"""The station: the target machine, its loop, its device, and what a tick costs on it.

Kept as TOML in configs/stations/. Units: mm, N, s; loop cost in us (budget) and ns (coefficients).
"""

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from hapticlod.toml import TomlModel, checked, fault_at, load_toml
from hapticlod.tool import Tool, load_tool

__all__ = ["CostCoefficients", "Station", "Tool", "load_station", "load_tool"]


class CostCoefficients(TomlModel):
    """What the counters of a tick cost on one machine, in ns per count; written by `calibrate`.

    Big levels fall out of the processor's caches, so counted work is dearer there: its factor grows smoothly from 1
    (level much smaller than `cache_mb`) to 1 + `cache_gain` (much larger).
    """

    base_ns: float = Field(ge=0, description="a tick that touches nothing")
    cell_ns: float = Field(ge=0)
    triangle_ns: float = Field(ge=0)
    test_ns: float = Field(ge=0)
    iteration_ns: float = Field(ge=0)
    ball_ns: float = Field(ge=0)
    mapping_cell_ns: float = Field(ge=0)
    carried_ball_ns: float = Field(default=0.0, ge=0, description="every tick, for each ball of the level but one")
    union_test_ns: float = Field(default=0.0, ge=0, description="on top of test_ns where the level has many balls")
    cache_mb: float = Field(default=32.0, gt=0, description="level size at which half of cache_gain is paid")
    cache_gain: float = Field(default=0.0, ge=0)
    tail_p99: float = Field(default=1.0, ge=1, description="measured over predicted cost, 99th percentile of ticks")
    tail_p999: float = Field(default=1.0, ge=1, description="the same, 99.9th percentile")
    measured_on: str = Field(default="", description="processor, build and date of the calibration")

    def tick_cost_ns(
        self,
        *,
        cells: Any = 0,
        triangles: Any = 0,
        tests: Any = 0,
        iterations: Any = 0,
        balls: Any = 0,
        mapping_cells: Any = 0,
        level_bytes: Any = 0,
        level_balls: Any = 1,
    ) -> Any:
        """Predicted cost of ticks, ns, without their tail and without a station's slowdown.

        Arguments are the counters of a record (numbers, numpy or jax arrays of one shape), and the bytes of the level
        each tick used and how many of the tool's balls it has. Plain arithmetic, so that it can be differentiated.
        `mapping_cells` are part of `cells`; `mapping_cell_ns` is what a mapping's cell costs on top. Balls are turned
        with the tool in every tick, looked at or not; and what is tested next is seldom the ball of the test before.
        """
        level_mb = level_bytes / 1e6
        cache_factor = 1.0 + self.cache_gain * level_mb / (level_mb + self.cache_mb)
        work = cells * self.cell_ns + triangles * self.triangle_ns + tests * self.test_ns + balls * self.ball_ns
        work = work + iterations * self.iteration_ns + mapping_cells * self.mapping_cell_ns
        work = work + tests * (1.0 - 1.0 / level_balls) * self.union_test_ns
        return self.base_ns + (level_balls - 1) * self.carried_ball_ns + work * cache_factor


class Machine(TomlModel):
    """What `hapticlod-station calibrate` saw of the machine besides its cost. Nothing is computed from it."""

    wake_up_p50_us: float = Field(ge=0, description="how late an absolute-time sleep ended, at the loop's rate")
    wake_up_p99_us: float = Field(ge=0)
    wake_up_p999_us: float = Field(ge=0)
    wake_up_max_us: float = Field(ge=0)
    l1d_kb: float = Field(ge=0, description="caches as the system states them; 0: it does not")
    l2_kb: float = Field(ge=0)
    l3_kb: float = Field(ge=0)
    real_time: bool = Field(description="whether real-time priority and locked memory could be had")


class Station(TomlModel):
    """One machine with one device.

    `stiffness_n_mm` is what is rendered. It must stay below the passivity limit (b + B) / (T/2 + t_d) of Gil and
    Hulin (PERCEPTION.md section 5) where the device's own damping b is known; B is the rendered damping, T the loop
    period, t_d the delay.
    """

    name: str
    loop_hz: float = Field(gt=0, le=100_000)
    budget_us: float = Field(gt=0, description="loop cost that a tick may have at p99.9")
    memory_mb: float = Field(gt=0, description="what all levels together may take")
    stiffness_n_mm: float = Field(gt=0)
    damping_n_s_mm: float = Field(default=0.0, ge=0)
    friction_static: float = Field(default=0.0, ge=0)
    friction_dynamic: float = Field(default=0.0, ge=0)
    max_force_n: float = Field(gt=0)
    max_slew_n_s: float = Field(default=0.0, ge=0, description="0: no limit")
    engage_ms: float = Field(default=50.0, ge=0, description="soft engagement after a start in overlap")
    encoder_mm: float = Field(default=0.023, ge=0, description="position resolution of the device")
    delay_ms: float = Field(default=0.0, ge=0, description="t_d: from position to force, beyond half a period")
    device_damping_n_s_mm: float | None = Field(default=None, ge=0, description="b, the device's own; if known")
    slowdown: float = Field(default=1.0, gt=0, description="cost factor against the machine of `cost`")
    slowdown_reason: str = Field(default="", description="what the slowdown assumes; required where it is not 1")
    cost: CostCoefficients | None = None
    machine: Machine | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "Station":
        if self.budget_us > self.period_us * (1 + 1e-9):
            raise fault_at("budget_us", f"exceeds the loop period of {self.period_us:g} us at {self.loop_hz:g} Hz")
        if self.friction_dynamic > self.friction_static:
            raise fault_at("friction_dynamic", "must not exceed friction_static")
        limit = self.stable_stiffness_n_mm
        if limit is not None and self.stiffness_n_mm >= limit:
            raise fault_at("stiffness_n_mm", f"not below the stability limit of {limit:.3g} N/mm")
        if self.slowdown != 1.0 and not self.slowdown_reason:
            raise fault_at("slowdown", "is an assumption: say in slowdown_reason what it rests on")
        return self

    @property
    def period_us(self) -> float:
        """Loop period, us."""
        return 1e6 / self.loop_hz

    @property
    def stable_stiffness_n_mm(self) -> float | None:
        """The passivity limit, N/mm; None where the device's damping is unknown."""
        if self.device_damping_n_s_mm is None:
            return None
        return (self.device_damping_n_s_mm + self.damping_n_s_mm) / (0.5 / self.loop_hz + self.delay_ms * 1e-3)

    def tick_cost_us(self, **counters: Any) -> Any:
        """Predicted cost of ticks on this station, us: `CostCoefficients.tick_cost_ns` times the slowdown.

        Raises:
            ValueError: the station is not calibrated.
        """
        if self.cost is None:
            raise ValueError(f"station {self.name} has no cost coefficients: calibrate it first")
        return self.cost.tick_cost_ns(**counters) * (self.slowdown * 1e-3)

    def adjusted(self, *, loop_hz: float | None = None, budget_us: float | None = None, **fields: Any) -> "Station":
        """A copy with other values. A new rate without a new budget keeps the budget's share of the period.

        Raises:
            InputError: the values do not make a station.
        """
        if loop_hz is not None:
            fields["loop_hz"] = loop_hz
            if budget_us is None and loop_hz > 0:
                budget_us = self.budget_us * self.loop_hz / loop_hz
        if budget_us is not None:
            fields["budget_us"] = budget_us
        return checked(Station, {**self.model_dump(), **fields}, f"station {self.name}")


def load_station(path: str | Path) -> Station:
    """Reads a station file. Raises InputError naming file, line, column and field of every fault."""
    return load_toml(path, Station)
