"""Stations: consistency rules, predicted cost, shipped files."""

from pathlib import Path

import numpy as np
import pytest

from hapticlod.errors import InputError
from hapticlod.station import CostCoefficients, Station, load_station
from hapticlod.toml import parse_toml, save_toml

CONFIGS = Path(__file__).parents[1] / "configs"
SHIPPED = sorted((CONFIGS / "stations").glob("*.toml"))
MINIMAL = """name = "s"
loop_hz = 1000.0
budget_us = 600.0
memory_mb = 100.0
stiffness_n_mm = 1.0
max_force_n = 3.3
"""
COST = CostCoefficients(base_ns=50, cell_ns=2, triangle_ns=3, test_ns=5, iteration_ns=7, ball_ns=11, mapping_cell_ns=13)


def fault(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_toml(text, Station, "s.toml")
    return f"{caught.value.where}: {caught.value.what}"


def test_shipped_stations_are_there() -> None:
    assert {path.stem for path in SHIPPED} >= {"desktop_1khz", "desktop_4khz", "whatif_slow"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_station_loads_and_survives_saving(path: Path, tmp_path: Path) -> None:
    station = load_station(path)
    save_toml(tmp_path / "again.toml", station)
    assert load_station(tmp_path / "again.toml") == station


def test_a_slowdown_must_say_what_it_assumes() -> None:
    assert load_station(CONFIGS / "stations" / "whatif_slow.toml").slowdown_reason.startswith("assumed")
    assert fault(MINIMAL + "slowdown = 5.0") == (
        "s.toml:7:1: slowdown: is an assumption: say in slowdown_reason what it rests on"
    )


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("600.0", "1001.0"), "s.toml:3:1: budget_us: exceeds the loop period of 1000 us at 1000 Hz"),
        (("600.0", "0"), "s.toml:3:1: budget_us: input should be greater than 0 (got 0)"),
        (("loop_hz", "loophz"), "s.toml:2:1: loophz: unknown key; did you mean loop_hz?"),
        (("3.3", "3.3\nfriction_dynamic = 0.1"), "s.toml:7:1: friction_dynamic: must not exceed friction_static"),
    ],
)
def test_faults_point_at_the_entry(change: tuple[str, str], expected: str) -> None:
    assert fault(MINIMAL.replace(*change)) == expected


def test_stiffness_is_held_below_the_stability_limit() -> None:
    # Gil and Hulin: (b + B) / (T/2 + t_d) = (0.0005 + 0.0005) / (0.0005 + 0.0005) = 1 N/mm
    text = MINIMAL + "device_damping_n_s_mm = 0.0005\ndamping_n_s_mm = 0.0005\ndelay_ms = 0.5\n"
    assert fault(text) == "s.toml:5:1: stiffness_n_mm: not below the stability limit of 1 N/mm"
    station = parse_toml(text.replace("stiffness_n_mm = 1.0", "stiffness_n_mm = 0.999"), Station)
    assert station.stable_stiffness_n_mm == pytest.approx(1.0)
    assert parse_toml(MINIMAL, Station).stable_stiffness_n_mm is None


def test_cost_is_counters_times_coefficients() -> None:
    counters = {
        "cells": 1,
        "triangles": 10,
        "tests": 100,
        "iterations": 1000,
        "balls": 10_000,
        "mapping_cells": 100_000,
    }
    assert COST.tick_cost_ns(**counters) == 50 + 2 + 30 + 500 + 7000 + 110_000 + 1_300_000
    assert COST.tick_cost_ns() == 50
    # Of four balls three are turned besides the first, and three tests of four belong to another ball than the last.
    union = COST.model_copy(update={"carried_ball_ns": 7.0, "union_test_ns": 4.0})
    assert union.tick_cost_ns(tests=100, level_balls=4) == 50 + 3 * 7 + 100 * (5 + 3)
    assert union.tick_cost_ns(**counters) == COST.tick_cost_ns(**counters)
    half_paid = COST.model_copy(update={"cache_mb": 8.0, "cache_gain": 1.0})
    assert half_paid.tick_cost_ns(cells=1, level_bytes=8e6) == pytest.approx(50 + 2 * 1.5)
    assert half_paid.tick_cost_ns(cells=1, level_bytes=8e12) == pytest.approx(50 + 2 * 2, rel=1e-5)
    many = COST.tick_cost_ns(cells=np.array([0.0, 1.0]))
    np.testing.assert_array_equal(many, [50, 52])


def test_slowdown_multiplies_all_of_the_cost() -> None:
    station = parse_toml(MINIMAL, Station).adjusted(cost=COST)
    slow = station.adjusted(slowdown=20.0, slowdown_reason="assumed")
    assert station.tick_cost_us(cells=1) == pytest.approx(0.052)
    assert slow.tick_cost_us(cells=1) == pytest.approx(20 * 0.052)
    with pytest.raises(ValueError, match="calibrate"):
        parse_toml(MINIMAL, Station).tick_cost_us(cells=1)


def test_another_rate_keeps_the_budgets_share_of_the_period() -> None:
    station = parse_toml(MINIMAL, Station)
    assert station.adjusted(loop_hz=4000.0).budget_us == pytest.approx(150.0)
    assert station.adjusted(loop_hz=4000.0, budget_us=200.0).budget_us == 200.0
    for wrong in ({"budget_us": 1e9}, {"budget_us": 0.0}, {"loop_hz": 0.0}, {"loop_hz": float("nan")}):
        with pytest.raises(InputError, match="station s: "):
            station.adjusted(**wrong)
