"""The hands that tuning makes where no motions are given: how long they are, and that they are made meanwhile."""

from __future__ import annotations

from collections.abc import Sequence

from hapticlod.ladder import Rung
from hapticlod.motion import MODES, Motion
from hapticlod.scan import Scan
from hapticlod.station import CostCoefficients, Station
from hapticlod.tool import Tool
from tuning.calibrate import counted_cost_ns
from tuning.grid import make_grid
from tuning.make_hands import Hand, Making, make_hands
from tuning.replays import MOST_RUNTIME_LEVELS, Bench, replay_fixed
from tuning.sample import threads

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


class OwnHands(Making):
    """Strokes of all modes, `hands` times as long as this tool lets replays be; further processes begin at once.

    Args:
        scan, rungs: the scan, and the meshes of its ladder; they need not be measured yet.
        station, tool: as in `tuning.prepare.prepare`.
        seed, hands: of the strokes; times as long as tuning makes them.

    Attributes:
        switch_s: how much of the surrogate's motions shows switches, s.
    """

    def __init__(
        self, scan: Scan, rungs: Sequence[Rung], station: Station, tool: Tool, seed: int, hands: float
    ) -> None:
        def strokes(first: int, seconds: float) -> list[Hand]:
            return [Hand(mode, seconds, 1000 * seed + first + i) for i, mode in enumerate(MODES)]

        # Of one second of each mode, by its counters: a busy machine must not shorten the motions.
        pilot = make_hands(scan, station, tool, strokes(900, 1.0), 1)
        bench = Bench(rungs, scan.centre_mm, tool, station, make_grid(rungs, tool))
        count, subsets = bench.grid.shape
        spent_s: list[float] = []
        for rung in (0, count // 2):
            level = bench.level(rung)
            for balls in (bench.grid.balls[0], bench.grid.balls[-1]):
                replays = replay_fixed(bench, level, rung, balls, pilot, 1)
                spent_s.append(1e-9 * sum(float(counted_cost_ns(rows, level.bytes, _PRICES).sum()) for rows in replays))
        mean_s = sum(spent_s) / len(spent_s)
        made_s = _STROKE_S * len(MODES)
        legs = -(-count * subsets // MOST_RUNTIME_LEVELS)
        seen_s = hands * _seconds(SEEN_S, (made_s + mean_s * count * subsets) / threads(), SEEN_REPLAY_S)
        apart_s = hands * _seconds(APART_S, (made_s + spent_s[0]) / threads(), APART_REPLAY_S)
        self.switch_s = hands * _seconds(SWITCH_S, mean_s * legs * _SWITCHED / threads(), SWITCH_REPLAY_S)
        super().__init__(scan, station, tool, strokes(0, seen_s) + strokes(500, apart_s), threads())

    def seen_and_apart(self) -> tuple[list[Motion], list[Motion]]:
        """The surrogate's motions, and those kept apart."""
        made = self.finish()
        return made[: len(MODES)], made[len(MODES) :]


def _seconds(choices: Sequence[float], cost_per_s: float, most: float) -> float:
    """The longest of some lengths that costs at most so much; few choices, so that compiled code fits again."""
    return next((seconds for seconds in choices if seconds * cost_per_s <= most), choices[-1])
