"""A few of `make optimiser-cases`: the search against SLSQP with the same gradients, on made-up ladders."""

import jax
import pytest
from surrogate_cases import few_starts, made_measurement, made_space

from benchmarks.optimiser_cases import CLOSE, compared
from tuning.search import Search

pytestmark = pytest.mark.slow
BUDGETS_US = (200.0, 260.0, 400.0)


@pytest.mark.parametrize("seed", [0])
def test_reaches_what_slsqp_reaches(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    few_starts(monkeypatch)
    with jax.enable_x64(True):
        search = Search(made_measurement(seed), made_space(), 200.0)
    cases = list(compared("made up", search, made_space(), (1, 2), BUDGETS_US, 100.0, starts=2))
    assert len(cases) == len(BUDGETS_US)
    assert all(0.0 < case.ratio <= CLOSE for case in cases), cases
