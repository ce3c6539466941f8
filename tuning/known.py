"""What searches on one surrogate have looked at and found, kept between runs: where another budget begins.

What a point costs and feels like does not depend on the budget, so what was found for one is a start for every other.
The same question gets the answer that it got before, whatever was asked in between: answers are kept, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tuning import kept

_MOST = 4000


@dataclass(frozen=True)
class Known:
    """A point: level count and x, its objective without the trace of cost, and what that and the limits rest on."""

    levels: int
    x: NDArray[np.float64]
    felt: float
    mean_us: float
    p999_us: float
    memory_mb: float

    @property
    def is_finite(self) -> bool:
        """Whether all its numbers are."""
        return bool(np.isfinite([self.felt, self.mean_us, self.p999_us, self.memory_mb]).all())


@dataclass
class KnownPoints:
    """Points and answers of one surrogate.

    Attributes:
        key: of the surrogate and of what the objective is taken over; empty: nothing is kept.
    """

    key: str
    _before: list[Known] = field(init=False)
    _new: list[Known] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self._before = (kept.load("searched", kept.key_of("searched", self.key)) or []) if self.key else []

    def add(self, known: Known) -> None:
        """For later runs: this one does not begin from what itself has found, unless it says so."""
        if known.is_finite:
            self._new.append(known)

    def best(self, counts: Sequence[int], promise: Callable[[Known], float]) -> dict[int, NDArray[np.float64]]:
        """By level count, the most promising first: x of the best point of an earlier run. Empty unless every level
        count was searched in one."""
        found: dict[int, NDArray[np.float64]] = {}
        for known in sorted(self._before, key=promise):
            if known.levels in counts:
                found.setdefault(known.levels, known.x)
        return found if set(found) == set(counts) else {}

    def answer(self, asked: Sequence[Any], find: Callable[[], Any]) -> Any:
        """What was answered before, or what `find` gives. `asked` says everything that the answer depends on."""
        if not self.key:
            return find()
        key = kept.key_of("answer", self.key, *asked)
        found = kept.load("answers", key)
        if found is None:
            found = find()
            kept.store("answers", key, found)
            kept.store("searched", kept.key_of("searched", self.key), [*self._before, *self._new][-_MOST:])
        return found
