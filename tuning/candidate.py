"""A configuration that was measured, and how it came to be."""

from __future__ import annotations

from dataclasses import dataclass

from hapticlod.config import LodConfig
from tuning.search import Found
from tuning.sensitivity import Optimum

COST = "loop_cost_p999_us"  # what the budget limits


@dataclass(frozen=True)
class Candidate:
    """A configuration with what was predicted of it and what was measured.

    `found`: its point, and `optimum`: of the search it came from, `correction`: what that search's budget was the
    station's times. `expected_us`: the predicted p99.9 cost, corrected by what had been measured before; None: nothing
    was predicted.
    """

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    objective: float
    feasible: bool
    optimum: Optimum | None = None
    expected_us: float | None = None
    found: Found | None = None
    correction: float = 1.0

    @property
    def disagreement(self) -> float | None:
        """By what part of itself the measured p99.9 cost misses what was expected; None: nothing was."""
        return None if self.expected_us is None else abs(self.expected_us / cost_us(self) - 1.0)

    @property
    def mispredicted(self) -> float:
        """Measured over predicted objective; 1 where none was predicted."""
        predicted = 0.0 if self.found is None else self.found.objective
        return self.objective / predicted if predicted > 0.0 else 1.0


def cost_us(candidate: Candidate) -> float:
    """What the budget limits, as measured."""
    return candidate.measured[COST]
