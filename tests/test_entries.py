"""What entering a level costs, by how fast the hand is: read from made entries whose prices are known."""

import numpy as np
import pytest

from hapticlod.surrogate.cost import SWITCH_SHARES
from tuning.entries import entry_costs, entry_speeds

POWER = 0.4  # made entries cost speed ** POWER


def _levels(random, count=4000, levels=6):
    for level in range(levels):
        speed = np.exp(random.uniform(np.log(2.0), np.log(300.0), count))
        yield 1e4 * 2.0**level * speed**POWER * np.exp(0.2 * random.normal(size=count)), speed


def test_faster_hands_pay_more_whatever_the_level_costs():
    speeds, factors = entry_speeds(list(_levels(np.random.default_rng(0))))
    assert factors.shape == (len(speeds), len(SWITCH_SHARES)) and np.all(np.diff(speeds) > 0)
    # Within a class costs spread by speed and by chance, among all entries by all speeds: medians show the power alone.
    middle = len(SWITCH_SHARES) // 4
    slope = np.polyfit(np.log(speeds), factors[:, middle], 1)[0]
    assert slope == pytest.approx(POWER, rel=0.1)


def test_where_speed_does_not_matter_nothing_is_added():
    random = np.random.default_rng(1)
    _, factors = entry_speeds([(cost / speed**POWER, speed) for cost, speed in _levels(random)])
    assert np.abs(factors[:, :-1]).max() < 0.03 and np.abs(factors[:, -1]).max() < 0.15  # the last: one in two hundred


@pytest.mark.parametrize("priced", [[], [(np.ones(4), np.ones(4))], [(np.ones(400), np.ones(400))]], ids=len)
def test_too_few_or_all_alike_say_nothing(priced):
    speeds, factors = entry_speeds(priced)
    assert np.all(np.diff(speeds) > 0) and not factors.any()


def test_a_hand_at_rest_has_a_price():
    random = np.random.default_rng(2)
    speeds, factors = entry_speeds([(cost, np.where(speed < 20.0, 0.0, speed)) for cost, speed in _levels(random)])
    assert np.isfinite(speeds).all() and np.isfinite(factors).all()


def test_entries_out_of_contact_are_apart():
    cost = np.concatenate([np.full(100, 5.0), np.full(100, 50.0)])
    in_contact, free = entry_costs(cost, cost > 10.0, np.ones(10))
    assert set(in_contact) == {50.0} and set(free) == {5.0}
    in_contact, free = entry_costs(np.zeros(0), np.zeros(0, bool), np.full(10, 7.0))
    assert set(in_contact) == set(free) == {7.0}
