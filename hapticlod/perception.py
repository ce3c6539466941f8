"""What people feel: named presets of thresholds and weights, and the functions made of them.

The numbers live in configs/perception/, with their sources. The functions are plain arithmetic: numbers, numpy and
jax arrays all pass through them.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from hapticlod.shipped import shipped_config
from hapticlod.toml import TomlModel, fault_at, load_toml

_TWO_PI = 6.283185307179586


class Skin(TomlModel):
    """Vibration threshold of the skin, two channels."""

    pacinian_um: float = Field(gt=0)
    pacinian_hz: float = Field(gt=0)
    other_um: float = Field(gt=0)
    other_hz: float = Field(gt=0)

    def threshold_um(self, frequency_hz: Any) -> Any:
        """Least displacement amplitude that is felt, um (PERCEPTION.md section 3)."""
        ratio = (frequency_hz / self.pacinian_hz) ** 2
        pacinian = 0.5 * self.pacinian_um * (1.0 / ratio + ratio)
        other = self.other_um * (1.0 + (frequency_hz / self.other_hz) ** 2)
        return (pacinian**-4.0 + other**-4.0) ** -0.25


class Hand(TomlModel):
    """Impedance of the hand on the stylus."""

    stiffness_n_mm: float = Field(ge=0)
    damping_n_s_mm: float = Field(ge=0)
    mass_kg: float = Field(gt=0)

    def impedance_n_mm(self, frequency_hz: Any) -> Any:
        """Force amplitude per displacement amplitude, N/mm: |K - m w^2 + j b w|."""
        w = _TWO_PI * frequency_hz
        real = self.stiffness_n_mm - 1e-3 * self.mass_kg * w**2  # kg/s^2 = N/m = 1e-3 N/mm
        return (real**2 + (self.damping_n_s_mm * w) ** 2) ** 0.5


class Perception(TomlModel):
    """One preset."""

    name: str
    weber: float = Field(ge=0, lt=1)
    absolute_n: float = Field(gt=0)
    felt_hz: float = Field(gt=0)
    detail_mm: float = Field(gt=0)
    beta: float = Field(gt=0)
    vibration_low_hz: float = Field(gt=0)
    vibration_high_hz: float = Field(gt=0)
    slack_ms: float = Field(ge=0)
    skin: Skin
    hand: Hand

    @model_validator(mode="after")
    def _ordered(self) -> "Perception":
        if self.vibration_high_hz <= self.vibration_low_hz:
            raise fault_at("vibration_high_hz", "must be above vibration_low_hz")
        return self

    def jnd_n(self, force_n: Any) -> Any:
        """Just noticeable difference of a force of norm `force_n`, N."""
        return ((self.weber * force_n) ** 2 + self.absolute_n**2) ** 0.5

    def felt_share(self, speed_mm_s: Any) -> Any:
        """Share of a squared force error that the hand feels at a speed, 0 to 1."""
        return 1.0 / (1.0 + (speed_mm_s / (self.detail_mm * self.felt_hz)) ** 2)

    def noticed(self, jump_jnd: Any) -> Any:
        """Probability that a jump of so many JND is noticed."""
        return 1.0 - 2.0 ** -(jump_jnd**self.beta)

    def force_threshold_n(self, frequency_hz: Any) -> Any:
        """F_th(f) = |D(f)| x_th(f): least force amplitude at a frequency > 0 Hz that is felt, N."""
        return self.hand.impedance_n_mm(frequency_hz) * (1e-3 * self.skin.threshold_um(frequency_hz))


def load_perception(path: str | Path | None = None) -> Perception:
    """Reads a preset; without a path the shipped default. Raises InputError naming every fault of the file."""
    return _default() if path is None else load_toml(path, Perception)


@lru_cache(maxsize=1)
def _default() -> Perception:
    return load_toml(shipped_config("perception/default.toml"), Perception)
