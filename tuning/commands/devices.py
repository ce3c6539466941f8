"""`hapticlod devices`: which devices are there, what they say, and recordings of a hand without forces."""

import json as writer
import sys
import time
from pathlib import Path

from rich.console import Console

from hapticlod.device_list import find_device, list_devices, matches, opened, shipped_profiles
from hapticlod.device_profile import DeviceProfile, load_device_profile
from hapticlod.device_recording import Sample, as_csv, samples
from hapticlod.errors import InputError
from hapticlod.files import write_atomic
from hapticlod.motion.recording import FEWEST_ROWS

MOST_SECONDS = 86400.0  # a motion's longest


def devices_command(
    *,
    profile: Path | None = None,
    serial: str = "",
    watch: bool = False,
    record: Path | None = None,
    seconds: float = 10.0,
    json: bool = False,
) -> None:
    """List HID devices and the profiles that know them; watch or record one of them. Never sends a force.

    Parameters
    ----------
    profile
        Device profile (TOML) to use besides the shipped ones; it is checked first.
    serial
        Serial number, where several devices match.
    watch
        Print position and report rate, ten times a second, until Ctrl-C.
    record
        Write a motion (CSV) that `hapticlod tune --motions` reads.
    seconds
        Length of the recording.
    json
        Print JSON.
    """
    if not 0 < seconds <= MOST_SECONDS:
        raise InputError("--seconds", f"is {seconds:g}", f"give a length above 0 and up to {MOST_SECONDS:g}")
    profiles = shipped_profiles() if profile is None else [(profile, load_device_profile(profile))]
    there = list_devices()
    if watch or record is not None:
        chosen = _only(profiles, serial)
        try:
            _follow(chosen, serial, watch, record, seconds)
        except KeyboardInterrupt:  # how watching ends; a recording that was cut short is not written
            if record is not None:
                raise
        finally:
            if watch:
                print()
        return
    rows = [
        {**vars(device), "profiles": [str(path) for path, known in profiles if matches(device, known)]}
        for device in there
    ]
    if json:
        print(writer.dumps(rows, indent=2))
        return
    out = Console(highlight=False, soft_wrap=True)
    if not rows:
        out.print("no HID device is there; the station's simulated one (--device sim) always is")
    for device, row in zip(there, rows, strict=True):
        name = " ".join(text for text in (device.manufacturer, device.product) if text)
        line = f"{device.path}  {device.ids}  usage {device.usage_page:04x}/{device.usage:04x}  {name}"
        out.print(f"{line}  serial {device.serial or 'none'}", markup=False)
        for path in row["profiles"]:
            out.print(f"    {path}", markup=False)


def _only(profiles: list[tuple[Path, DeviceProfile]], serial: str) -> DeviceProfile:
    """The profile whose device is there."""
    there = list_devices()
    able = [(path, p) for path, p in profiles if any(matches(d, p) and serial in ("", d.serial) for d in there)]
    if len(profiles) == 1:
        return profiles[0][1]
    if not able:
        raise InputError("devices", "no profile knows a device that is there", "plug it in, or name its --profile")
    if len(able) != 1:
        found = ", ".join(str(path) for path, _ in able)
        raise InputError(
            "devices", f"{len(able)} profiles know a device that is there ({found})", "choose with --profile"
        )
    return able[0][1]


def _follow(profile: DeviceProfile, serial: str, watch: bool, record: Path | None, seconds: float) -> None:
    device = find_device(profile, list_devices(), serial=serial)
    if record is not None and not record.absolute().parent.is_dir():  # said before the hand has moved, not after
        raise InputError(str(record), "lies in a folder that is not there", "choose one that exists")
    recorded: list[Sample] = []
    with opened(device) as handle:
        start = shown = time.monotonic()
        count = 0
        for sample in samples(handle, profile, device.path):
            count += 1
            if record is not None:
                recorded.append(sample)
            if watch and sample.host_s - shown >= 0.1:
                place = " ".join(f"{x:9.3f}" for x in sample.position_mm)
                rate = count / (sample.host_s - shown)
                sys.stdout.write(f"\r{place} mm  {rate:7.1f} reports/s  buttons {sample.buttons:04x}")
                sys.stdout.flush()
                shown, count = sample.host_s, 0
            if record is not None and sample.host_s - start >= seconds:
                break
    if record is not None:
        if len(recorded) < FEWEST_ROWS:
            raise InputError(str(record), f"only {len(recorded)} positions in {seconds:g} s", "record for longer")
        write_atomic(record, as_csv(recorded))
        Console(highlight=False).print(f"{record}: {len(recorded)} positions in {seconds:g} s")
