"""The part of a motion that is shown to other cell sizes: where single ticks ask most."""

import numpy as np
import pytest

from hapticlod.motion import Motion
from tuning.windows import dearest

TICKS, WINDOW = 2000, 272


def motion() -> Motion:
    at_mm = np.column_stack([np.arange(TICKS, dtype=float), np.zeros(TICKS), np.zeros(TICKS)])
    return Motion(np.arange(TICKS) / 1000.0, at_mm, None, 1000.0, "counted", {})


def rows(dear: dict[int, int]) -> np.ndarray:
    """All ticks ask 10 triangles and 5 tests, but for some."""
    made = np.zeros(TICKS + 500, dtype=[("triangles", np.uint32), ("tests", np.uint32)])
    made["triangles"], made["tests"] = 10, 5
    for tick, triangles in dear.items():
        made["triangles"][tick] = triangles
    return made


@pytest.mark.parametrize("tick", [3, 700, 1234, TICKS - 2])
def test_holds_the_dearest_tick(tick: int) -> None:
    # Many ticks that are a little dearer lie elsewhere; what lies beyond the motion's end does not count.
    part = dearest(motion(), rows({tick: 900, TICKS + 100: 10_000} | dict.fromkeys(range(400, 600), 20)), WINDOW)
    assert part.ticks == WINDOW
    assert tick in part.position_mm[:, 0]


def test_a_motion_that_is_shorter_is_taken_whole() -> None:
    assert dearest(motion().part(0.0, 0.1), rows({5: 100}), WINDOW).ticks == 100
