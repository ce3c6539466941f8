"""The static station against the dynamic one: size, start, and what its ticks cost on one bundle, run by turns.

Both render the same simulated hand in simulated time, so their ticks are the same ones; what they say of forces and
contact must be equal. Of the repeats the least is taken: the machine's other work only ever adds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parent.parent
PROGRAMS = {name: REPOSITORY / "build" / folder / "hapticlod-station" for name, folder in
            (("dynamic", "release"), ("static", "static"))}  # fmt: skip
SAME = ("ticks", "contact_share", "max_force_n", "switches", "mapping_hit", "mapping_miss", "stopped_by", "fault")
TIMES = ("loop_cost_mean_us", "loop_cost_p50_us", "loop_cost_p99_us", "loop_cost_p999_us")


def run(program: Path, bundle: Path, seconds: float) -> dict[str, Any]:
    """What the station says at the end."""
    words = [program, "run", bundle, "--device", "sim", "--virtual-time", "--seconds", f"{seconds:g}", "--json"]
    done = subprocess.run([*words, "--accept-unsigned"], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{program}: {done.stderr.strip()}")
    return json.loads(done.stdout.splitlines()[-1])


def start_ms(program: Path) -> float:
    """From being called to having said its version."""
    begun = time.perf_counter()
    subprocess.run([program, "--version"], capture_output=True, check=True)
    return 1e3 * (time.perf_counter() - begun)


def main() -> None:
    """Prints one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bundle", type=Path, required=True, help="what is rendered")
    parser.add_argument("--seconds", type=float, default=20.0, help="of simulated time, each repeat")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    for name, program in PROGRAMS.items():
        if not program.is_file():
            sys.exit(f"the {name} station: {program} is not there; make product station-static")
    least: dict[str, dict[str, float]] = {name: {} for name in PROGRAMS}
    said: dict[str, dict[str, Any]] = {}
    for _ in range(options.repeats):
        for name, program in PROGRAMS.items():
            said[name] = run(program, options.bundle, options.seconds)
            times = {key: said[name][key] for key in TIMES} | {"start_ms": start_ms(program)}
            least[name] = {key: min(value, least[name].get(key, value)) for key, value in times.items()}
    for key in SAME:
        if said["static"][key] != said["dynamic"][key]:
            sys.exit(f"{key}: {said['static'][key]} static, {said['dynamic'][key]} dynamic: they do not render alike")
    sizes = {name: program.stat().st_size / 1e6 for name, program in PROGRAMS.items()}
    print(f"{options.bundle.name}, {said['static']['ticks']} ticks, least of {options.repeats} runs by turns")
    print(f"{'':>20} {'dynamic':>9} {'static':>9} {'ratio':>6}")
    for key, row in {"size_mb": sizes, **{k: {n: least[n][k] for n in least} for k in ("start_ms", *TIMES)}}.items():
        print(f"{key:>20} {row['dynamic']:9.3f} {row['static']:9.3f} {row['static'] / row['dynamic']:6.2f}")


if __name__ == "__main__":
    main()
