"""Device profiles: what is known about one kind of force-feedback device, as TOML (docs/devices.md).

The station reads the same files by itself (runtime/station/device_profile.cpp) and holds them to the same rules.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from hapticlod.toml import TomlModel, fault_at, load_toml

FieldType = Literal["i8", "u8", "i16", "u16", "i32", "u32", "f32"]
_FORMAT = {"i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i", "u32": "I", "f32": "f"}
_COUNTS = {"pos_mm": 3, "vel_mm_s": 3, "encoders": 3, "deflection": 3, "force_n": 3, "motor_ma": 3, "orientation": 4}
_MOST_BYTES = 1024

Triple = tuple[float, float, float]


class ReportField(TomlModel):
    """Where a value lies in a report: `count` numbers of `type` from byte `offset` on; value = raw scale + bias."""

    offset: int = Field(ge=0, lt=_MOST_BYTES)
    type: FieldType
    count: int = Field(default=1, ge=1, le=8)
    scale: float = Field(default=1.0, ge=-1e9, le=1e9)
    bias: float = Field(default=0.0, ge=-1e9, le=1e9)

    @model_validator(mode="after")
    def _scale_is_not_zero(self) -> ReportField:
        if abs(self.scale) < 1e-12:
            raise fault_at("scale", "must not be 0")
        return self

    @property
    def end(self) -> int:
        """The first byte after the field."""
        return self.offset + self.count * struct.calcsize(_FORMAT[self.type])


class _Fields(TomlModel):
    def given(self) -> Iterator[tuple[str, ReportField]]:
        """Fields that the report has, by name."""
        for name in type(self).model_fields:
            if (field := getattr(self, name)) is not None:
                yield name, field

    @model_validator(mode="after")
    def _right(self) -> _Fields:
        for name, field in self.given():
            count = _COUNTS.get(name, 1)
            if field.count != count:
                raise fault_at(name, f"has count {field.count}, should have {count}")
            if name == "crc16" and field.type != "u16":
                raise fault_at(name, "should have type u16")
            if count == 1 and field.type not in ("u8", "u16", "u32"):
                raise fault_at(name, "should have type u8, u16 or u32")
        # Of two fields that overlap, the one that begins later is to blame.
        for (earlier, before), (later, after) in pairwise(sorted(self.given(), key=lambda item: item[1].offset)):
            if after.offset < before.end:
                raise fault_at(later, f"overlaps {earlier}")
        return self


class InputFields(_Fields):
    seq: ReportField | None = None
    t_us: ReportField | None = None
    pos_mm: ReportField | None = None
    vel_mm_s: ReportField | None = None
    orientation: ReportField | None = None
    encoders: ReportField | None = None
    deflection: ReportField | None = None
    buttons: ReportField | None = None
    status: ReportField | None = None
    echo_seq: ReportField | None = None
    crc16: ReportField | None = None


class OutputFields(_Fields):
    seq: ReportField | None = None
    force_n: ReportField | None = None
    motor_ma: ReportField | None = None
    flags: ReportField | None = None
    watchdog_ms: ReportField | None = None
    crc16: ReportField | None = None


class _Report(TomlModel):
    report_id: int = Field(ge=0, le=255, description="0: the device has no report ids")
    bytes: int = Field(ge=1, le=_MOST_BYTES, description="without the id")
    endian: Literal["little", "big"] = "little"

    def _check(self, fields: _Fields) -> None:
        for name, field in fields.given():
            if field.end > self.bytes:
                raise fault_at(f"fields.{name}", f"ends at byte {field.end} of a report of {self.bytes}")


class InputReport(_Report):
    fields: InputFields

    @model_validator(mode="after")
    def _fits(self) -> InputReport:
        self._check(self.fields)
        return self

    def values(self, payload: bytes, name: str) -> NDArray[np.float64]:
        """The numbers of a field; `payload` is one report without its id."""
        field: ReportField = getattr(self.fields, name)
        order = "<" if self.endian == "little" else ">"
        raw = struct.unpack_from(f"{order}{field.count}{_FORMAT[field.type]}", payload, field.offset)
        return np.asarray(raw, dtype=np.float64) * field.scale + field.bias


class OutputReport(_Report):
    fields: OutputFields

    @model_validator(mode="after")
    def _fits(self) -> OutputReport:
        self._check(self.fields)
        return self


class DeviceMatch(TomlModel):
    """Which HID devices a profile is for. What is left out is not asked for."""

    vendor_id: int = Field(ge=0, le=0xFFFF)
    product_id: int = Field(ge=0, le=0xFFFF)
    usage_page: int | None = Field(default=None, ge=0, le=0xFFFF)
    usage: int | None = Field(default=None, ge=0, le=0xFFFF)
    product: str = Field(default="", description="part of the product string")
    serial: str = Field(default="", description="the whole serial number")


class Device(TomlModel):
    name: str
    status: str = Field(default="", description="what the profile was tried on")
    match: DeviceMatch | None = None


class StatusBits(TomlModel):
    """Bits of the status field, from 0."""

    motors: int | None = Field(default=None, ge=0, le=31)
    fault: int | None = Field(default=None, ge=0, le=31)
    estop: int | None = Field(default=None, ge=0, le=31)
    watchdog: int | None = Field(default=None, ge=0, le=31)
    calibrated: int | None = Field(default=None, ge=0, le=31)


_IDENTITY: tuple[Triple, Triple, Triple] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


class _Kinematics(TomlModel):
    axes: tuple[Triple, Triple, Triple] = Field(default=_IDENTITY, description="device -> world, orthonormal")

    @model_validator(mode="after")
    def _orthonormal(self) -> _Kinematics:
        axes = np.array(self.axes)
        if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-3:
            raise fault_at("axes", "its rows are not orthonormal")
        return self


class Cartesian(_Kinematics):
    kind: Literal["cartesian"] = "cartesian"


Positive = Annotated[float, Field(gt=0)]


class SerialPantograph(_Kinematics):
    """Turning body and two links of a pantograph, the WoodenHaptics family; the formulas are in kinematics.hpp."""

    kind: Literal["serial-rrr-pantograph"] = "serial-rrr-pantograph"
    links_mm: tuple[Positive, Positive, Positive]
    origin_mm: Triple = (0.0, 0.0, 0.0)
    counts_per_rev: tuple[Positive, Positive, Positive]
    reduction: tuple[Positive, Positive, Positive]
    sign: Triple
    home_counts: Triple = (0.0, 0.0, 0.0)
    torque_constant_n_m_a: tuple[Positive, Positive, Positive]
    max_current_ma: float = Field(gt=0, le=1e6)

    @model_validator(mode="after")
    def _signs(self) -> SerialPantograph:
        if any(abs(value) != 1.0 for value in self.sign):
            raise fault_at("sign", "should hold 1 and -1 only")
        return self

    def position_mm(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,) position in the device's frame from (3,) encoder counts."""
        turns = (counts + np.array(self.home_counts)) / np.array(self.counts_per_rev)
        a, b, c = turns * 2.0 * np.pi * np.array(self.sign) * np.array(self.reduction)
        la, lb, lc = self.links_mm
        reach = lb * np.sin(b) + lc * np.sin(c)
        place = np.array([np.cos(a) * reach, np.sin(a) * reach, la + lb * np.cos(b) - lc * np.cos(c)])
        return place - np.array(self.origin_mm)


class RateControl(_Kinematics):
    kind: Literal["rate"] = "rate"
    gain_mm_s: float = Field(gt=0, le=1e6)


class DeviceLimits(TomlModel):
    max_force_n: float = Field(default=0.0, ge=0, le=1000)
    max_force_rate_n_ms: float = Field(default=0.0, ge=0, le=1000)
    max_speed_mm_s: float = Field(gt=0, le=1e5, description="faster than any hand moves it")
    resolution_mm: float = Field(default=0.0, ge=0, le=10)
    damping_n_s_mm: float = Field(default=0.0, ge=0, le=10, description="its own, physical; 0: not known")
    max_stiffness_n_mm: float = Field(default=0.0, ge=0, le=1000, description="as its maker states it; 0: not stated")


class DeviceTiming(TomlModel):
    rate_hz: float = Field(ge=10, le=20_000, description="of its reports")
    delay_ms: float = Field(default=0.0, ge=0, le=100, description="from a position to its force being felt")
    first_report_ms: float = Field(default=500.0, ge=1, le=10_000)
    watchdog_ms: float | None = Field(default=None, ge=0, le=10_000, description="0: its firmware has none")
    host_first: bool = Field(default=False, description="sends nothing until it was written to")


class Simulated(TomlModel):
    """The simulated hand and device (runtime/station/simulated_device.hpp)."""

    hand_stiffness_n_mm: float = Field(default=0.5, ge=0, le=100)
    hand_damping_n_s_mm: float = Field(default=0.0045, ge=0, le=10)
    hand_mass_kg: float = Field(default=0.08, ge=0, le=10)
    device_mass_kg: float = Field(default=0.05, ge=1e-4, le=10)
    device_damping_n_s_mm: float = Field(default=0.005, ge=0, le=10)
    device_friction_n: float = Field(default=0.05, ge=0, le=10)
    max_force_n: float = Field(default=12.0, ge=1e-3, le=1000)
    encoder_mm: float = Field(default=0.023, ge=0, le=10)
    delay_s: float = Field(default=0.001, ge=0, le=0.1)
    read_delay_s: float = Field(default=0.0, ge=0, le=0.1)


class DeviceProfile(TomlModel):
    """One kind of device: simulated, or behind HID with at least one input report."""

    schema_: int = Field(alias="schema", ge=1, le=1)
    device: Device
    input: tuple[InputReport, ...] = ()
    output: OutputReport | None = None
    status_bits: StatusBits | None = None
    kinematics: Annotated[Cartesian | SerialPantograph | RateControl, Field(discriminator="kind")] | None = None
    limits: DeviceLimits | None = None
    timing: DeviceTiming | None = None
    simulated: Simulated | None = None

    @model_validator(mode="after")
    def _whole(self) -> DeviceProfile:
        if self.simulated is not None:
            return self
        if self.device.match is None:
            raise fault_at("device.match", "missing")
        for name in ("input", "kinematics", "limits", "timing"):
            if not getattr(self, name):
                raise fault_at(name, "missing")
        self._reports()
        self._motors()
        return self

    def _has(self, name: str) -> bool:
        return any(getattr(report.fields, name) is not None for report in self.input)

    def _reports(self) -> None:
        needs = {"cartesian": ("pos_mm", "force_n"), "serial-rrr-pantograph": ("encoders", "motor_ma")}
        kind = self.kinematics.kind if self.kinematics else ""
        given, sent = needs.get(kind, ("deflection", ""))
        if not self._has(given):
            raise fault_at("input", f"{kind} kinematics need a field {given}")
        if self.output is not None and not sent:
            raise fault_at("output", "rate kinematics are for devices without motors")
        if self.output is not None and getattr(self.output.fields, sent) is None:
            raise fault_at("output", f"{kind} kinematics need a field {sent}")
        mirrored = self.kinematics is not None and np.linalg.det(np.array(self.kinematics.axes)) < 0
        if mirrored and self._has("orientation"):
            raise fault_at("kinematics", "axes that mirror cannot turn an orientation")
        if self.status_bits is not None and not self._has("status"):
            raise fault_at("status_bits", "no input has a field status")
        ids = [report.report_id for report in self.input]
        if doubled := [number for number in ids if ids.count(number) > 1]:
            raise fault_at("input", f"two input reports have id {doubled[0]}")
        if len(ids) > 1 and 0 in ids:
            raise fault_at("input", "a device with several reports numbers them from 1")

    def _motors(self) -> None:
        if self.output is None or self.limits is None or self.timing is None:
            return
        for name in ("max_force_n", "max_force_rate_n_ms"):
            if getattr(self.limits, name) == 0:
                raise fault_at(f"limits.{name}", "missing")
        if self.limits.damping_n_s_mm == 0 and self.limits.max_stiffness_n_mm == 0:
            message = "missing: without it, or max_stiffness_n_mm, no stiffness is known to be stable"
            raise fault_at("limits.damping_n_s_mm", message)
        if self.timing.watchdog_ms is None:
            raise fault_at("timing.watchdog_ms", "missing")

    def position_mm(self, report: bytes) -> NDArray[np.float64] | None:
        """(3,) position in mm, world axes, that a report (with its id, where the device has ids) holds.

        None where this report holds none: another id, a wrong length, or a device that has no position.
        """
        for known in self.input:
            payload = report[1:] if known.report_id else report
            if len(payload) != known.bytes or (known.report_id and report[0] != known.report_id):
                continue
            axes = np.array(self.kinematics.axes) if self.kinematics else np.eye(3)
            if isinstance(self.kinematics, SerialPantograph) and known.fields.encoders is not None:
                return axes @ self.kinematics.position_mm(known.values(payload, "encoders"))
            if known.fields.pos_mm is not None:
                return axes @ known.values(payload, "pos_mm")
        return None


def load_device_profile(path: str | Path) -> DeviceProfile:
    """Reads a profile. Raises InputError naming file, line, column and field of every fault."""
    return load_toml(path, DeviceProfile)
