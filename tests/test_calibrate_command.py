"""`hapticlod calibrate`: a station file that holds what this machine needs, and can be tuned for."""

from pathlib import Path

import pytest

import tuning.cli
from hapticlod.station import load_station
from tuning import course


@pytest.fixture
def short_course(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(course, "SIZES", (10_000, 20_000, 40_000))
    monkeypatch.setattr(course, "HELD_OUT_SIZE", 30_000)
    monkeypatch.setattr(course, "MODES", ("scan", "transfer"))
    monkeypatch.setattr(course, "REPEATS", 1)


@pytest.mark.usefixtures("short_course")
def test_writes_a_station_with_coefficients(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = tmp_path / "base.toml"
    base.write_text(
        'name = "lab"\nloop_hz = 500.0\nbudget_us = 900.0\nmemory_mb = 64.0\nstiffness_n_mm = 0.7\nmax_force_n = 3.0\n'
        'slowdown = 3.0\nslowdown_reason = "a guess"\n'
    )
    written = tmp_path / "station.toml"
    assert tuning.cli.run(["calibrate", "-o", str(written), "--station", str(base)]) == 0
    station = load_station(written)
    assert (station.name, station.loop_hz, station.stiffness_n_mm) == ("lab", 500.0, 0.7)
    # What was an assumption is now measured.
    assert station.slowdown == 1.0
    cost = station.cost
    assert cost is not None
    assert cost.test_ns > 0 and cost.base_ns + cost.iteration_ns + cost.cell_ns + cost.triangle_ns > 0
    assert cost.tail_p999 >= cost.tail_p99 >= 1.0
    assert cost.measured_on
    # A tick that does ten times the work costs about ten times as much: the fit is no constant.
    little = station.tick_cost_us(tests=100, triangles=200, cells=20, iterations=2, balls=2, level_bytes=1e6)
    much = station.tick_cost_us(tests=1000, triangles=2000, cells=200, iterations=20, balls=20, level_bytes=1e6)
    assert 3 < much / little < 10.001
    assert "left out of the fit" in capsys.readouterr().out


def test_nothing_is_measured_where_nothing_can_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tuning.cli.run(["calibrate", "-o", str(tmp_path / "missing" / "station.toml")]) == 2
    assert "does not exist; create it first" in capsys.readouterr().err
    assert tuning.cli.run(["calibrate", "-o", str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err
