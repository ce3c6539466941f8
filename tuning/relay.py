"""What a switch costs: the hand's own motion, tick by tick, with the level handed on to the next at every instant.

A tour (`tuning.replays`) puts the hand where it wants to look; that makes its ticks dear. Here the hand moves as it
does on the station, only the level is changed for it, so a tick that enters a level costs what it will cost there.
The further apart two levels are, the further the tool has to move, so there are relays from rung to rung and relays
that leap over several.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticlod.layout import RECORD_DTYPE
from hapticlod.metrics import hand_speed_mm_s
from hapticlod.motion import Motion
from tuning.entries import Entered
from tuning.grid import Clock
from tuning.replays import MOST_RUNTIME_LEVELS, Bench, run, unreached_levels

# Long enough that a switch solves for the old place too, as every switch that is blended does.
_BLEND_MS = 20.0


def relay_ladder(
    bench: Bench, levels: Sequence[Any], motions: Sequence[Motion], clock: Clock, l_mm: float, threads: int,
    done: Callable[[float], None], leaping: bool = False,
) -> dict[tuple[int, int], Entered]:  # fmt: skip
    """Hands the level up and down the ladder, one rung per instant, or leaping over several.

    Args:
        levels: of all rungs.
        motions: cut to the clock.
        l_mm: mapping length, each side.
        threads: replays at once.
        done: told the share that is done.
        leaping: over about two fifths of the ladder at a time.

    Returns:
        By (rung, subset), the ticks that entered it. None where the ladder has one rung only.
    """
    rungs, subsets = bench.grid.shape
    order = leaps(rungs) if leaping else list(range(rungs))
    stops = [(r, b) for b in range(subsets) for r in order]
    # Legs share their end stops, so that every step of the ladder is taken.
    size = MOST_RUNTIME_LEVELS - 1
    legs = [stops[i : i + size + 1] for i in range(0, max(len(stops) - 1, 1), size)]
    entries: dict[tuple[int, int], list[Entered]] = {stop: [] for stop in stops}
    speeds = [hand_speed_mm_s(np.asarray(motion.position_mm), motion.loop_hz) for motion in motions]

    def go(leg: list[tuple[int, int]]) -> list[Entered]:
        config = unreached_levels(bench, bench.station, leg, l_mm, _BLEND_MS)
        renderer = bench.renderer([levels[r] for r, _ in leg], config)
        found = [_entered(renderer, *each, clock, len(leg)) for each in zip(motions, speeds, strict=True)]
        return [_joined(parts) for parts in zip(*found, strict=True)]

    with ThreadPoolExecutor(threads) as pool:
        for count, (leg, parts) in enumerate(zip(legs, pool.map(go, legs), strict=True), 1):
            for stop, part in zip(leg, parts, strict=True):
                entries[stop].append(part)
            done(count / len(legs))
    return {stop: _joined(parts) for stop, parts in entries.items()}


def _joined(parts: Sequence[Entered]) -> Entered:
    names = Entered.__dataclass_fields__
    return Entered(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def leaps(rungs: int) -> list[int]:
    """All rungs in an order in which neighbours are about two fifths of the ladder apart, or three."""
    stride = next((k for k in range(max(1, round(0.4 * rungs)), rungs) if math.gcd(k, rungs) == 1), 1)
    return [i * stride % rungs for i in range(rungs)]


def mean_step(order: Sequence[int], triangles: Sequence[int]) -> float:
    """Mean |ln N - ln N'| of rungs that follow each other; 0 where there is one only."""
    log = np.log(np.array(triangles, dtype=np.float64))[list(order)]
    return float(np.abs(np.diff(log)).mean()) if len(log) > 1 else 0.0


def _entered(renderer: Any, motion: Motion, speed_mm_s: NDArray, clock: Clock, count: int) -> list[Entered]:
    """The ticks that entered each of `count` levels, in one motion."""
    up = np.arange(count)
    wave = np.concatenate([up, up[-2:0:-1]])
    turn = np.arange(motion.ticks) // clock.ticks_per_instant
    rows = run(renderer, motion, 1, wave[turn % len(wave)].astype(np.uint32))
    at = np.flatnonzero(np.diff(rows["level"].astype(np.int64))) + 1
    touched = (rows["contact"][at] | rows["contact"][at - 1]) == 1
    entered = rows["level"][at]
    picked = [entered == k for k in range(count)]
    return [Entered(rows[at[own]].astype(RECORD_DTYPE), touched[own], speed_mm_s[at[own]]) for own in picked]
