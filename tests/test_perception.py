"""The shipped preset: the figures that PERCEPTION.md quotes come out of it."""

from pathlib import Path

import numpy as np
import pytest

from hapticlod.errors import InputError
from hapticlod.perception import load_perception
from hapticlod.shipped import shipped_config


def test_force_threshold_has_the_quoted_figures() -> None:
    threshold_mn = 1e3 * load_perception().force_threshold_n(np.array([10.0, 40.0, 100.0, 250.0, 400.0]))
    np.testing.assert_allclose(threshold_mn, [4, 13, 14, 28, 104], rtol=0.07)


def test_jnd_is_absolute_for_weak_and_relative_for_strong_forces() -> None:
    felt = load_perception()
    assert felt.jnd_n(0.0) == pytest.approx(0.04)
    assert felt.jnd_n(100.0) == pytest.approx(10.0, rel=1e-3)
    assert felt.jnd_n(0.4) == pytest.approx(0.04 * np.sqrt(2))


def test_share_and_notice() -> None:
    felt = load_perception()
    assert felt.felt_share(0.0) == 1.0
    assert felt.felt_share(felt.detail_mm * felt.felt_hz) == pytest.approx(0.5)
    assert felt.noticed(0.0) == 0.0 and felt.noticed(1.0) == pytest.approx(0.5) and felt.noticed(10.0) > 0.999


def test_jax_arrays_pass_through() -> None:
    jax = pytest.importorskip("jax")
    felt = load_perception()
    slope = jax.grad(lambda f: felt.jnd_n(f) + felt.felt_share(f) + felt.noticed(f) + felt.force_threshold_n(f))(50.0)
    assert np.isfinite(slope)


def test_faults_of_a_preset_are_named(tmp_path: Path) -> None:
    text = shipped_config("perception/default.toml").read_text()
    (tmp_path / "p.toml").write_text(text.replace("vibration_high_hz = 500.0", "vibration_high_hz = 5.0"))
    with pytest.raises(InputError, match=r"p\.toml:\d+:1: vibration_high_hz: must be above"):
        load_perception(tmp_path / "p.toml")
    (tmp_path / "p.toml").write_text(text.replace("weber = 0.10", "webber = 0.10"))
    with pytest.raises(InputError, match="did you mean weber"):
        load_perception(tmp_path / "p.toml")
