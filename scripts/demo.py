"""`make demo`: the main job from nothing. Makes a scan, tunes it for a shaped burr, runs the result on the station.

Only the commands a user would type are used; everything lands in build/demo/.
"""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
FOLDER = Path("build/demo")
TRIANGLES = 290_000
LOOP_HZ = 1000
STATION_S = 5


def say(text: str) -> None:
    print(f"\n== {text}", flush=True)


def make_scan(path: Path) -> None:
    import trimesh

    from hapticlod.dentition import make_dentition

    scan = make_dentition(triangles=TRIANGLES, seed=0)
    trimesh.Trimesh(scan.vertices, scan.faces, process=False).export(path)
    print(f"{path}: {scan.triangles} triangles, {scan.extent_mm:.0f} mm across")


def call(*words: object, keep: bool = False) -> str:
    """Show and run one command; stop with its status when it fails. With `keep`, its output is shown and returned."""
    command = [str(word) for word in words]
    print("$ " + shlex.join(command), flush=True)
    program = REPOSITORY / ".venv/bin" / command[0]
    done = subprocess.run([program, *command[1:]], stdout=subprocess.PIPE if keep else None, text=True)
    if keep:
        print(done.stdout, end="", flush=True)
    if done.returncode:
        sys.exit(done.returncode)
    return done.stdout or ""


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    scan, bundle, result = (FOLDER / name for name in ("dentition.ply", "dentition.hlod", "dentition.json"))

    say("1. A scan like a dentist's: an arch of 14 teeth with pits of 0.1 mm and 8 um of scanner noise")
    make_scan(scan)

    say("2. A key: bundles are signed with it, and the station runs what it trusts. The demo's own, yours is untouched")
    os.environ["HAPTICLOD_CONFIG"] = str(FOLDER / "keys")
    if not (FOLDER / "keys/signing.key").exists():
        call("hapticlod", "key", "new", "--name", "demo")

    say("3. Tune its levels of detail for a flame burr (a union of some hundred balls) at 1 kHz")
    tool = "configs/tools/burr_flame.toml"
    call("hapticlod", "tune", scan, "--tool", tool, "--loop-hz", LOOP_HZ, "-o", bundle, "--json", result)

    say(f"4. Run the bundle for {STATION_S} s on the station, with a simulated device in the hand's place")
    output = call("hapticlod-station", "run", bundle, "--device", "sim", "--seconds", STATION_S, keep=True)
    run = json.loads(output.splitlines()[-1])

    say("What happened")
    tuned = json.loads(result.read_text())
    print(tuned["explanation"])
    print(
        f"The station made {run['ticks']} ticks: loop cost p99.9 {run['loop_cost_p999_us']:.0f} us, "
        f"{run['deadline_misses']} over the budget of {run['budget_us']:g} us, fault: {run['fault']}."
    )


if __name__ == "__main__":
    main()
