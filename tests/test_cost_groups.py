"""Costs sorted within groups of windows: nothing is lost, and the tail is exact."""

from __future__ import annotations

import numpy as np

from hapticlod.surrogate.cost import SINGLE_TICKS, group_samples, sample_sizes
from tuning.assemble import cost_groups
from tuning.grid import Clock


def test_samples_stand_for_every_tick_once() -> None:
    for ticks in (1, 7, 8, 9, 96, 512, 544):
        assert sample_sizes(ticks).sum() == ticks


def test_sum_and_dearest_ticks_are_kept() -> None:
    random = np.random.default_rng(0)
    cost, group = random.gamma(0.5, 1e4, (3, 2, 50 * 32)), random.permutation(np.arange(50) % 4)
    samples, sizes = group_samples(cost, group)
    np.testing.assert_allclose((samples * sizes).sum(axis=(-1, -2)), cost.sum(axis=-1))
    ticks = cost.reshape(3, 2, 50, 32)
    for number in range(4):
        own = -np.sort(-ticks[:, :, group == number].reshape(3, 2, -1), axis=-1)
        np.testing.assert_array_equal(samples[:, :, number, :SINGLE_TICKS], own[..., :SINGLE_TICKS])


def test_a_group_is_of_one_motion_and_of_like_speeds() -> None:
    random = np.random.default_rng(1)
    clock = Clock(loop_hz=1000.0, motion_ticks=(16 * 512, 8 * 512), ticks_per_bin=8)
    speed = np.exp(np.repeat(random.normal(3.0, 1.0, clock.ticks // 512), 512))
    group = cost_groups(np.stack([speed, 0 * speed, 0 * speed], axis=1), clock)
    windows = speed.reshape(-1, 32).mean(axis=1)
    assert group.max() + 1 == clock.ticks // 512
    for number in range(group.max() + 1):
        own = np.flatnonzero(group == number)
        assert np.all(own < 256) or np.all(own >= 256)
    between = np.var([windows[group == number].mean() for number in range(group.max() + 1)])
    assert between > 0.9 * np.var(windows)
