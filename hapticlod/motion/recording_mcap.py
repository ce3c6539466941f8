"""The station's recordings (MCAP, topic /station/tick): every tick's position, force and state."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hapticlod.errors import InputError

TOPIC = "/station/tick"


def recorded_ticks(path: str | Path) -> Iterator[dict[str, Any]]:
    """Messages of a recording, in time order, as the station wrote them (runtime/station/recorder.cpp).

    Raises:
        InputError: not MCAP, damaged, or not a recording of the station.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    found = False
    try:
        with Path(path).open("rb") as stream:
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(topics=[TOPIC]):
                if channel.message_encoding != "json":
                    continue
                found = True
                yield json.loads(message.data)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "give the path of a recording") from None
    except (McapError, ValueError, EOFError) as error:
        what = f"no whole MCAP file ({error})" if str(error) else "no whole MCAP file"
        raise InputError(str(path), what, "give a recording.mcap that the station finished writing") from None
    if not found:
        raise InputError(str(path), f"holds nothing on {TOPIC}", "give a recording of hapticlod-station run --record")


def motion_lines(path: str | Path) -> list[str]:
    """The hand's way in a recording as lines of a motion CSV: only ticks in which the device reported.

    Time is the device's clock, which the station's speed filter used too. A rejected reading repeats the last position.
    """
    rows = ["t_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    last = None
    for tick in recorded_ticks(path):
        now = tick["device_s"]
        if not tick["fresh"] or (last is not None and now <= last):
            continue
        last = now
        p, q = tick["position_mm"], tick["orientation"]
        values = (now, p["x"], p["y"], p["z"], q["w"], q["x"], q["y"], q["z"])
        rows.append(",".join(repr(float(value)) for value in values))
    return rows
