"""Soft triggers against the runtime's state machine, filter against recurrence, gradients against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapticlod.surrogate.switching import affine_scan, filtered_speed_mm_s
from hapticlod.surrogate.switching import soft_switching as eager_switching

soft_switching = jax.jit(eager_switching, static_argnames=("dwell_ticks", "dwell_rounds"))


@pytest.fixture(autouse=True)
def _float64():
    with jax.enable_x64(True):
        yield


def hand_speed(bins=4000, seed=0):
    """A hand-like speed signal in mm/s: log-normal, low-passed."""
    random = np.random.default_rng(seed)
    walk, value = np.empty(bins), 0.0
    for i in range(bins):
        value += -0.01 * value + 0.14 * random.normal()
        walk[i] = value
    return 40 * np.exp(walk)


def machine(speed, starts, speeds, hysteresis, dwell_ticks=0):
    """The runtime's LevelSwitch, sampled per bin (runtime/core/switching.hpp)."""
    level, since, levels, switches = 0, 10**9, [], 0
    for v, start in zip(speed, starts, strict=True):
        since += 1
        if start:
            level, since = 0, 10**9
        wanted = level
        if since >= dwell_ticks and not start:
            while wanted < len(speeds) and v > speeds[wanted] * (1 + hysteresis):
                wanted += 1
            while wanted > 0 and v < speeds[wanted - 1] * (1 - hysteresis):
                wanted -= 1
        if wanted != level:
            switches += 1
            level, since = wanted, 0
        levels.append(level)
    return np.array(levels), switches


def starts_of(bins, at=(0,)):
    out = np.zeros(bins, bool)
    out[list(at)] = True
    return out


@pytest.mark.parametrize("hysteresis", [0.05, 0.2])
@pytest.mark.parametrize("speeds", [(30.0,), (20.0, 60.0), (15.0, 30.0, 60.0, 110.0)])
def test_sharp_limit_is_the_state_machine(speeds, hysteresis):
    speed, starts = hand_speed(), starts_of(4000, (0, 1500))
    levels, switches = machine(speed, starts, speeds, hysteresis)
    soft = soft_switching(jnp.asarray(speed), jnp.asarray(starts), jnp.log(jnp.array(speeds)), hysteresis, 400.0)
    occupancy = np.asarray(jnp.mean(soft.weights, axis=1))
    np.testing.assert_allclose(occupancy, np.bincount(levels, minlength=len(speeds) + 1) / 4000, atol=0.004)
    # A jump over two thresholds is one switch there and two here.
    jumps = np.abs(np.diff(levels))
    jumps[1499] = 0  # the second motion starts at level 0 without a switch
    assert switches > 10
    assert float(soft.switches) == pytest.approx(jumps.sum(), rel=0.03)


def test_weights_are_a_distribution():
    soft = soft_switching(
        jnp.asarray(hand_speed()), jnp.asarray(starts_of(4000)), jnp.log(jnp.array([20.0, 60.0])), 0.1, 5.0
    )
    np.testing.assert_allclose(jnp.sum(soft.weights, axis=0), 1.0, atol=1e-12)
    # Triggers are independent: only where two thresholds nearly coincide could a weight be negative.
    assert float(jnp.min(soft.weights)) > -0.02
    assert float(jnp.min(soft.up)) >= 0 and float(jnp.min(soft.down)) >= 0


@pytest.mark.parametrize("dwell_ticks", [2, 5])
def test_dwell(dwell_ticks):
    random = np.random.default_rng(1)
    speed = hand_speed() * np.exp(0.1 * random.normal(size=4000))  # chatters at the threshold
    starts = starts_of(4000)
    levels, switches = machine(speed, starts, (40.0,), 0.03, dwell_ticks)
    _, free = machine(speed, starts, (40.0,), 0.03)
    assert free > 1.05 * switches
    soft = soft_switching(jnp.asarray(speed), jnp.asarray(starts), jnp.log(jnp.array([40.0])), 0.03, 40.0, dwell_ticks)
    assert float(soft.switches) == pytest.approx(switches, rel=0.25)
    assert float(jnp.mean(soft.weights[1])) == pytest.approx(np.mean(levels), abs=0.03)


def test_no_switch_where_nothing_is_reached():
    soft = soft_switching(
        jnp.asarray(hand_speed()), jnp.asarray(starts_of(4000)), jnp.array([40.0, 40.0]), jnp.array(0.1), 5.0
    )
    assert float(soft.switches) == 0.0
    np.testing.assert_array_equal(soft.weights[0], 1.0)


@pytest.mark.parametrize("filter_hz", [0.0, 8.0, 45.0])
def test_filter_is_the_runtimes_recurrence(filter_hz):
    random = np.random.default_rng(2)
    velocity, tick_s = random.normal(size=(800, 3)) * 50, 1e-3
    alpha = 1 - np.exp(-2 * np.pi * filter_hz * tick_s) if filter_hz > 0 else 1.0
    state, expected = np.zeros(3), []
    for t, v in enumerate(velocity):
        if t == 400:
            state = np.zeros(3)
        state = state + alpha * (v - state)
        expected.append(np.linalg.norm(state))
    starts = jnp.asarray(starts_of(800, (0, 400)))
    got = filtered_speed_mm_s(jnp.asarray(velocity), starts, jnp.asarray(filter_hz), tick_s)
    np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_affine_scan_is_the_recurrence():
    random = np.random.default_rng(3)
    gain, offset = random.uniform(-1, 1, (50, 2)), random.normal(size=(50, 2))
    x, expected = np.zeros(2), []
    for a, b in zip(gain, offset, strict=True):
        x = a * x + b
        expected.append(x)
    np.testing.assert_allclose(affine_scan(jnp.asarray(gain), jnp.asarray(offset)), expected, rtol=1e-12)


@jax.jit
def _sum_of_flows(point):
    random = np.random.default_rng(4)
    heading = np.cumsum(random.normal(size=4000) * 0.02)
    speed = hand_speed()
    velocity = jnp.asarray(np.stack([speed * np.cos(heading), speed * np.sin(heading), 0 * speed], axis=1))
    starts = jnp.asarray(starts_of(4000))
    v = filtered_speed_mm_s(velocity, starts, jnp.exp(point[0]), 1e-3)
    soft = soft_switching(v, starts, point[1:3], jnp.exp(point[3]), 5.0, dwell_ticks=5)
    return soft.switches + 3 * jnp.sum(soft.weights[1]) / 4000


_gradient = jax.jit(jax.grad(_sum_of_flows))
POINT = np.log([15.0, 25.0, 60.0, 0.1])


def test_gradient_is_the_difference_quotient():
    gradient = _gradient(jnp.asarray(POINT))
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-6
        quotient = (_sum_of_flows(jnp.asarray(POINT + step)) - _sum_of_flows(jnp.asarray(POINT - step))) / 2e-6
        assert float(gradient[i]) == pytest.approx(float(quotient), rel=1e-4, abs=1e-6)
        assert abs(float(quotient)) > 1e-3


def test_forward_mode_and_batching_agree():
    point, direction = jnp.asarray(POINT), jnp.array([1.0, -0.5, 0.3, 0.2])
    _, forward = jax.jvp(_sum_of_flows, (point,), (direction,))
    assert float(forward) == pytest.approx(float(_gradient(point) @ direction), rel=1e-9)
    batch = jnp.stack([point, point + 0.1])
    np.testing.assert_allclose(jax.jit(jax.vmap(_sum_of_flows))(batch), [_sum_of_flows(p) for p in batch], rtol=1e-9)
