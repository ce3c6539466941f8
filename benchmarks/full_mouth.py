"""The paper's full mouth (table 5: 5.3 M triangles in seven parts) as a scene: made, bundled, and run by the station.

    python -m benchmarks.full_mouth [--folder FOLDER] [--share 1.0] [--tune LEVELS] [--seconds 5] [--json OUT.json]

Each step is a process of its own, so that its memory is its own. Without --tune the bundle gets a fixed configuration
of three levels (all, a 20th, a 300th), which no tuner chose: memory, loading and the loop are the same matter, which
level is shown at which speed is not. --folder keeps the files, and goes on with those that are there.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from benchmarks.measured_process import Taken, run_measured
from hapticlod.shipped import shipped_config

STATION = Path(sys.executable).parent / "hapticlod-station"
TOOL, STATION_FILE = "tools/ball_1mm.toml", "stations/desktop_1khz.toml"
LIMIT_S = 7200.0
SHARES, SPEEDS_MM_S = (1.0, 1.0 / 20.0, 1.0 / 300.0), (60.0, 200.0)
LENGTH_FACTOR = 10.0  # of mapping, times the coarsest level's rms distance: as the soak over scans has it

app = App(help=__doc__, version_flags=[])


def measured(step: str, command: list[object], told: dict[str, Any]) -> Taken:
    """Run one step, and note what it took."""
    taken = run_measured([str(word) for word in command], LIMIT_S, {})
    if taken.status != 0:
        raise SystemExit(f"{step}: status {taken.status}: {taken.last_line}")
    told[step] = {
        "wall_s": round(taken.wall_s, 2),
        "processor_s": round(taken.processor_s, 2),
        "peak_mb": round(taken.peak_mb),
    }
    print(f"{step}: {told[step]}", flush=True)
    return taken


@app.command
def make(folder: Path, share: float) -> None:
    """Write the scans and the scene."""
    from benchmarks.full_mouth_parts import write_parts

    write_parts(folder, share)


@app.command
def bundle(scene_file: Path, path: Path) -> None:
    """Clean and simplify a scene, and bundle it with the fixed configuration and a golden motion."""
    from hapticlod.bundle import write_bundle
    from hapticlod.config import Level, LodConfig
    from hapticlod.motion.synthesise import synthesise
    from hapticlod.replay import replay_levels, runtime_levels
    from hapticlod.scene_file import load_scene
    from hapticlod.scene_ladder import ladder_of
    from hapticlod.station import load_station, load_tool

    scene = load_scene(scene_file)
    ladder = ladder_of(scene)
    rungs = [ladder.at(round(share * scene.triangles)) for share in SHARES]
    length_mm = LENGTH_FACTOR * rungs[-1].rms_mm
    config = LodConfig(
        levels=tuple(Level(triangles=rung.triangles, cell_mm=4.0 * rung.mean_edge_mm, balls=1) for rung in rungs),
        speeds_mm_s=SPEEDS_MM_S,
        hysteresis=0.1,
        l_in_mm=length_mm,
        l_out_mm=length_mm,
    )
    station, tool = load_station(shipped_config(STATION_FILE)), load_tool(shipped_config(TOOL))
    motion = synthesise(rungs[1], "scan", seconds=10.0, loop_hz=station.loop_hz, seed=0, tool=tool)
    levels = runtime_levels(config, ladder)
    record = replay_levels(levels, config, scene.centre_mm, motion, tool, station, 1)
    write_bundle(
        path,
        levels=levels,
        config=config.to_runtime(station, tool, scene.centre_mm),
        tool=tool,
        manifest={"scan": {"name": scene.name, "triangles": scene.triangles}, "notes": list(ladder.notes)},
        golden_motion=motion,
        golden_record=record.rows,
        parts=scene.parts,
    )


def measure(folder: Path, share: float, levels: str | None, seconds: float) -> dict[str, Any]:
    """Everything that is stated, in the order in which it happens."""
    this, told = [sys.executable, "-m", "benchmarks.full_mouth"], {}
    scene, path = folder / "full_mouth.toml", folder / ("full_mouth.hlod" if levels is None else "tuned.hlod")
    if not scene.exists():
        measured("generate", [*this, "make", folder, share], told)
    if not path.exists() and levels is None:
        measured("bundle", [*this, "bundle", scene, path], told)
    elif not path.exists():
        tune: list[object] = [sys.executable, "-m", "tuning.cli", "tune", scene, "-o", path, "--levels", levels]
        measured("tune", [*tune, "--tool", shipped_config(TOOL), "--json", folder / "tuned.json"], told)
    told["bundle_mb"] = round(path.stat().st_size / 1e6, 1)
    seen = json.loads(measured("inspect (reads all)", [STATION, "inspect", path, "--json"], told).out)
    told["parts"] = {part["name"]: [level["triangles"] for level in part["levels"]] for part in seen["parts"]}
    run: list[object] = [STATION, "run", path, "--device", "sim", "--accept-unsigned", "--json"]
    for step, word in (("run, first opening", "--check-all"), ("run", ""), ("run, known", "")):
        words = [*run, "--seconds", seconds, *([word] if word else [])]
        report = json.loads(measured(step, words, told).out.splitlines()[-1])
        kept = ("ticks", "contact_share", "switches", "over_budget", "checked_before", "state", "fault", "levels")
        told[step] |= {key: report[key] for key in kept if key in report}
        told[step] |= {key: round(value, 2) for key, value in report.items() if key.startswith("loop_cost_")}
    return told


@app.default
def main(
    *,
    folder: Path | None = None,
    share: float = 1.0,
    tune: Annotated[str | None, Parameter(help="numbers of levels to consider, as 1-3")] = None,
    seconds: float = 5.0,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
) -> None:
    """Measure, and say it."""
    with tempfile.TemporaryDirectory(prefix="full_mouth_") as temporary:
        place = folder or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        told = measure(place, share, tune, seconds)
    for name, value in told.items():
        print(f"{name:<20} {value}")
    if json_file is not None:
        json_file.write_text(json.dumps(told, indent=1))


if __name__ == "__main__":
    app()
