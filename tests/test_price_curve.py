"""Costs by size: what one price per counted thing gets wrong; and the part of the motions that shows the feel."""

from __future__ import annotations

import numpy as np

from hapticlod.motion import Motion
from tuning.assemble import felt_bins
from tuning.calibrate import NO_CURVE, price_curve
from tuning.grid import make_clock


def test_dear_ticks_get_a_price_of_their_own() -> None:
    """Time is 1.5 times what is counted for ticks beyond 100 us, with noise and a few interrupts."""
    random = np.random.default_rng(0)
    counted = np.exp(random.uniform(np.log(1e3), np.log(1e6), 20_000))
    time = counted * np.where(counted > 1e5, 1.5, 1.0) * np.exp(0.1 * random.normal(size=len(counted)))
    time[random.choice(len(time), 400)] *= 30.0
    curve = price_curve(time, counted)
    assert np.allclose(curve.factor(np.array([2e3, 2e4, 5e5, 1e9])), [1.0, 1.0, 1.5, 1.5], rtol=0.03)


def test_ticks_too_few_to_tell_change_nothing_but_the_mean() -> None:
    curve = price_curve(np.full(5, 300.0), np.full(5, 200.0))
    assert np.allclose(curve.factor(np.array([1.0, 1e6])), 1.5)
    assert np.array_equal(NO_CURVE.factor(np.array([0.0, 7.0])), [1.0, 1.0])


def test_a_busy_machine_is_not_priced_in() -> None:
    """Two thirds of the long ticks lose the processor, for as long as other programs want."""
    random = np.random.default_rng(1)
    counted = np.exp(random.uniform(np.log(1e6), np.log(4e6), 3000))
    time = counted * 1.2 * np.exp(0.05 * random.normal(size=len(counted)))
    lost = random.random(len(counted)) < 2 / 3
    time[lost] += random.uniform(1e6, 12e6, lost.sum())
    assert np.allclose(price_curve(time, counted).factor(np.array([1.5e6, 3e6])), 1.2, rtol=0.06)


def test_bins_of_a_part_lie_at_the_beginning_of_every_motion() -> None:
    motions = [Motion(np.arange(n) * 1e-3, np.zeros((n, 3)), None, 1000.0, "still", {}) for n in (700, 100, 1000)]
    whole, part = make_clock(motions), make_clock(motions, 0.3)
    assert whole.motion_ticks == (672, 96, 992) and part.motion_ticks == (288, 96, 288)
    bins = felt_bins(whole, part)
    assert len(bins) == part.bins
    assert np.array_equal(bins, [*range(36), *range(84, 96), *range(96, 132)])
    assert np.array_equal(felt_bins(whole, whole), np.arange(whole.bins))


def test_instants_are_thinned_but_cover_all_of_every_motion() -> None:
    motions = [Motion(np.arange(n) * 1e-3, np.zeros((n, 3)), None, 1000.0, "still", {}) for n in (700, 1000)]
    whole, thin = make_clock(motions), make_clock(motions, thinning=3)
    assert thin.ticks_per_instant == 3 * whole.ticks_per_instant == 96
    assert all(0 <= a - b < 96 for a, b in zip(whole.motion_ticks, thin.motion_ticks, strict=True))
    assert all(ticks % 96 == 0 for ticks in thin.motion_ticks)
    bins = felt_bins(whole, thin)
    assert np.array_equal(bins, [*range(84), *range(84, 84 + 120)])
    assert thin.marks(96).sum() == 2
