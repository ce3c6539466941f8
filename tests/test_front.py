"""The front of budget against feel: monotone, within its budgets, and no worse than optimising each budget alone."""

from itertools import pairwise
from pathlib import Path

import jax
import pytest
from rich.console import Console
from surrogate_cases import few_starts, made_measurement, made_space

import tuning
import tuning.cli
from hapticlod.config import Level, LodConfig
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station
from tuning.candidate import Candidate
from tuning.commands.pareto import front_table
from tuning.commands.tune import DEFAULT_STATION
from tuning.front import Front, FrontPoint, follow
from tuning.search import Limits, Search
from tuning.verified_front import best_of

pytestmark = pytest.mark.slow
BUDGETS_US = [60.0, 180.0, 220.0, 300.0, 600.0]
SPACE = made_space()


@pytest.fixture(scope="module")
def search():
    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patch:
        few_starts(patch)
        yield Search(made_measurement(), SPACE, 200.0)


@pytest.fixture(scope="module")
def front(search):
    return follow(search, SPACE, [1, 2], BUDGETS_US, 100.0, 0, lambda name, part: None)


def test_more_budget_is_never_worse(front):
    kept = [found for _, found in front if found.excess <= 1e-3]
    assert len(kept) == 4, "60 us are less than anything costs, the others are enough"
    values = [found.objective for found in kept]
    assert all(more <= less for less, more in pairwise(values))
    assert values[-1] < 0.9 * values[0]


def test_points_keep_their_budgets(front):
    for budget_us, (_, found) in list(zip(BUDGETS_US, front, strict=True))[1:]:
        assert found.predicted["loop_cost_p999_us"] <= budget_us * 1.001


def test_as_good_as_optimising_every_budget_alone(search, front):
    for budget_us, (_, found) in list(zip(BUDGETS_US, front, strict=True))[1:]:
        alone = search.best_of_each([1, 2], Limits(budget_us, 100.0), 0)
        assert found.objective <= 1.01 * min(each.objective for each in alone.values() if each.excess <= 1e-3)


def point(budget_us, measured=None):
    config = LodConfig(levels=(Level(triangles=100, cell_mm=1.0),))
    numbers = {"loop_cost_p999_us": 88.25, "felt_error_jnd": 1.5, "discontinuity_per_s": 0.0}
    holds = None if measured is None else measured <= budget_us
    told = None if measured is None else {**numbers, "loop_cost_p999_us": measured}
    return FrontPoint(budget_us, config, numbers, 1.5, True, -0.002, told, holds)


def test_the_table_fits_80_characters_and_marks_what_does_not_hold():
    console = Console(width=80, record=True, highlight=False)
    console.print(front_table(Front((point(1000.0, 123.4), point(90.0, 123.4)), {}), "tooth"))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 80 and "…" not in "".join(lines)
    rows = [line.split() for line in lines if "88.2" in line]
    assert [row[-1] for row in rows] == ["yes", "no"] and rows[0][-2] == "0.020"


def test_the_front_is_had_from_the_package():
    from tuning.front import pareto

    assert tuning.pareto is pareto
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = tuning.no_such_thing


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--budgets", "200,none"], "--budgets"),
        (["--budgets", "0,100"], "--budgets"),
        (["--budgets", "nan"], "--budgets"),
        (["--budgets", "200,2000"], "budget_us"),
        (["--budgets", "200", "--points", "3"], "--points"),
        (["--points", "0"], "--points"),
        (["--points", "1000"], "points"),
        (["--levels", "9"], "--levels"),
    ],
)
def test_what_cannot_be_asked_for(options, named, tmp_path: Path, capsys):
    scan = tmp_path / "tetrahedron.off"
    scan.write_text("OFF\n4 4 0\n0 0 0\n10 0 0\n0 10 0\n0 0 10\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n")
    assert tuning.cli.run(["pareto", str(scan), "-o", str(tmp_path / "front.json"), *options]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert named in line and "; " in line
    assert not (tmp_path / "front.json").exists()


def candidate(objective: float, cost_us: float) -> Candidate:
    metrics = {"loop_cost_p999_us": cost_us, "memory_mb": 1.0}
    return Candidate(point(100.0).config, {}, metrics, objective, True)


def test_what_was_measured_for_one_budget_serves_every_budget_that_it_holds():
    station = load_station(shipped_config(DEFAULT_STATION))
    made = [candidate(3.0, 90.0), candidate(2.0, 150.0), candidate(2.5, 190.0), candidate(1.0, 400.0)]
    found = [best_of(made, budget_us, station) for budget_us in (50.0, 100.0, 200.0, 500.0)]
    assert [(p.candidate.objective, p.holds) for p in found] == [(3.0, False), (3.0, True), (2.0, True), (1.0, True)]
