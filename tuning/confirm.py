"""The last word is the clock's: a configuration that holds the budget by its counters must hold it by time, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hapticlod.station import Station
from tuning.explore import Candidate, cost_us
from tuning.objective import holds
from tuning.verify import Verifier

# A level more must be worth this, JND: of two that feel alike the simpler is told.
LEVEL_WORTH = 1e-3


def merit(candidate: Candidate) -> float:
    """Smaller is better: the measured objective, and a trace of simplicity to settle ties."""
    return candidate.objective + LEVEL_WORTH * len(candidate.config.levels)


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
