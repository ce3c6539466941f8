"""The objective over a population of motions: in the surrogate, and by what was measured."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from surrogate_cases import few_starts, made_measurement, made_space

import tuning.cli
from hapticlod.config import Level, LodConfig
from hapticlod.errors import InputError
from hapticlod.surrogate.surrogate import predict_members
from tuning import population
from tuning.objective import disturbance
from tuning.population import check_over, measured_each, measured_over, over_motions
from tuning.search import Limits, Search
from tuning.space import decode

pytestmark = pytest.mark.slow
MOTIONS = 2
LIMITS = Limits(220.0, 100.0)
SPACE = made_space()


@pytest.fixture(scope="module")
def measured():
    with jax.enable_x64(True):
        return made_measurement()


@jax.jit
def look(measured, point, levels):
    return predict_members(measured, decode(point, levels), 200.0, 20.0, MOTIONS)


def members_of(measured, x, levels):
    """Felt error and jumps of both motions at x."""
    low, high = SPACE.log_bounds
    with jax.enable_x64(True):
        return look(measured, jnp.asarray(low + x * (high - low)), jnp.asarray(levels))


def test_motions_together_are_what_is_pooled(measured):
    """Squares of felt error and jumps, weighted by time in contact, sum to the pooled metrics."""
    metrics, members = members_of(measured, SPACE.sample(1, 3, 0)[0], 3)
    felt, jumps = np.asarray(members.felt_error_jnd), np.asarray(members.discontinuity_per_s)
    pooled, rate = float(metrics["felt_error_jnd"]), float(metrics["discontinuity_per_s"])
    assert felt.shape == jumps.shape == (MOTIONS,) and felt[0] != felt[1] and jumps.min() > 0
    # One share of contact explains both: solve for it by the squares, hold the rate against it.
    share = (pooled**2 - felt[1] ** 2) / (felt[0] ** 2 - felt[1] ** 2)
    assert 0.3 < share < 0.7
    assert share * jumps[0] + (1 - share) * jumps[1] == pytest.approx(rate, rel=1e-6)


def test_mean_and_worst():
    each = jnp.array([0.5, 2.0, 1.1])
    assert float(over_motions(each, False)) == pytest.approx(1.2)
    assert 2.0 <= float(over_motions(each, True)) < 2.03
    assert measured_over([0.5, 2.0, 1.1], "mean") == pytest.approx(1.2)
    assert measured_over([0.5, 2.0, 1.1], "worst") == 2.0


def test_the_search_serves_whom_it_is_asked_to_serve(measured, monkeypatch):
    """Of two optima from the same starts each is the best by its own measure."""
    few_starts(monkeypatch)
    found = {}
    for over in ("mean", "worst"):
        searched = Search(measured, SPACE, 200.0, over, MOTIONS)
        found[over] = min(searched.best_of_each([1, 2], LIMITS, 0).items(), key=lambda item: item[1].rank)
        assert found[over][1].excess <= 1e-3
    each = {}
    for over, (levels, best) in found.items():
        _, members = members_of(measured, best.x, levels)
        each[over] = np.asarray(disturbance(members.felt_error_jnd, members.discontinuity_per_s))
        assert best.objective == pytest.approx(float(over_motions(jnp.asarray(each[over]), over == "worst")), abs=0.02)
    assert each["mean"].mean() <= each["worst"].mean() + 0.02
    assert each["worst"].max() <= each["mean"].max() + 0.02


def test_measured_motions_are_measured_alone(monkeypatch):
    verifier = SimpleNamespace(key="", records=lambda config: ["a", "b"], reference=lambda: ["A", "B"])
    monkeypatch.setattr(population, "measure", lambda record, reference: {"pair": record + reference})
    config = LodConfig(levels=(Level(triangles=100, cell_mm=1.0),))
    assert measured_each(verifier, config) == [{"pair": "aA"}, {"pair": "bB"}]


def test_other_words_are_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="median"):
        check_over("median")
    assert tuning.cli.run(["tune", "x.stl", "-o", str(tmp_path / "x.hlod"), "--over", "median"]) == 2
    line = capsys.readouterr().err.strip()
    assert "--over" in line and len(line.splitlines()) == 1
