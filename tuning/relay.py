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
from hapticlod.motion import Motion
from tuning.grid import Clock
from tuning.replays import MOST_RUNTIME_LEVELS, Bench, run, unreached_levels

# Long enough that a switch solves for the old place too, as every switch that is blended does.
_BLEND_MS = 20.0

Entries = dict[tuple[int, int], NDArray]


def relay_ladder(
    bench: Bench, levels: Sequence[Any], motions: Sequence[Motion], clock: Clock, l_mm: float, threads: int,
    done: Callable[[float], None], leaping: bool = False,
) -> tuple[Entries, dict[tuple[int, int], NDArray[np.bool_]]]:  # fmt: skip
    """Hands the level up and down the ladder, one rung per instant, or leaping over several.

    Args:
        levels: of all rungs.
        motions: cut to the clock.
        l_mm: mapping length, each side.
        threads: replays at once.
        done: told the share that is done.
        leaping: over about two fifths of the ladder at a time.

    Returns:
        By (rung, subset): rows of RECORD_DTYPE of the ticks that entered it, and whether they, or the ticks before,
        were in contact. Empty where the ladder has one rung only.
    """
    rungs, subsets = bench.grid.shape
    order = leaps(rungs) if leaping else list(range(rungs))
    stops = [(r, b) for b in range(subsets) for r in order]
    # Legs share their end stops, so that every step of the ladder is taken.
    size = MOST_RUNTIME_LEVELS - 1
    legs = [stops[i : i + size + 1] for i in range(0, max(len(stops) - 1, 1), size)]
    entries: dict[tuple[int, int], list[NDArray]] = {stop: [] for stop in stops}
    contacts: dict[tuple[int, int], list[NDArray[np.bool_]]] = {stop: [] for stop in stops}

    def go(leg: list[tuple[int, int]]) -> list[tuple[NDArray, NDArray[np.bool_]]]:
        config = unreached_levels(bench, bench.station, leg, l_mm, _BLEND_MS)
        renderer = bench.renderer([levels[r] for r, _ in leg], config)
        found = [_entered(renderer, motion, clock, len(leg)) for motion in motions]
        return [
            (np.concatenate([rows[k] for rows, _ in found]), np.concatenate([touched[k] for _, touched in found]))
            for k in range(len(leg))
        ]

    with ThreadPoolExecutor(threads) as pool:
        for count, (leg, parts) in enumerate(zip(legs, pool.map(go, legs), strict=True), 1):
            for stop, (rows, touched) in zip(leg, parts, strict=True):
                entries[stop].append(rows)
                contacts[stop].append(touched)
            done(count / len(legs))
    return (
        {stop: np.concatenate(parts) for stop, parts in entries.items()},
        {stop: np.concatenate(parts) for stop, parts in contacts.items()},
    )


def leaps(rungs: int) -> list[int]:
    """All rungs in an order in which neighbours are about two fifths of the ladder apart, or three."""
    stride = next((k for k in range(max(1, round(0.4 * rungs)), rungs) if math.gcd(k, rungs) == 1), 1)
    return [i * stride % rungs for i in range(rungs)]


def mean_step(order: Sequence[int], triangles: Sequence[int]) -> float:
    """Mean |ln N - ln N'| of rungs that follow each other; 0 where there is one only."""
    log = np.log(np.array(triangles, dtype=np.float64))[list(order)]
    return float(np.abs(np.diff(log)).mean()) if len(log) > 1 else 0.0


def _entered(renderer: Any, motion: Motion, clock: Clock, count: int) -> tuple[list[NDArray], list[NDArray[np.bool_]]]:
    """Rows and contacts of the ticks that entered each of `count` levels, in one motion."""
    up = np.arange(count)
    wave = np.concatenate([up, up[-2:0:-1]])
    turn = np.arange(motion.ticks) // clock.ticks_per_instant
    rows = run(renderer, motion, 1, wave[turn % len(wave)].astype(np.uint32))
    at = np.flatnonzero(np.diff(rows["level"].astype(np.int64))) + 1
    touched = (rows["contact"][at] | rows["contact"][at - 1]) == 1
    entered = rows["level"][at]
    picked = [entered == k for k in range(count)]
    return [rows[at[own]].astype(RECORD_DTYPE) for own in picked], [touched[own] for own in picked]
