"""From a scan, a tool and a station to a surrogate: ladder, motions, replays. All of it is kept between runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property

import jax
import numpy as np

from hapticlod.errors import InputError
from hapticlod.ladder import Ladder, Rung
from hapticlod.motion import Motion
from hapticlod.perception import Perception, load_perception
from hapticlod.scan import Scan
from hapticlod.scene_ladder import ladder_of
from hapticlod.station import Station
from hapticlod.surrogate.measurement import LadderMeasurement
from hapticlod.tool import Tool
from tuning import kept
from tuning.assemble import LadderData, assemble
from tuning.costing import Costing
from tuning.grid import Grid, make_clock, make_grid
from tuning.own_hands import OwnHands
from tuning.recordings import seen_and_apart
from tuning.replays import Bench
from tuning.sample import sample_ladder, threads
from tuning.space import Space

Progress = Callable[[str, float], None]

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
        key: of everything above.
        progress: told when the surrogate is built.
    """

    ladder: Ladder
    seen: tuple[Motion, ...]
    apart: tuple[Motion, ...]
    data: LadderData
    costing: Costing
    space: Space
    key: str
    progress: Progress

    @cached_property
    def measured(self) -> LadderMeasurement:
        """The surrogate's arrays, float64: built when first asked for, since where the full scan fits nobody asks."""
        self.progress("build the surrogate", 0.0)
        with jax.enable_x64(True):
            measured = kept.load("assembled", self.key)
            if measured is None:
                measured = assemble(self.data, self.costing.station.stiffness_n_mm, self.space.dwell_ms * 1e-3)
                kept.store("assembled", self.key, measured)
        return measured


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
    """Ladder, motions and replays, of which the surrogate is built when it is asked for.

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
    given = tuple(motion.digest for motion in motions or ())
    untouched = station.model_copy(update={"budget_us": 1.0, "memory_mb": 1.0, "name": "", "slowdown_reason": ""})
    key = kept.key_of("samples", scan.digest, tool.digest, untouched.model_dump_json(), given, seed, repr(felt),
                      hands, whole, threads(), kept.code_digest())  # fmt: skip
    sampled = kept.load("samples", key)
    with ExitStack() as opened:
        own: list[OwnHands] = []

        def begin(rungs: Sequence[Rung]) -> None:
            """Hands are made while the ladder is measured."""
            if sampled is None and not motions:
                own.append(opened.enter_context(OwnHands(scan, rungs, station, tool, seed, hands)))

        ladder = _ladder(scan, told, begin)
        if sampled is None:
            told("prepare the motions", 0.0)
            switch_s = math.inf
            if motions:
                seen, apart = seen_and_apart(scan, station, tool, motions, whole)
            else:
                seen, apart = own[0].seen_and_apart()
                switch_s = own[0].switch_s
            sampled = _sampled(scan, ladder, station, tool, seen, apart, switch_s, felt, told)
            kept.store("samples", key, sampled)
    costing = replace(sampled.costing, station=station)
    return Prepared(ladder, sampled.seen, sampled.apart, sampled.data, costing, sampled.space, key, told)


def _ladder(scan: Scan, told: Progress, meshed: Callable[[Sequence[Rung]], None]) -> Ladder:
    """Kept, or made now; `meshed` is told its rungs as soon as they are there."""
    key = kept.key_of("ladder", scan.digest, kept.code_digest())
    ladder = kept.load("ladders", key)
    if ladder is not None:
        meshed(ladder.rungs)
        return ladder
    pieces = kept.Pieces("ladder_pieces", key)
    ladder = ladder_of(scan, progress=told, keep=pieces, meshed=meshed)
    _ = ladder.rungs[-1].rms_mm
    kept.store("ladders", key, ladder)
    pieces.drop()
    return ladder


def _sampled(
    scan: Scan, ladder: Ladder, station: Station, tool: Tool, seen: Sequence[Motion], apart: Sequence[Motion],
    switch_s: float, perception: Perception, told: Progress,
) -> _Sampled:  # fmt: skip
    grid = make_grid(ladder.rungs, tool)
    bench = Bench(ladder.rungs, scan.centre_mm, tool, station, grid)
    longest_s = max(motion.seconds for motion in seen)
    thinning = max(1, math.ceil(longest_s / switch_s - 1e-6))
    clock, felt_clock, relay_clock = make_clock(seen), make_clock(seen, thinning=thinning), make_clock(seen, switch_s)
    if min(clock.motion_ticks) == 0:
        window_s = clock.ticks_per_bin * clock.bins_per_window / clock.loop_hz
        raise InputError("motions", f"one is shorter than {2 * window_s:.3g} s", "give longer motions")
    offset_mm = max(ladder.rungs[-1].rms_mm, 1e-3 * ladder.rungs[0].mean_edge_mm)
    data, costing = sample_ladder(bench, seen, clock, felt_clock, relay_clock, perception, _TOUR_MM * offset_mm, told)
    return _Sampled(tuple(seen), tuple(apart), data, costing, make_space(grid, data, offset_mm))


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
