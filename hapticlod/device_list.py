"""HID devices that are there, by hidapi's hidraw backend, and the profiles that know them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hapticlod.device_profile import DeviceProfile, load_device_profile
from hapticlod.errors import InputError
from hapticlod.shipped import shipped_config


@dataclass(frozen=True)
class HidDevice:
    """One HID node. `path`: /dev/hidraw3."""

    path: str
    vendor_id: int
    product_id: int
    usage_page: int
    usage: int
    manufacturer: str
    product: str
    serial: str

    @property
    def ids(self) -> str:
        """Vendor and product, as lsusb prints them."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}"


def list_devices() -> list[HidDevice]:
    """Every HID device the system lists; opens none."""
    import hidraw  # not at import time: it loads a system library

    return [
        HidDevice(
            path=entry["path"].decode(),
            vendor_id=entry["vendor_id"],
            product_id=entry["product_id"],
            usage_page=entry["usage_page"],
            usage=entry["usage"],
            manufacturer=entry["manufacturer_string"] or "",
            product=entry["product_string"] or "",
            serial=entry["serial_number"] or "",
        )
        for entry in hidraw.enumerate()
    ]


def shipped_profiles() -> list[tuple[Path, DeviceProfile]]:
    """The profiles that come with HapticLOD, by file name."""
    folder = shipped_config("devices/native.toml").parent
    return [(path, load_device_profile(path)) for path in sorted(folder.glob("*.toml"))]


def matches(device: HidDevice, profile: DeviceProfile) -> bool:
    """Whether the profile is for this device."""
    match = profile.device.match
    if match is None:
        return False
    return (
        (device.vendor_id, device.product_id) == (match.vendor_id, match.product_id)
        and match.usage_page in (None, device.usage_page)
        and match.usage in (None, device.usage)
        and match.product in device.product
        and match.serial in ("", device.serial)
    )


def find_device(profile: DeviceProfile, devices: Sequence[HidDevice], *, serial: str = "") -> HidDevice:
    """The one device that a profile is for.

    Raises:
        InputError: there is none, or there are several and `serial` does not choose one.
    """
    found = {d.path: d for d in devices if matches(d, profile) and serial in ("", d.serial)}
    match = profile.device.match
    if match is None:
        raise InputError(profile.device.name, "is simulated: there is nothing to open", "use hapticlod-station run")
    if not found:
        what = f"no device {match.vendor_id:04x}:{match.product_id:04x} ({profile.device.name}) is there"
        raise InputError("devices", what, "plug it in; hapticlod devices lists what is")
    if len(found) > 1:
        which = ", ".join(f"{d.path} serial {d.serial or 'none'}" for d in found.values())
        raise InputError("devices", f"{len(found)} devices match ({which})", "choose one with --serial")
    return next(iter(found.values()))


@contextmanager
def opened(device: HidDevice) -> Iterator[Any]:
    """The device, open for reading reports (`read(bytes, timeout_ms)`). Never writes.

    Raises:
        InputError: it cannot be opened, or it went away while it was read.
    """
    import hidraw

    handle = hidraw.device()
    try:
        handle.open_path(device.path.encode())
    except OSError:
        remedy = "install the udev rule of docs/devices.md and plug it in again, or run as root"
        raise InputError(device.path, "cannot be opened", remedy) from None
    try:
        yield handle
    except OSError as error:
        raise InputError(device.path, f"went away ({error})", "plug it in again and start over") from None
    finally:
        handle.close()
