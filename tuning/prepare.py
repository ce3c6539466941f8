"""From a scan, a tool and a station to a surrogate: ladder, motions, replays. All of it is kept between runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from hapticlod.errors import InputError
from hapticlod.ladder import Ladder
from hapticlod.motion import MODES, Motion
from hapticlod.perception import Perception, load_perception
from hapticlod.scan import Scan
from hapticlod.scene_ladder import ladder_of
from hapticlod.station import CostCoefficients, Station
from hapticlod.surrogate.measurement import LadderMeasurement
from hapticlod.tool import Tool
from tuning import kept
from tuning.assemble import LadderData, assemble
from tuning.calibrate import counted_cost_ns
from tuning.costing import Costing
from tuning.grid import Grid, make_clock, make_grid
from tuning.make_hands import Hand, make_hands
from tuning.recordings import seen_and_apart
from tuning.replays import MOST_RUNTIME_LEVELS, Bench, replay_fixed
from tuning.sample import sample_ladder, threads
from tuning.space import Space

Progress = Callable[[str, float], None]

# Seconds per mode of the surrogate's motions, and of those kept apart: the most that replays can afford, see _seconds.
SEEN_S = (24.0, 18.0, 12.0, 8.0, 6.0, 4.0, 2.5)
APART_S = (24.0, 18.0, 12.0, 8.0, 6.0, 3.0)
# Of the surrogate's motions, as many instants as so many seconds have show what a switch does, spread over all of each;
# and so many of the first seconds show what the loop pays for it.
SWITCH_S = (12.0, 6.0, 4.0, 2.5)
# What they may cost, s.
SEEN_REPLAY_S, APART_REPLAY_S, SWITCH_REPLAY_S = 14.0, 5.0, 6.0
# By what a present core (a virtual Xeon) needs: it decides how long motions are, so it must be the same everywhere.
_PRICES = CostCoefficients(
    base_ns=255, cell_ns=67, triangle_ns=4.7, test_ns=60, iteration_ns=99, ball_ns=92, mapping_cell_ns=0
)
_STROKE_S = 0.1  # to make a second of a stroke
_SWITCHED = 10.0  # cost of a replay that switches, in replays that stay on a level
_TOUR_MM = 4.0  # a tour's mapping length, in offsets between rungs


class Stages:
    """Times stages while it passes their progress on."""

    def __init__(self, told: Progress | None) -> None:
        self._told: Progress = told or (lambda name, part: None)
        self.seconds: dict[str, float] = {}
        self._name, self._since = "", 0.0

    def __call__(self, name: str, part: float) -> None:
        if name != self._name:
            self.close()
            self._name, self._since = name, time.monotonic()
        self._told(name, part)

    def close(self) -> None:
        """Ends the stage in progress."""
        if self._name:
            self.seconds[self._name] = self.seconds.get(self._name, 0.0) + time.monotonic() - self._since
        self._name = ""


@dataclass(frozen=True)
class Prepared:
    """What tuning works on.

    Attributes:
        ladder: of the scan.
        seen, apart: motions of the surrogate, and motions kept apart to judge it.
        data: what replays over `seen` gave. `costing`: how this machine's time becomes the station's.
        space: the box to search.
        measured: the surrogate's arrays, float64.
        key: of everything above.
    """

    ladder: Ladder
    seen: tuple[Motion, ...]
    apart: tuple[Motion, ...]
    data: LadderData
    costing: Costing
    space: Space
    measured: LadderMeasurement
    key: str


@dataclass(frozen=True)
class _Sampled:
    seen: tuple[Motion, ...]
    apart: tuple[Motion, ...]
    data: LadderData
    costing: Costing
    space: Space = field(repr=False)


def prepare(
    scan: Scan,
    station: Station,
    tool: Tool,
    motions: Sequence[Motion] | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
    perception: Perception | None = None,
    hands: float = 1.0,
    whole: bool = False,
) -> Prepared:
    """Ladder, motions, replays and the surrogate's arrays.

    Args:
        scan: cleaned.
        station: rate, stiffness and limits; cost coefficients of its own where it is another machine. Its budget and
            memory limit do not matter here.
        tool: 1 to 4096 balls.
        motions: recorded at the station's rate: parts of them make the surrogate, those in between judge it
            (`tuning.recordings`). None: strokes of all four modes, made on the scan.
        seed: of the motions.
        progress: told every stage's name and the part done.
        perception: preset; the shipped default where none is given.
        hands: motions that are made are so many times as long as tuning makes them.
        whole: recordings are cut in halves only, one motion each: for who asks what every motion is served like.

    Raises:
        InputError: motions that never touch, or are too short.
    """
    told: Progress = progress or (lambda name, part: None)
    felt = perception or load_perception()
    ladder_key = kept.key_of("ladder", scan.digest, kept.code_digest())
    ladder = kept.load("ladders", ladder_key)
    if ladder is None:
        pieces = kept.Pieces("ladder_pieces", ladder_key)
        ladder = ladder_of(scan, progress=told, keep=pieces)
        _ = ladder.rungs[-1].rms_mm
        kept.store("ladders", ladder_key, ladder)
        pieces.drop()
    given = tuple(motion.digest for motion in motions or ())
    untouched = station.model_copy(update={"budget_us": 1.0, "memory_mb": 1.0, "name": "", "slowdown_reason": ""})
    key = kept.key_of("samples", scan.digest, tool.digest, untouched.model_dump_json(), given, seed, repr(felt),
                      hands, whole, threads(), kept.code_digest())  # fmt: skip
    sampled = kept.load("samples", key)
    if sampled is None:
        sampled = _sampled(scan, ladder, station, tool, motions, seed, felt, told, hands, whole)
        kept.store("samples", key, sampled)
    told("build the surrogate", 0.0)
    with jax.enable_x64(True):
        measured = kept.load("assembled", key)
        if measured is None:
            measured = assemble(sampled.data, station.stiffness_n_mm, sampled.space.dwell_ms * 1e-3)
            kept.store("assembled", key, measured)
    costing = replace(sampled.costing, station=station)
    return Prepared(ladder, sampled.seen, sampled.apart, sampled.data, costing, sampled.space, measured, key)


def _sampled(
    scan: Scan, ladder: Ladder, station: Station, tool: Tool, motions: Sequence[Motion] | None, seed: int,
    perception: Perception, told: Progress, hands: float, whole: bool,
) -> _Sampled:  # fmt: skip
    told("prepare the motions", 0.0)
    grid = make_grid(ladder.rungs, tool)
    bench = Bench(ladder.rungs, scan.centre_mm, tool, station, grid)
    switch_s = math.inf
    if motions:
        seen, apart = seen_and_apart(scan, station, tool, motions, whole)
    else:
        seen, apart, switch_s = _made(scan, bench, station, tool, seed, hands)
    longest_s = max(motion.seconds for motion in seen)
    thinning = max(1, math.ceil(longest_s / switch_s - 1e-6))
    clock, felt_clock, relay_clock = make_clock(seen), make_clock(seen, thinning=thinning), make_clock(seen, switch_s)
    if min(clock.motion_ticks) == 0:
        window_s = clock.ticks_per_bin * clock.bins_per_window / clock.loop_hz
        raise InputError("motions", f"one is shorter than {2 * window_s:.3g} s", "give longer motions")
    offset_mm = max(ladder.rungs[-1].rms_mm, 1e-3 * ladder.rungs[0].mean_edge_mm)
    data, costing = sample_ladder(bench, seen, clock, felt_clock, relay_clock, perception, _TOUR_MM * offset_mm, told)
    return _Sampled(tuple(seen), tuple(apart), data, costing, make_space(grid, data, offset_mm))


def _made(
    scan: Scan, bench: Bench, station: Station, tool: Tool, seed: int, hands: float
) -> tuple[list[Motion], list[Motion], float]:
    """Strokes of all modes, `hands` times as long as this tool lets replays be; and how much shows switches, s."""

    def strokes(first: int, seconds: float) -> list[Hand]:
        return [Hand(mode, seconds, 1000 * seed + first + i) for i, mode in enumerate(MODES)]

    # Of one second of each mode, by its counters: a busy machine must not shorten the motions.
    pilot = make_hands(scan, station, tool, strokes(900, 1.0), 1)
    rungs, subsets = bench.grid.shape
    spent_s: list[float] = []
    for rung in (0, rungs // 2):
        level = bench.level(rung)
        for balls in (bench.grid.balls[0], bench.grid.balls[-1]):
            replays = replay_fixed(bench, level, rung, balls, pilot, 1)
            spent_s.append(1e-9 * sum(float(counted_cost_ns(rows, level.bytes, _PRICES).sum()) for rows in replays))
    mean_s = sum(spent_s) / len(spent_s)
    made_s = _STROKE_S * len(MODES)
    legs = -(-rungs * subsets // MOST_RUNTIME_LEVELS)
    seen_s = hands * _seconds(SEEN_S, (made_s + mean_s * rungs * subsets) / threads(), SEEN_REPLAY_S)
    apart_s = hands * _seconds(APART_S, (made_s + spent_s[0]) / threads(), APART_REPLAY_S)
    switch_s = hands * _seconds(SWITCH_S, mean_s * legs * _SWITCHED / threads(), SWITCH_REPLAY_S)
    made = make_hands(scan, station, tool, strokes(0, seen_s) + strokes(500, apart_s), threads())
    return made[: len(MODES)], made[len(MODES) :], switch_s


def _seconds(choices: Sequence[float], cost_per_s: float, most: float) -> float:
    """The longest of some lengths that costs at most so much; few choices, so that compiled code fits again."""
    return next((seconds for seconds in choices if seconds * cost_per_s <= most), choices[-1])


def make_space(grid: Grid, data: LadderData, offset_mm: float) -> Space:
    """Bounds from the ladder and from the hand: switching speeds where the hand is, mapping as far as rungs differ."""
    order = np.argsort(grid.triangles)
    raw = np.linalg.norm(data.reference.velocity_mm_s, axis=1)
    slow, fast = np.quantile(raw, [0.1, 0.999])
    slow = float(max(slow, 1.0))
    return Space(
        triangles=(float(grid.triangles[-1]), float(grid.triangles[0])),
        balls=(float(grid.balls[-1]), float(grid.balls[0])),
        edge_log_triangles=np.log(np.array(grid.triangles, dtype=np.float64))[order],
        edge_log_mm=np.log(np.array(grid.edge_mm))[order],
        speeds_mm_s=(slow, float(max(fast, 4.0 * slow))),
        l_mm=(offset_mm, 20.0 * offset_mm),
    )
