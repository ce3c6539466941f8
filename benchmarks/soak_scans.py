"""`make soak-scans`: random hands on every scan, in the runtime with levels, each tick held against another's geometry.

    python -m benchmarks.soak_scans [--data FOLDER] [--only NAME ...] [--ticks 1e6] [--seed 0] [--out FILE]

Half of the ticks with a ball of 0.4 % of the scan's extent, half with one of 0.02 %, which stands for a point; speeds
to 1 m/s on a scan of 100 mm, in proportion on others. Wrong is: a ball nearer to a triangle than its radius, a way
through the surface (`benchmarks.path_check`), a number that is not finite, a force above the limit. One line per scan
as it is done, and JSON lines in OUT. Faults name seed and tick, so that they can be had again. Exit status 1 where
anything was wrong.
"""

import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import App, Parameter

from benchmarks.path_check import Judge
from benchmarks.scans_table import REPOSITORY, scans_of
from hapticlod.config import Level, LodConfig
from hapticlod.deviation import spread_points
from hapticlod.errors import InputError
from hapticlod.ladder import build_ladder
from hapticlod.layout import TICK_ERRORS
from hapticlod.motion import Motion
from hapticlod.replay import local_vertices, replay_levels, runtime_levels
from hapticlod.scan import Scan, load_scan
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import Tool, ball
from tuning.commands.tune import DEFAULT_STATION

CHUNK = 20_000  # ticks of one hand
RATIO = 100.0  # triangles of the finest level over those of the coarsest of three
BALLS_OF_EXTENT = (2e-4, 4e-3)
SKIN_OF_EXTENT = 4e-6  # docs/contact.md
BEGIN_ANEW = ("hip_jump", "start_inside", "contact_lost")
app = App(name="soak_scans")


@dataclass
class Tally:
    """What a soak of one scan saw."""

    scan: str
    triangles: int
    ticks: int = 0
    contacts: int = 0
    switches: int = 0
    lost: int = 0
    not_converged: int = 0
    judged: int = 0
    deepest_mm: float = 0.0
    faults: list[str] = field(default_factory=list)
    work: list[np.ndarray] = field(default_factory=list, repr=False)

    def line(self) -> dict[str, Any]:
        """As JSON types; work: triangles tested per tick."""
        work = np.concatenate(self.work)
        share = {name: float(np.quantile(work, q)) for name, q in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))}
        told = {k: v for k, v in self.__dict__.items() if k not in ("work", "faults")}
        return {**told, "faults": self.faults[:20], "wrong": len(self.faults), **share, "most": float(work.max())}


@app.default
def soak_scans_command(
    *,
    data: Path = REPOSITORY.parent / "shared" / "data",
    only: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    ticks: float = 1e6,
    seed: int = 0,
    out: Path = REPOSITORY / "build" / "soak_scans.jsonl",
) -> int:
    """Soak every scan that can be loaded, smallest first.

    Parameters
    ----------
    data
        The folder that holds dirty/ and meshes/.
    only
        Parts of file names; other scans are passed over.
    ticks
        Per scan.
    seed
        Of the first hand.
    out
        One line of JSON per scan is added to it.
    """
    station = load_station(shipped_config(DEFAULT_STATION))
    wrong = 0
    for path in sorted(scans_of(data), key=lambda path: path.stat().st_size):
        if only and not any(part in path.name for part in only):
            continue
        begun = time.monotonic()
        try:
            scan = load_scan(path, None)
        except InputError as refused:
            print(f"{path.name}: refused ({refused.what})", flush=True)
            continue
        tally = soak(scan, path.name, station, int(ticks), seed)
        told = tally.line() | {"seconds": round(time.monotonic() - begun, 1)}
        wrong += told["wrong"]
        with out.open("a") as stream:
            stream.write(json.dumps(told) + "\n")
        print(
            f"{path.name}: {tally.ticks} ticks, {tally.contacts} in contact, {tally.switches} switches, {tally.lost} "
            f"lost, {tally.not_converged} not converged, {tally.judged} steps judged, deepest "
            f"{1e3 * tally.deepest_mm:.2f} um; triangles tested: median {told['p50']:.0f}, p99.9 {told['p999']:.0f}, "
            f"most {told['most']:.0f}; {told['wrong']} wrong",
            flush=True,
        )
        for fault in tally.faults[:5]:
            print(f"    WRONG {fault}", flush=True)
    return int(wrong > 0)


def soak(scan: Scan, name: str, station: Station, ticks: int, seed: int) -> Tally:
    """So many ticks on one scan."""
    ladder = build_ladder(scan, rungs=3, coarsest_ratio=RATIO)
    size = scan.extent_mm / 100.0
    config = LodConfig(
        levels=tuple(
            Level(triangles=rung.triangles, cell_mm=4.0 * rung.mean_edge_mm, balls=1) for rung in ladder.rungs
        ),
        speeds_mm_s=tuple(s * size for s in (60.0, 250.0)[: len(ladder.rungs) - 1]),
        hysteresis=0.1,
        filter_hz=50.0,
        l_in_mm=max(10.0 * ladder.rungs[-1].rms_mm, 0.1 * size),
        l_out_mm=max(10.0 * ladder.rungs[-1].rms_mm, 0.1 * size),
    )
    station = station.adjusted(stiffness_n_mm=1.0 / size, max_slew_n_s=0.0)
    levels = runtime_levels(config, ladder)
    tally = Tally(name, scan.triangles)
    slack_mm = SKIN_OF_EXTENT * scan.extent_mm + 1e-6 * scan.extent_mm
    for share in BALLS_OF_EXTENT:
        radius_mm = share * scan.extent_mm
        tool = ball(radius_mm)
        judges = [
            Judge(local_vertices(rung, scan.centre_mm).astype(np.float64), rung.faces, radius_mm, slack_mm)
            for rung in ladder.rungs
        ]
        for hand, done in enumerate(range(0, ticks // 2, CHUNK), seed):
            motion = random_hand(scan, tool, hand, min(CHUNK, ticks // 2 - done))
            rows = replay_levels(levels, config, scan.centre_mm, motion, tool, station, 1, cut_short=False).rows
            _judge(tally, rows, judges, scan.centre_mm, f"{tool.name}, seed {hand}", station.max_force_n, slack_mm)
    return tally


def random_hand(scan: Scan, tool: Tool, seed: int, ticks: int) -> Motion:
    """Strokes between random places on and in the surface, taps, rests and leaps along it, up to 1 m/s per 100 mm."""
    rng = np.random.default_rng([11, seed])
    size = scan.extent_mm / 100.0
    places, face = spread_points(scan.vertices, scan.faces, 4096, seed)
    a, b, c = (scan.vertices[scan.faces[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    at = places[0] + normal[0] * (tool.reference_radius_mm + 5.0 * size)
    parts, left = [], ticks
    while left > 0:
        kind, pick = rng.random(), rng.integers(len(places))
        if kind < 0.6:  # to a place near by, a little into the surface
            near = rng.integers(len(places), size=64)
            pick = near[np.argmin(np.linalg.norm(places[near] - at, axis=1))]
        depth = rng.uniform(-1.0, 2.5) * size
        to = places[pick] - normal[pick] * (depth - tool.reference_radius_mm)
        if kind > 0.9:  # a rest, or a tap straight on
            to = at + rng.normal(0.0, 0.3, 3) * size
        speed = np.exp(rng.uniform(np.log(5.0), np.log(500.0))) * size  # peak: 1.9 times that
        count = min(left, max(2, int(np.linalg.norm(to - at) / speed * 1e3)))
        s = np.arange(1, count + 1) / count
        parts.append(at + (to - at) * (s**3 * (10.0 + s * (6.0 * s - 15.0)))[:, None])
        at, left = parts[-1][-1], left - count
    path = np.concatenate(parts)
    return Motion(np.arange(len(path)) / 1000.0, path, None, 1000.0, f"random {seed}", {})


def _judge(
    tally: Tally, rows: Any, judges: list[Judge], origin: np.ndarray, name: str, most_n: float, slack_mm: float
) -> None:
    scp = rows["scp_mm"] - origin
    contact, level, errors = rows["contact"] == 1, rows["level"], rows["errors"]
    tally.ticks += len(rows)
    tally.contacts += int(contact.sum())
    tally.switches += int(np.count_nonzero(np.diff(level)))
    tally.lost += int((errors >> TICK_ERRORS.index("contact_lost") & 1).sum())
    tally.not_converged += int((errors >> TICK_ERRORS.index("not_converged") & 1).sum())
    tally.work.append(rows["triangles"].astype(np.float64))
    finite = np.isfinite(scp).all(axis=1) & np.isfinite(rows["force_n"]).all(axis=1)
    if not finite.all():
        tally.faults.append(f"{name}, tick {int(np.argmin(finite))}: a number is not finite")
        return
    force = np.linalg.norm(rows["force_n"], axis=1)
    if (force > most_n * (1 + 1e-9)).any():
        tally.faults.append(f"{name}, tick {int(force.argmax())}: a force of {force.max():.3g} N")
    anew = np.zeros(len(rows), dtype=bool)
    for error in BEGIN_ANEW:
        anew |= (errors >> TICK_ERRORS.index(error) & 1).astype(bool)
    for number, judge in enumerate(judges):
        here = level == number
        clearance = judge.least_clearance_mm(scp[here & contact])
        tally.deepest_mm = max(tally.deepest_mm, -clearance)
        if clearance < -slack_mm:
            tally.faults.append(f"{name}, level {number}: penetrates by {-1e3 * clearance:.3g} um")
        steps = 1 + np.flatnonzero(here[1:] & here[:-1] & ~anew[1:] & (contact[1:] | contact[:-1]))
        tally.judged += len(steps)
        through = judge.through(scp, steps)
        tally.faults += [f"{name}, tick {t}, level {number}: through the surface" for t in through]


if __name__ == "__main__":
    sys.exit(app(result_action="return_value"))
