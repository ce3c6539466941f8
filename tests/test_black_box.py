"""What the tuner is held against: shares, penalties, and grids that are configurations."""

from types import SimpleNamespace

import numpy as np
import pytest
from surrogate_cases import made_space

import tuning.cli
from benchmarks import bench_tuners
from benchmarks.black_box import PENALTY, Trials, grid_configs, paper, random_search
from hapticlod.metrics import METRIC_KEYS
from hapticlod.station import Station
from tuning.baselines import one_level

STATION = Station(name="desk", loop_hz=1000.0, budget_us=100.0, memory_mb=50.0, stiffness_n_mm=1.0, max_force_n=10.0)


class Counting:
    """In place of a verifier: p99.9 is 1 us for every 1000 triangles of the finest level, felt error the inverse."""

    def __init__(self):
        self.tool = SimpleNamespace(balls=16)

    def measured(self, config):
        size = config.levels[0].triangles / 1000
        told = {"loop_cost_p999_us": size, "felt_error_jnd": 1 / size, "memory_mb": 1.0}
        return {**dict.fromkeys(METRIC_KEYS, 0.0), **told}


def ladder():
    def at(triangles):
        return SimpleNamespace(triangles=min(triangles, 100_000), mean_edge_mm=100 / np.sqrt(triangles))

    return SimpleNamespace(at=at, scan=SimpleNamespace(triangles=100_000), rungs=[at(100_000), at(2500)])


READY = SimpleNamespace(space=made_space(), ladder=ladder())


def trials(evaluations, seconds=0.0, budget_us=100.0):
    return Trials(Counting(), STATION.adjusted(budget_us=budget_us), evaluations, seconds)


def test_a_method_has_its_evaluations_and_its_time():
    made = trials(7)
    random_search(made, READY, [1, 2, 3], 0)
    assert len(made.made) == 7 and [len(e.config.levels) for e in made.made[:3]] == [1, 2, 3]
    longer = trials(1, seconds=0.2)
    random_search(longer, READY, [1], 0)
    assert len(longer.made) > 1 and longer.made[-1].after_s >= 0.2


def test_over_budget_costs_a_penalty_and_is_never_the_best():
    made = trials(0, budget_us=50.0)
    cheap, dear = (one_level(READY.ladder, made.verifier.tool, count, "") for count in (40_000, 100_000))
    assert made.score(cheap) == pytest.approx(1 / 40)
    assert made.score(dear) == pytest.approx(1 / 100 + PENALTY * np.log(2))
    assert [e.config.levels[0].triangles for e in made.best()] == [40_000]
    assert made.best(within_s=-1.0) == []


def test_the_grid_is_sizes_times_pairs_of_speeds():
    made = list(grid_configs(READY))
    assert len(made) == 6 * (1 + 15) and len({config.model_dump_json() for config in made}) == len(made)
    assert {len(config.levels) for config in made} == {1, 3}


def test_the_papers_is_one_measurement():
    made = trials(40)
    paper(made, READY, [1], 0)
    assert len(made.made) == 1 and made.made[0].config.mapping == "paper"


def test_regret_is_ours_less_the_least_of_all():
    ours = {"evaluations": 9, "best": 2.0, "chosen": 2.0}
    found = {"regret": 0.1, "regret_relative": 0.05, "methods": {"ours": ours}}
    assert (
        bench_tuners._verdict(found) == "regret 0.1000 (5.0 %) against the best of all, with 9 measured configurations"
    )
    refused = bench_tuners._verdict({**found, "methods": {"ours": {**ours, "chosen": 2.5}}})
    assert "the clock refused ours, so that tuning answered 2.5000" in refused
    assert "no regret" in bench_tuners._verdict({**found, "regret": None})


@pytest.mark.parametrize(
    ("options", "named"), [([], "SCAN"), (["--scan", "x.stl", "--evaluations", "0"], "EVALUATIONS")]
)
def test_what_cannot_be_compared(options, named, capsys):
    assert tuning.cli.run(options, bench_tuners.app) == 2
    assert capsys.readouterr().err.startswith(named)
