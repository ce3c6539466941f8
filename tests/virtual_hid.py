"""A virtual force-feedback device behind the socket shim (runtime/tests/hidshim): real hidapi, no kernel, no hardware.

It speaks the native report of docs/devices.md in a thread of its own, with a firmware watchdog. Nothing here asserts
time: the test profile grants it whole tenths of a second, so that a busy machine is no fault of the station.
"""

import contextlib
import os
import selectors
import socket
import struct
import sys
import threading
import time
from binascii import crc_hqx
from pathlib import Path

import pytest
from plate_bundle import station_program

from hapticlod.shipped import shipped_config

REPORT = struct.Struct("<II3f3fHHI24x")


def shim_library() -> Path:
    """The built shim. Skips without one."""
    for folder in (station_program().resolve().parent, Path(__file__).resolve().parent.parent / "build" / "release"):
        if (folder / "tests" / "libhidshim.so").is_file():
            return folder / "tests" / "libhidshim.so"
    pytest.skip("libhidshim.so is not built: run make build")


def shim_environment(folder: Path) -> dict[str, str]:
    """Environment of a process that shall see the devices in `folder`."""
    return {**os.environ, "HIDSHIM": str(folder), "LD_PRELOAD": str(shim_library()), "XDG_STATE_HOME": str(folder)}


def patient_profile(folder: Path) -> Path:
    """The native profile for a device of 20 reports a second: silence is a fault after 0.6 s, not after 20 ms."""
    text = shipped_config("devices/native.toml").read_text()
    text = text.replace("rate_hz = 1000.0", "rate_hz = 20.0").replace("watchdog_ms = 20.0", "watchdog_ms = 300.0")
    text = text.replace("damping_n_s_mm = 0.002", "damping_n_s_mm = 0.02")
    text = text.replace("first_report_ms = 500.0", "first_report_ms = 9000.0")
    (folder / "patient.toml").write_text(text)
    return folder / "patient.toml"


class VirtualDevice:
    """A device that is plugged in as long as the `with` lasts. `force_n`: what its motors do now."""

    def __init__(self, folder: Path, name: str = "hidraw0", serial: str = "SIM1") -> None:
        self.place = folder / name
        self.serial = serial
        self.position_mm = (0.0, 0.0, 5.0)
        self.status = 1 << 4
        self.force_n = (0.0, 0.0, 0.0)
        self.enabled = False
        self.good_forces = self.bad_forces = 0
        self.tripped = 0
        self.watchdog_s = 0.0

    def __enter__(self) -> "VirtualDevice":
        self.place.mkdir()
        (self.place / "serial").write_text(self.serial)
        (self.place / "product").write_text("virtual stylus")
        self.listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.listening.bind(str(self.place / "socket"))
        self.listening.listen(8)
        self.listening.setblocking(False)
        self.running = True
        self.thread = threading.Thread(target=self._run)
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.running = False
        self.thread.join()
        self.listening.close()
        for file in self.place.iterdir():
            file.unlink()
        self.place.rmdir()

    def wait(self, condition: str, seconds: float = 30.0) -> None:
        """Until an expression over `self` holds; the test fails if it never does."""
        until = time.monotonic() + seconds
        while not eval(condition, {"self": self}):
            assert time.monotonic() < until, f"never: {condition} ({vars(self)})"
            time.sleep(0.005)

    def _run(self) -> None:
        handles: list[socket.socket] = []
        seq = echo = 0
        start = last_force = time.monotonic()
        with selectors.DefaultSelector() as selector:
            selector.register(self.listening, selectors.EVENT_READ)
            while self.running:
                for key, _ in selector.select(0.002):
                    if key.fileobj is self.listening:
                        handle, _ = self.listening.accept()
                        handle.setblocking(False)
                        handles.append(handle)
                        selector.register(handle, selectors.EVENT_READ)
                        continue
                    report = self._received(key.fileobj)
                    if report is None:
                        selector.unregister(key.fileobj)
                        handles.remove(key.fileobj)
                        key.fileobj.close()
                        continue
                    body = report[1:]
                    if len(report) != 65 or crc_hqx(body[:62], 0xFFFF) != struct.unpack_from("<H", body, 62)[0]:
                        self.bad_forces += 1
                        continue
                    echo, *force, flags, watchdog_ms = struct.unpack_from("<I3fHH", body)
                    self.force_n, self.enabled = tuple(force), bool(flags & 1)
                    self.good_forces += 1
                    self.watchdog_s = watchdog_ms / 1e3
                    self.status &= ~(1 << 3)
                    last_force = time.monotonic()
                now = time.monotonic()
                if self.watchdog_s and now - last_force > self.watchdog_s and not self.status & (1 << 3):
                    self.force_n, self.enabled = (0.0, 0.0, 0.0), False
                    self.status |= 1 << 3
                    self.tripped += 1
                seq += 1
                t_us = int((now - start) * 1e6) & 0xFFFFFFFF
                report = REPORT.pack(seq, t_us, *self.position_mm, 0.0, 0.0, 0.0, 0, self.status, echo)
                for handle in handles:
                    with contextlib.suppress(OSError):  # its queue is full, or it is gone: as on a wire
                        handle.send(report, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
        for handle in handles:
            handle.close()

    @staticmethod
    def _received(handle: socket.socket) -> bytes | None:
        try:
            return handle.recv(2048) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None


if __name__ == "__main__":  # by hand: python tests/virtual_hid.py FOLDER
    with VirtualDevice(Path(sys.argv[1])) as device:
        device.wait("False", 1e9)
