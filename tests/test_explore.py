"""How the tuner goes on when measurements contradict the surrogate: until the budget is held, or nothing helps."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hapticlod.config import Level, LodConfig
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from tuning.confirm import Clock, confirmed
from tuning.explain import agreement, refusal
from tuning.explore import CELLS, FINISH, MORE, MOST_AGAIN, MOST_MEASURED, RESCUES, ROUNDS, Candidate, explore
from tuning.search import Found

BUDGET_US = 600.0
OTHER_CELLS = [True] * len(CELLS)  # the best, measured with other cells: as dear here, and felt alike


class Optimist:
    """A surrogate that always fills the budget it is given."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def best(self, count: int, limits: Any, seed: int, warm: Any = None) -> Found:
        self.asked.append(limits.budget_us)
        predicted = {"loop_cost_p999_us": limits.budget_us}
        return Found(np.array([limits.budget_us, 1.0]), 1.0, 0.0, predicted)

    def best_of_each(self, counts: list[int], limits: Any, seed: int, near: Any) -> dict[int, Found]:
        return {count: self.best(count, limits, seed) for count in counts}


def explored(
    true_over_predicted: Any,
    counts: tuple[int, ...] = (1,),
    true_of_cells: Any = lambda factor: 1.0,
    search: Any = None,
    near: Any = None,
) -> tuple[list[Any], list[float]]:
    """The candidates of some level counts, measured at predicted times factors of the prediction and of the cells."""

    def measured(config: LodConfig) -> dict[str, float]:
        predicted_us = float(config.name)
        cost_us = predicted_us * true_over_predicted(predicted_us)
        felt = 600.0 / cost_us  # cells are not felt
        cost_us *= true_of_cells(config.levels[0].cell_mm)
        return {
            "loop_cost_p999_us": cost_us, "loop_cost_mean_us": 0.2 * cost_us, "memory_mb": 10.0,
            "felt_error_jnd": felt, "discontinuity_per_s": 0.0,
        }  # fmt: skip

    def config(x: np.ndarray, count: int, name: str) -> LodConfig:
        return LodConfig(name=str(x[0]), levels=(Level(triangles=1000, cell_mm=float(x[1]), balls=1),))

    search = search or Optimist()
    verifier: Any = SimpleNamespace(measured=measured)
    ready: Any = SimpleNamespace(space=SimpleNamespace(config=config, with_cells=lambda x, factor: x * [1.0, factor]))
    made = explore(
        search, verifier, ready, station(), counts, 0, lambda *stage: None,  # pyright: ignore[reportArgumentType]
        lambda config, metrics: metrics["felt_error_jnd"], near,
    )  # fmt: skip
    return made, search.asked


def station() -> Station:
    return load_station(shipped_config("stations/desktop_1khz.toml")).adjusted(budget_us=BUDGET_US)


def uses_its_budget(found: Candidate) -> bool:
    """To within 1.5 %."""
    return 0.985 * BUDGET_US < found.measured["loop_cost_p999_us"] <= BUDGET_US


def test_one_correction_is_enough_where_the_error_is_a_factor() -> None:
    made, asked = explored(lambda predicted_us: 3.0)
    assert [candidate.feasible for candidate in made] == [False, True, *OTHER_CELLS, True]
    assert asked[1] <= BUDGET_US / 3
    assert uses_its_budget(made[-1])


def test_goes_on_until_the_budget_is_held() -> None:
    """A tail that shrinks much more slowly than the surrogate believes: 930 us where it said 250 us, and so on."""
    made, asked = explored(lambda predicted_us: 900.0 * (predicted_us / BUDGET_US) ** 0.25 / predicted_us)
    held = [candidate.feasible for candidate in made].index(True)
    assert held >= 2
    assert all(later <= 0.95 * earlier + 1e-9 for earlier, later in pairwise(asked[: held + 1]))
    assert uses_its_budget(min((c for c in made if c.feasible), key=lambda c: c.objective))


def test_gives_up_where_nothing_helps() -> None:
    made, _ = explored(lambda predicted_us: 5000.0 / predicted_us)
    assert not any(candidate.feasible for candidate in made)
    # Nothing cheaper can be asked for: the last answer is the one before, and no more are wanted.
    assert 2 < len(made) < ROUNDS + RESCUES and made[-1].config == made[-2].config


@pytest.mark.parametrize("share", [0.3, 0.8, 1.3, 3.0])
def test_predicted_and_measured_agree_in_the_end(share: float) -> None:
    """The runtime costs a factor, which grows a little with the cost, of what the surrogate says."""
    made, _ = explored(lambda predicted_us: share * (predicted_us / BUDGET_US) ** 0.1)
    best = min((c for c in made if c.feasible), key=lambda c: c.objective)
    assert made[0].disagreement == pytest.approx(abs(1 / share - 1))
    assert best.disagreement is not None and best.disagreement < 0.05
    cost = best.measured["loop_cost_p999_us"]
    assert uses_its_budget(best)
    assert f"measured were {cost:.3g} us, {100 * best.disagreement:.1f} % apart" in agreement(best)
    assert agreement(replace(best, expected_us=None)) == ""


def test_a_tail_that_trembles_is_not_drawn_on() -> None:
    """Of three like configurations one is measured a fifth cheaper; what it costs then rises as predicted."""
    made, asked = explored(
        lambda predicted_us: 0.92 if predicted_us < 605.0 else 0.75 if predicted_us < 650.0 else 0.77
    )
    assert all(later <= MORE * earlier + 1e-9 for earlier, later in pairwise(asked))
    best = min((c for c in made if c.feasible), key=lambda c: c.objective)
    assert 0.95 * BUDGET_US < best.measured["loop_cost_p999_us"] <= BUDGET_US


@pytest.mark.parametrize("share", [0.96, 1.0])
def test_stops_where_they_agree(share: float) -> None:
    """Four per cent of the budget are worth one measurement more, beside those of other cells."""
    made, _ = explored(lambda predicted_us: share)
    assert len(made) - len(OTHER_CELLS) == (1 if share == 1.0 else 2)
    assert made[0].feasible and uses_its_budget(made[-1])


def test_a_level_that_is_predicted_to_do_nothing_is_not_measured() -> None:
    made, _ = explored(lambda predicted_us: 1.0, (1, 2, 3))
    assert {candidate.optimum.levels for candidate in made} == {1}


@pytest.mark.parametrize(("best", "gain"), [(0.8, 0.9), (1.25, 0.85)])
def test_cells_that_are_measured_cheaper_buy_feel(best: float, gain: float) -> None:
    """The surrogate knows nothing of it: the cost of one cell size is measured less, and spent on the rest."""
    made, asked = explored(lambda predicted_us: 1.0, true_of_cells=lambda factor: gain if factor == best else 1.0)
    plain, _ = explored(lambda predicted_us: 1.0)
    chosen, without = (min((c for c in all_ if c.feasible), key=lambda c: c.objective) for all_ in (made, plain))
    assert chosen.config.levels[0].cell_mm == best
    assert uses_its_budget(chosen)
    assert chosen.objective < (gain + 0.03) * without.objective
    assert max(asked) <= MORE * BUDGET_US


def trembling(predicted_us: float) -> float:
    """A tail by which no measurement tells of the next."""
    return 0.8 + 0.15 * np.sin(7.0 * predicted_us)


def test_so_many_are_measured_and_no_more() -> None:
    """Also where every level count is worth measuring, and no two measurements agree."""

    class Varied(Optimist):
        def best_of_each(self, counts: list[int], limits: Any, seed: int, near: Any) -> dict[int, Found]:
            return {k: replace(self.best(k, limits, seed), objective=1.0 - 0.01 * k) for k in counts}

    everywhere, _ = explored(trembling, (1, 2, 3, 4, 5), search=Varied())
    assert MOST_MEASURED <= len(everywhere) <= MOST_MEASURED + len(CELLS) + FINISH
    again, _ = explored(trembling, (1, 2), search=Varied(), near={1: np.zeros(2), 2: np.zeros(2)})
    assert 1 <= len(again) <= MOST_AGAIN
    assert not {c.config.levels[0].cell_mm for c in again} - {1.0}


def test_cells_are_not_tried_where_the_budget_does_not_bind() -> None:
    class Content(Optimist):
        def best(self, count: int, limits: Any, seed: int, warm: Any = None) -> Found:
            return replace(super().best(count, limits, seed, warm), predicted={"loop_cost_p999_us": 50.0})

    made, _ = explored(lambda predicted_us: 0.1, search=Content())
    assert len(made) == 1


def candidate(objective: float, cost_us: float) -> Candidate:
    metrics = {"loop_cost_p999_us": cost_us, "memory_mb": 10.0, "felt_error_jnd": objective}
    config = LodConfig(name=f"{objective:g}", levels=(Level(triangles=1000, cell_mm=1.0, balls=1),))
    return Candidate(config, {}, metrics, objective, cost_us <= BUDGET_US)


def asked_clock(times: dict[str, float], candidates: list[Candidate], most: int) -> tuple[str | None, list[str], float]:
    """Name of the first that holds by the clock, those that the clock was asked of, and the ratio learnt."""
    asked: list[str] = []

    def clocked(config: LodConfig, within_us: float) -> dict[str, float]:
        asked.append(config.name)
        return {"loop_cost_p999_us": times[config.name]}

    verifier: Any = SimpleNamespace(clocked=clocked)
    clock = Clock(verifier, station())
    found = clock.first(candidates, most)
    return None if found is None else found[0].config.name, asked, clock.ratio


def test_the_clock_has_the_last_word() -> None:
    """The best is over by counters, the next by the clock, by a tenth; the third, near the budget, need not ask."""
    four = [candidate(4, 300.0), candidate(2, 590.0), candidate(3, 560.0), candidate(1, 700.0)]
    name, asked, ratio = asked_clock({"2": 649.0, "4": 330.0}, four, 5)
    assert (name, asked) == ("4", ["2", "4"]) and ratio == pytest.approx(1.1)
    assert asked_clock({"2": 649.0}, four, 1) == (None, ["2"], pytest.approx(1.1))


@pytest.mark.parametrize(("cheap_us", "rounds"), [(330.0, 2), (510.0, 1)])
def test_what_the_clock_leaves_of_the_budget_is_used(cheap_us: float, rounds: int) -> None:
    """The clock says a tenth more than the counters. A poor candidate is not taken as long as a better may be had."""
    budgets: list[float] = []

    def search(allowed: Station, near: Any) -> list[Candidate]:
        budgets.append(allowed.budget_us)
        return [candidate(600.0 / (0.98 * allowed.budget_us), 0.98 * allowed.budget_us)]

    class Tenth:
        def clocked(self, config: LodConfig, within_us: float) -> dict[str, float]:
            cost_us = cheap_us if config.name == "7" else 600.0 / float(config.name)
            return {"loop_cost_p999_us": 1.1 * cost_us}

    verifier: Any = Tenth()
    candidates = [candidate(7.0, cheap_us)]
    found = confirmed(search, candidates, Clock(verifier, station()), station())
    assert budgets == pytest.approx([600.0, 0.98 * 600.0 / 1.1][:rounds], rel=1e-5)
    assert found is not None and (found[0].objective == 7.0) == (rounds == 1)
    assert found[1]["loop_cost_p999_us"] <= BUDGET_US


def test_what_the_clock_refused_is_told() -> None:
    chosen, better, over = candidate(3.0, 400.0), candidate(2.0, 590.0), candidate(1.0, 700.0)
    said = refusal(chosen, [over, chosen, better], 1.3, {"load_others_cores": 1.5}, station())
    assert "590 us), but the clock said up to 1.30 times" in said and "1.5 cores busy: tune again" in said
    assert "busy" not in refusal(chosen, [chosen, better], 1.3, {"load_others_cores": 0.1}, station())
    assert refusal(better, [over, chosen, better], 1.0, {}, station()) == ""
