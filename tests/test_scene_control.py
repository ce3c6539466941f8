"""The control pipe of a running station: parts are hidden, shown and swapped under the tool, and the telemetry tells.

Nothing is timed: the test writes a command and waits until the force is what it must become.
"""

import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from plate_bundle import ORIGIN_MM, TEST_KEY, plate_config, plate_tool, run_station, station_program

from hapticlod import _runtime
from hapticlod.bundle import write_bundle
from hapticlod.motion.recording_mcap import recorded_ticks

DEPTH_MM = 0.5
STEP_N = 0.023  # by what the force differs from one step of the simulated encoder to the next, at 1 N/mm
PATIENCE_S = 60.0  # of a busy machine; a quiet one needs a few milliseconds


class Placed(NamedTuple):
    """What a bundle says of a part beside its levels."""

    name: str
    position_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    orientation: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    hidden: bool = False


def flat_plate(z_mm: float, from_x_mm: float) -> Any:
    """10 x 10 mm at this height, beginning at this x."""
    y, x = np.meshgrid(np.linspace(-5.0, 5.0, 7), np.linspace(0.0, 10.0, 7), indexing="ij")
    corner = (np.arange(6)[:, None] * 7 + np.arange(6)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 8], 1), np.stack([corner, corner + 8, corner + 7], 1)]
    )
    vertices = np.stack([x + from_x_mm, y, np.full_like(x, z_mm)], -1).reshape(-1, 3)
    return _runtime.Level(vertices.astype(np.float32), faces.astype(np.uint32), 2.0)


def write_plates(path: Path, plates: dict[str, Any], **more: Any) -> None:
    """A scene of one level, a part for each plate."""
    whole: Any = _runtime.SceneLevel(list(plates.values()), 2.0)
    parts = [Placed(name) for name in plates]
    config = plate_config([whole])
    config["loop_hz"] = 200.0  # so that a busy machine does not end the run as one that is too slow
    write_bundle(
        path, levels=[whole], config=config, tool=plate_tool(), manifest={}, parts=parts, **{"key": TEST_KEY, **more}
    )


class Running:
    """A station that presses the three balls half a millimetre into the plate at 0, until it is told to stop."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.pipe = folder, folder / "control"
        deepest = 0.3 - DEPTH_MM  # balls of 0.3 mm
        rows = [(0.0, 0.5), (0.1, 0.5), (0.4, deepest), (0.5, deepest), (600.0, deepest)]
        lines = [f"{t},0.0,0.0,{ORIGIN_MM[2] + z}" for t, z in rows]
        (folder / "press.csv").write_text("\n".join(["t_s,x_mm,y_mm,z_mm", *lines]) + "\n")
        command: list[object] = [station_program(), "run", folder / "scene.hlod", "--device", "sim", "--json"]
        command += ["--motion", folder / "press.csv", "--control", self.pipe, "--record", folder / "run.mcap"]
        self.said: list[str] = []
        self.errors = (folder / "said").open("w")
        self.process = subprocess.Popen(
            [str(word) for word in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
        )

    def wait(self, what: str, until: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not until():
            assert self.process.poll() is None, (self.folder / "said").read_text()
            assert time.monotonic() < end, f"{what} did not come: {self.status()}"
            time.sleep(0.02)

    def status(self) -> dict[str, Any]:
        done = run_station("status", "--pid", self.process.pid, "--once", "--json")
        return json.loads(done.stdout) if done.returncode == 0 else {"force_n": -1.0}

    def tell(self, line: str, answer: str) -> None:
        """Write one line into the pipe, and wait for what is said about it."""
        with self.pipe.open("w") as pipe:
            pipe.write(line + "\n")
        self.said.append(answer)
        self.wait(answer, lambda: [a for a in self.said if a not in (self.folder / "said").read_text()] == [])

    def force_becomes(self, least_n: float, most_n: float) -> None:
        self.wait(f"{least_n} to {most_n} N", lambda: least_n <= self.status()["force_n"] <= most_n)

    def force_at_rest(self) -> float:
        """Less than 1 N/mm, for the simulated hand yields like a spring; it may tremble by a step of the encoder."""
        seen = [0.0]

        def rests() -> bool:
            seen.append(self.status()["force_n"])
            return min(seen[-4:]) > 0.05 and np.ptp(seen[-4:]) < 2 * STEP_N

        self.wait("a force at rest", rests)
        return float(np.mean(seen[-4:]))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene of two plates, and bundles to swap one for: lower, a stranger's, too far away."""
    folder = tmp_path_factory.mktemp("scene")
    shelf = flat_plate(-0.4, 5.0)  # so that 0.3 mm below the floor still is within the scene
    write_plates(folder / "scene.hlod", {"floor": flat_plate(0.0, -5.0), "the shelf": shelf})
    write_plates(folder / "lower.hlod", {"floor": flat_plate(-0.3, -5.0), "other": shelf})
    write_plates(folder / "unsigned.hlod", {"floor": flat_plate(-0.3, -5.0)}, key=None)
    write_plates(folder / "away.hlod", {"floor": flat_plate(90.0, -5.0)})
    return folder


@pytest.fixture
def running(scene: Path) -> Iterator[Running]:
    station = Running(scene)
    try:
        yield station
    finally:
        station.process.kill()
        station.process.communicate()
        station.errors.close()


def test_parts_are_hidden_shown_and_swapped_under_the_tool(running: Running, scene: Path) -> None:
    running.wait("the pipe", running.pipe.is_fifo)
    pressed_n = running.force_at_rest()
    running.tell("hide floor", "floor: hidden")
    running.force_becomes(0.0, 0.0)
    running.tell("show floor", "floor: shown")
    running.force_becomes(pressed_n - 2 * STEP_N, pressed_n + 2 * STEP_N)
    running.tell("  hide   the shelf ", "the shelf: hidden")  # not touched
    running.tell(f"swap floor {scene / 'lower.hlod'}", f"floor: swapped for {scene / 'lower.hlod'}")
    running.force_becomes(0.01, 0.4 * pressed_n + STEP_N)  # two fifths as deep
    for line, answer in [
        ("drill floor", "control: 'drill floor' is no command; give hide PART, show PART or swap PART FILE.hlod"),
        ("hide roof", "control: there is no part 'roof'; inspect lists them"),
        ("swap floor", "control: swap needs a part and a bundle"),
        (f"swap floor {scene / 'nothing.hlod'}", "nothing.hlod: cannot be opened"),
        (f"swap floor {scene / 'unsigned.hlod'}", "unsigned.hlod: is not signed"),
        (f"swap floor {scene / 'away.hlod'}", "away.hlod: "),
        (f"swap the shelf {scene / 'lower.hlod'}", "lower.hlod: has no part 'the shelf'"),
    ]:
        running.tell(line, answer)
    running.force_becomes(0.01, 0.4 * pressed_n + STEP_N)  # as before
    running.process.send_signal(signal.SIGINT)
    out, _ = running.process.communicate(timeout=PATIENCE_S)
    assert running.process.returncode == 0, (scene / "said").read_text()
    report = json.loads(out.splitlines()[-1])
    assert report["state"] in ("RUN", "DEGRADED") and report["fault"] == "none"
    assert not running.pipe.exists()

    ticks = [tick for tick in recorded_ticks(scene / "run.mcap") if tick["fresh"]]
    places = ["nowhere" if not tick["contact"] else round(tick["scp_mm"]["z"] - ORIGIN_MM[2], 2) for tick in ticks]
    came = [place for i, place in enumerate(places) if place in ("nowhere", 0.3, 0.0) and places[i - 1 : i] != [place]]
    # Down onto the floor, in the air, on it again, down onto the lower one: within a tick or over several.
    down = ["nowhere", 0.3, "nowhere", 0.3]
    assert came in ([*down, 0.0], [*down, "nowhere", 0.0])
