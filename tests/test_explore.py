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
from tuning.candidate import Candidate
from tuning.confirm import Clock, confirmed
from tuning.correction import MORE
from tuning.explain import agreement, refusal
from tuning.explore import MOST_AGAIN, MOST_IN_ALL, RESCUES, ROUNDS, explore
from tuning.search import Found

BUDGET_US = 600.0


class Optimist:
    """A surrogate that always fills the budget it is given, and believes that twice the cost is half the error."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def look(self, x: np.ndarray, count: int, limits: Any) -> Found:
        predicted = {"loop_cost_p999_us": float(x[0]), "memory_mb": 10.0}
        return Found(x, BUDGET_US / float(x[0]), 0.0, predicted)

    def glances(self, points: list[np.ndarray], count: int, limits: Any) -> list[Found]:
        return [self.look(x, count, limits) for x in points]

    def best(self, count: int, limits: Any, seed: int, warm: Any = None) -> Found:
        self.asked.append(limits.budget_us)
        return self.look(np.array([limits.budget_us, 1.0]), count, limits)

    def best_of_each(self, counts: list[int], limits: Any, seed: int, near: Any) -> dict[int, Found]:
        return {count: self.best(count, limits, seed) for count in counts}


class Indifferent(Optimist):
    """A surrogate that believes nothing to be gained near what it found."""

    def look(self, x: np.ndarray, count: int, limits: Any) -> Found:
        return replace(super().look(x, count, limits), objective=1.0)


def around(x: np.ndarray, count: int, points: int, random: np.random.Generator) -> list[np.ndarray]:
    """Other costs by a tenth, other cells by a quarter."""
    return list(x * np.exp([0.1, 0.25] * random.normal(size=(points, 2))))


def log_levels(x: np.ndarray, count: int) -> np.ndarray:
    """What costs more is taken to have more triangles."""
    return np.log([[x[0]], [1.0], [x[1]]])


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
    ready: Any = SimpleNamespace(space=SimpleNamespace(config=config, around=around, log_levels=log_levels))
    made = explore(
        search, verifier, ready, station(), counts, 0, lambda *stage: None,  # pyright: ignore[reportArgumentType]
        lambda config, metrics: metrics["felt_error_jnd"], near,
    )  # fmt: skip
    return made, search.asked


def best_of(made: list[Any]) -> Any:
    return min((c for c in made if c.feasible), key=lambda c: c.objective)


def station() -> Station:
    return load_station(shipped_config("stations/desktop_1khz.toml")).adjusted(budget_us=BUDGET_US)


def uses_its_budget(found: Candidate) -> bool:
    """To within 1.5 %."""
    return 0.985 * BUDGET_US < found.measured["loop_cost_p999_us"] <= BUDGET_US


def test_one_correction_is_enough_where_the_error_is_a_factor() -> None:
    made, asked = explored(lambda predicted_us: 3.0)
    assert [candidate.feasible for candidate in made[:2]] == [False, True]
    assert asked[1] <= BUDGET_US / 3 and len(asked) == 2  # the rest of the budget is used by trials, not by searches
    assert uses_its_budget(best_of(made))


def test_goes_on_until_the_budget_is_held() -> None:
    """A tail that shrinks much more slowly than the surrogate believes: 930 us where it said 250 us, and so on."""
    made, asked = explored(lambda predicted_us: 900.0 * (predicted_us / BUDGET_US) ** 0.25 / predicted_us)
    held = [candidate.feasible for candidate in made].index(True)
    assert held >= 2
    assert all(later <= 0.95 * earlier + 1e-9 for earlier, later in pairwise(asked[: held + 1]))
    assert uses_its_budget(best_of(made))


def test_gives_up_where_nothing_helps() -> None:
    made, _ = explored(lambda predicted_us: 5000.0 / predicted_us)
    assert not any(candidate.feasible for candidate in made)
    # Nothing cheaper can be asked for: the last answer is the one before, and no more are wanted.
    assert 2 < len(made) < ROUNDS + RESCUES and made[-1].config == made[-2].config


@pytest.mark.parametrize("share", [0.3, 0.8, 1.3, 3.0])
def test_predicted_and_measured_agree_in_the_end(share: float) -> None:
    """The runtime costs a factor, which grows a little with the cost, of what the surrogate says."""
    made, _ = explored(lambda predicted_us: share * (predicted_us / BUDGET_US) ** 0.1)
    best = best_of(made)
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
    best = best_of(made)
    assert 0.95 * BUDGET_US < best.measured["loop_cost_p999_us"] <= BUDGET_US


@pytest.mark.parametrize("share", [0.96, 1.0])
def test_stops_where_they_agree(share: float) -> None:
    plain, _ = explored(lambda predicted_us: share, search=Indifferent())
    assert len(plain) == 1
    made, asked = explored(lambda predicted_us: share)
    assert len(asked) == 1
    assert made[0].feasible and uses_its_budget(best_of(made))


def test_a_level_that_is_predicted_to_do_nothing_is_not_measured() -> None:
    made, _ = explored(lambda predicted_us: 1.0, (1, 2, 3))
    assert {candidate.optimum.levels for candidate in made} == {1}


def test_trials_use_what_is_left_of_the_budget() -> None:
    """Measured at 0.955 of the budget, it is near enough for the search: the rest is found near by."""
    plain, _ = explored(lambda predicted_us: 0.955, search=Indifferent())
    made, asked = explored(lambda predicted_us: 0.955)
    assert len(plain) == len(asked) == 1
    best = best_of(made)
    assert 0.98 * BUDGET_US < best.measured["loop_cost_p999_us"] <= BUDGET_US
    # Expected of a trial is what its prediction says by what was mispredicted before.
    assert best.disagreement is not None and best.disagreement < 0.01
    assert best.optimum is made[0].optimum and best.correction == made[0].correction


def test_trials_find_cells_that_are_measured_cheaper_and_spend_it() -> None:
    """The surrogate knows nothing of it."""
    made, _ = explored(lambda predicted_us: 1.0, true_of_cells=lambda cell: 0.85 if cell < 0.9 else 1.0)
    plain, _ = explored(lambda predicted_us: 1.0)
    assert best_of(made).objective < 0.95 * best_of(plain).objective
    assert best_of(made).config.levels[0].cell_mm < 0.9


def test_a_level_count_that_promises_no_more_is_measured_once() -> None:
    """Predicted a little better, it is measured as much worse than predicted as the one before."""

    class Close(Indifferent):
        def look(self, x: np.ndarray, count: int, limits: Any) -> Found:
            return replace(super().look(x, count, limits), objective=1.0 + 0.01 * count)

    made, _ = explored(lambda predicted_us: 1.6, (1, 2, 3), search=Close())
    counted = [c.optimum.levels for c in made]
    assert counted.count(1) > 1 and counted.count(2) == counted.count(3) == 1


def test_levels_that_only_pay_where_the_full_scan_does_not_fit_are_measured() -> None:
    """It is believed to fit, so that further levels seem of no use; the runtime costs half as much again."""

    class Content(Optimist):
        def look(self, x: np.ndarray, count: int, limits: Any) -> Found:
            cost_us = min(float(x[0]), 500.0)
            found = super().look(np.array([cost_us, 1.0]), count, limits)
            felt = 0.0 if cost_us == 500.0 else (2.0 - cost_us / 500.0) / count
            return replace(found, objective=felt + 1e-6 * cost_us)

    made, asked = explored(lambda predicted_us: 1.5, (1, 2), search=Content())
    assert made[0].optimum.levels == 1 and not made[0].feasible
    assert {candidate.optimum.levels for candidate in made} == {1, 2}
    # Both are searched again with what costs are known to be.
    first_of_two = next(candidate for candidate in made if candidate.optimum.levels == 2)
    assert first_of_two.correction < 0.75 and asked.count(first_of_two.correction * BUDGET_US) >= 2


def trembling(predicted_us: float) -> float:
    """A tail by which no measurement tells of the next."""
    return 0.8 + 0.15 * np.sin(7.0 * predicted_us)


def test_so_many_are_measured_and_no_more() -> None:
    """Also where every level count is worth measuring, and no two measurements agree."""

    class Varied(Optimist):
        def look(self, x: np.ndarray, count: int, limits: Any) -> Found:
            found = super().look(x, count, limits)
            return replace(found, objective=found.objective * 0.95**count)

    everywhere, _ = explored(trembling, (1, 2, 3, 4, 5), search=Varied())
    assert 10 <= len(everywhere) <= MOST_IN_ALL
    near = {count: replace(everywhere[0], optimum=replace(everywhere[0].optimum, levels=count)) for count in (1, 2)}
    again, _ = explored(trembling, (1, 2), search=Varied(), near=near)
    assert 1 <= len(again) <= MOST_AGAIN


def test_a_search_that_goes_on_asks_for_what_the_earlier_learnt() -> None:
    """The runtime costs half as much again as the surrogate says: the earlier search found out."""
    made, _ = explored(lambda predicted_us: 1.5)
    best = best_of(made)
    again, asked = explored(lambda predicted_us: 1.5, near={1: best})
    assert len(again) <= MOST_AGAIN and uses_its_budget(best_of(again))
    assert again[0].feasible and asked[-1] == pytest.approx(best.correction * BUDGET_US)


def test_where_the_budget_does_not_bind_one_measurement_is_enough() -> None:
    class Content(Indifferent):
        def best(self, count: int, limits: Any, seed: int, warm: Any = None) -> Found:
            return replace(super().best(count, limits, seed), predicted={"loop_cost_p999_us": 50.0, "memory_mb": 10.0})

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
