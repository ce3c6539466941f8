"""The last word is the clock's: a configuration that holds the budget by its counters must hold it by time, too."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from hapticlod.station import Station
from tuning.candidate import Candidate, cost_us
from tuning.correction import AGREE
from tuning.objective import holds
from tuning.verify import Verifier

# How often the search goes on with a smaller budget because the clock says more than the counters, and how many
# configurations that hold the budget by their counters are asked of the clock each time.
CLOCK_ROUNDS, ASKED = 3, 2
# A level more must be worth this, JND: of two that feel alike the simpler is told.
LEVEL_WORTH = 1e-3


Explore = Callable[[Station, Mapping[int, Candidate]], list[Candidate]]


def merit(candidate: Candidate) -> float:
    """Smaller is better: the measured objective, and a trace of simplicity to settle ties."""
    return candidate.objective + LEVEL_WORTH * len(candidate.config.levels)


def _promise(candidate: Candidate) -> tuple[bool, float]:
    return not candidate.feasible, candidate.objective


@dataclass
class Clock:
    """Asks the clock, and remembers by how much it once exceeded the counters.

    Attributes:
        verifier, station: what measures, and what must hold.
        ratio: the largest ratio of time to counted cost among configurations that were refused; at least 1. Who is
            over the budget by this ratio is not asked.
    """

    verifier: Verifier
    station: Station
    ratio: float = 1.0

    def first(self, candidates: Sequence[Candidate], most: int) -> tuple[Candidate, dict[str, float]] | None:
        """The best candidate that holds its limits by counters and by the clock, and the clock's figures.

        None: none of the `most` that were asked does.
        """
        asked = 0
        for candidate in sorted(candidates, key=merit):
            if not holds(candidate.measured, self.station):
                continue
            if cost_us(candidate) * self.ratio > self.station.budget_us:
                continue
            if asked == most:
                return None
            asked += 1
            said = self.verifier.clocked(candidate.config, self.station.budget_us)
            if said["loop_cost_p999_us"] <= self.station.budget_us:
                return candidate, said
            self.ratio = max(self.ratio, said["loop_cost_p999_us"] / cost_us(candidate))
        return None


def confirmed(
    explore: Explore, candidates: list[Candidate], clock: Clock, station: Station
) -> tuple[Candidate, dict[str, float]] | None:
    """Searches until the best that holds the budget by counters holds it by the clock, or uses what the clock leaves.

    What was measured is added to `candidates`. `explore` is told the station, with what the clock leaves of its budget,
    and where to begin, by level count. None: nothing holds.
    """
    near: dict[int, Candidate] = {}
    found = None
    for left in reversed(range(CLOCK_ROUNDS)):
        # Counters are right in proportion; where the clock says more, the best level counts are asked for less.
        ratio = clock.ratio
        candidates += explore(
            station if ratio == 1.0 else station.adjusted(budget_us=0.98 * station.budget_us / ratio), near
        )
        found = clock.first(candidates, ASKED if left else len(candidates))
        if clock.ratio == ratio:
            break
        if found is not None and cost_us(found[0]) * clock.ratio > (1.0 - 2.0 * AGREE) * station.budget_us:
            break
        searched = [c for c in candidates if c.optimum is not None]
        leaders = sorted(searched, key=_promise)[:ASKED]
        near = {c.optimum.levels: c for c in reversed(leaders) if c.optimum is not None}
    return found
