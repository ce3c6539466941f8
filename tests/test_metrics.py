"""Every metric against a record whose answer is known in closed form."""

import json
from dataclasses import replace

import numpy as np
import pytest

from hapticlod.contact_events import cycle_energies_mj, false_releases, far_sides, stretches
from hapticlod.layout import MAPPED_CLOSEST, MAPPED_HIT, MAPPED_MISS, RECORD_DTYPE
from hapticlod.metrics import (
    METRIC_KEYS,
    felt_vibration,
    hand_speed_mm_s,
    measure,
    measurement,
    switch_jumps_n,
    vibration_spectrum,
)
from hapticlod.perception import load_perception
from hapticlod.replay import Record

FELT = load_perception()


def held(ticks: int = 2000, *, loop_hz: float = 1000.0, force_n: float = 1.0, blend_s: float = 0.0) -> Record:
    """A still hand in contact all the time: F = 1 N along z, SCP 1 mm above the HIP, level 0, 10 us per tick."""
    rows = np.zeros(ticks, dtype=RECORD_DTYPE)
    rows["time_s"] = np.arange(ticks) / loop_hz
    rows["scp_mm"][:, 2] = force_n
    rows["force_n"][:, 2] = force_n
    rows["contact"] = 1
    rows["cost_ns"] = 10_000.0
    return Record(rows, loop_hz, 100.0, 1.0, (1000, 100), (3_000_000, 500_000), blend_s)


def changed(record: Record, **fields: object) -> Record:
    """A copy with other columns: name=(index, value)."""
    rows = record.rows.copy()
    for name, (index, value) in fields.items():  # type: ignore[misc]
        rows[name][index] = value
    return replace(record, rows=rows)


def test_keys_are_those_of_the_metrics_table_and_plain_numbers() -> None:
    found = measure(held(), held())
    assert tuple(found) == METRIC_KEYS and len(METRIC_KEYS) == 23
    assert all(type(value) is float for value in found.values())
    json.dumps(found, allow_nan=False)


def test_a_record_equal_to_its_reference_has_no_fault() -> None:
    found = measure(held(), held())
    perfect = {"mapping_hit_rate": 1.0, "penetration_p99_mm": 1.0, "memory_mb": 3.5}
    perfect |= {f"loop_cost_{name}_us": 10.0 for name in ("mean", "p50", "p99", "p999", "max")}
    for key in METRIC_KEYS:
        assert found[key] == pytest.approx(perfect.get(key, 0.0), abs=1e-12), key


def test_loop_cost_and_deadlines() -> None:
    cost_ns = np.arange(1, 1002) * 1000.0  # 1 .. 1001 us
    record = changed(held(1001), cost_ns=(slice(None), cost_ns))
    record = replace(record, budget_us=991.5)
    found = measure(record, held(1001))
    assert found["loop_cost_mean_us"] == pytest.approx(501.0)
    assert found["loop_cost_p50_us"] == pytest.approx(501.0)
    assert found["loop_cost_p99_us"] == pytest.approx(991.0)
    assert found["loop_cost_p999_us"] == pytest.approx(1000.0)
    assert found["loop_cost_max_us"] == pytest.approx(1001.0)
    assert found["deadline_miss_rate"] == pytest.approx(10 / 1001)
    assert found["longest_miss_run"] == 10
    halves = changed(record, cost_ns=(slice(994, 996), 0.0))
    assert measure(halves, held(1001))["longest_miss_run"] == 5


def test_slowdown_of_a_what_if_station_multiplies_the_cost() -> None:
    found = measure(replace(held(), slowdown=20.0), held())
    assert found["loop_cost_p999_us"] == pytest.approx(200.0) and found["deadline_miss_rate"] == 1.0


def test_force_error_over_ticks_where_either_is_in_contact() -> None:
    # 1000 ticks without any contact do not count; of the others a quarter is wrong by 0.3, 0.4 -> 0.5 N.
    reference = changed(held(2000), contact=(slice(1000, None), 0), force_n=(slice(1000, None), 0.0))
    record = changed(reference, force_n=(slice(0, 250), [0.3, 0.4, 1.0]))
    found = measure(record, reference)
    assert found["force_error_rms_n"] == pytest.approx(0.5 * np.sqrt(0.25))
    assert found["force_error_max_n"] == found["force_error_p99_n"] == pytest.approx(0.5)


def test_felt_error_in_jnd_and_its_share_at_speed() -> None:
    reference = held(force_n=2.0)
    record = changed(reference, force_n=(slice(None), [0.0, 0.0, 2.3]))
    jnd = np.hypot(0.1 * 2.0, 0.04)
    assert measure(record, reference)["felt_error_jnd"] == pytest.approx(0.3 / jnd)
    # at the speed detail_mm * felt_hz half of the square is felt
    speed = FELT.detail_mm * FELT.felt_hz
    path = np.arange(2000)[:, None] * np.array([speed / 1000.0, 0.0, 0.0])
    above = path + np.array([0.0, 0.0, 2.0])
    moving, truth = (
        changed(one, hip_mm=(slice(None), path), scp_mm=(slice(None), above)) for one in (record, reference)
    )
    assert measure(moving, truth)["felt_error_jnd"] == pytest.approx(0.3 / jnd * np.sqrt(0.5), rel=1e-3)


def test_hand_speed_is_not_fooled_by_encoder_steps() -> None:
    along = np.round(np.arange(4000) * 0.03 / 0.023) * 0.023
    path = np.column_stack([along, 0 * along, 0 * along]).astype(np.float64)
    speed = hand_speed_mm_s(path, 1000.0)
    np.testing.assert_allclose(speed[200:-200], 30.0, rtol=0.02)


def test_known_jumps_at_switches() -> None:
    # Switches at 500, 1000, 1500: force steps of 0.1, 0.2 and 0.4 N; the reference itself steps by 0.15 at 1500.
    step = np.array([0.1, 0.2, 0.4])
    force = 1.0 + np.cumsum(np.isin(np.arange(2000), [500]) * 0.1 + np.isin(np.arange(2000), [1000]) * 0.2)
    force = force + 0.4 * (np.arange(2000) >= 1500)
    truth = 1.0 + 0.15 * (np.arange(2000) >= 1500)
    level = (np.arange(2000) >= 500).astype(int) - (np.arange(2000) >= 1000) + (np.arange(2000) >= 1500)
    record = changed(held(), force_n=((slice(None), 2), force), level=(slice(None), level))
    reference = changed(held(), force_n=((slice(None), 2), truth))
    found = measurement(record, reference)
    jumps = step - [0.0, 0.0, 0.15]
    assert found.n_switches == found.n_switches_in_contact == 3
    assert found.metrics["switch_jump_p50_n"] == pytest.approx(np.median(jumps))
    assert found.metrics["switch_jump_max_n"] == pytest.approx(0.25)
    assert found.metrics["switches_per_s"] == pytest.approx(1.5)
    jnd = FELT.jnd_n(np.array([1.0, 1.0, 1.15]))
    expected = np.sum(1 - 2.0 ** -((jumps / jnd) ** FELT.beta)) / 2.0
    assert found.metrics["discontinuity_per_s"] == pytest.approx(expected)


def test_jump_is_looked_for_through_the_blend_and_no_further() -> None:
    truth = np.zeros((100, 3))
    force = np.zeros((100, 3))
    force[15:, 0] = 0.3  # five ticks after the switch at 10
    switches = np.array([10])
    assert switch_jumps_n(force, truth, switches, 4) == pytest.approx(0.0)
    assert switch_jumps_n(force, truth, switches, 5) == pytest.approx(0.3)
    # the next switch owns its own tick
    np.testing.assert_allclose(switch_jumps_n(force, truth, np.array([10, 15]), 50), [0.0, 0.3])
    # a blend of 10 ms makes one jump of 0.3 N into ten of 0.03 N
    ramp = np.zeros((100, 3))
    ramp[:, 0] = 0.03 * np.clip(np.arange(100) - 9, 0, 10)
    assert switch_jumps_n(ramp, truth, switches, 10) == pytest.approx(0.03)


def test_switches_in_the_air_make_no_jump_but_are_counted() -> None:
    air = changed(held(), contact=(slice(None), 0), force_n=(slice(None), 0.0), scp_mm=(slice(None), 0.0))
    found = measurement(changed(air, level=(slice(700, None), 1)), air)
    assert found.n_switches == 1 and found.n_switches_in_contact == 0
    assert found.metrics["switches_per_s"] == 0.5 and found.metrics["discontinuity_per_s"] == 0.0
    assert found.metrics["switch_jump_max_n"] == 0.0 and found.metrics["penetration_p99_mm"] == 0.0


def test_mapping_hit_rate_counts_every_outcome() -> None:
    outcomes = {100: MAPPED_HIT, 200: MAPPED_HIT, 300: MAPPED_CLOSEST, 400: MAPPED_MISS}
    record = changed(held(), mapping=(list(outcomes), list(outcomes.values())))
    assert measure(record, held())["mapping_hit_rate"] == pytest.approx(3 / 4)


def test_known_misses_are_false_releases_and_early_leaving_is_not() -> None:
    slack = round(FELT.slack_ms)
    record = changed(held(6000), contact=(np.r_[1000:1100, 3000:3001], 0))
    reference = held(6000)
    assert measure(record, reference)["false_release_per_min"] == pytest.approx(2 / 0.1)
    # the reference leaves too, within the slack: no fault
    leaves = changed(held(6000), contact=(slice(2000, None), 0))
    early = changed(held(6000), contact=(slice(2000 - slack, None), 0))
    assert measure(early, leaves)["false_release_per_min"] == 0.0
    much_too_early = changed(held(6000), contact=(slice(1999 - slack, None), 0))
    assert measure(much_too_early, leaves)["false_release_per_min"] == pytest.approx(1 / 0.1)


def test_far_side_is_a_pop_through() -> None:
    fallen = changed(held(6000), scp_mm=(slice(3000, 3200), [0.0, 0.0, -1.0]))
    assert measure(fallen, held(6000))["pop_through_per_min"] == pytest.approx(10.0)
    shortly = changed(held(6000), scp_mm=(slice(3000, 3020), [0.0, 0.0, -1.0]))
    assert measure(shortly, held(6000))["pop_through_per_min"] == 0.0
    # Fallen in at 1000, comes out at 2000 and is held back there, the reference being free by then.
    inside = changed(held(6000), contact=(slice(1000, 2000), 0))
    inside = changed(inside, scp_mm=(slice(2000, 2300), [0.0, 0.0, -1.0]), contact=(slice(2300, None), 0))
    free = changed(held(6000), contact=(slice(2000, None), 0))
    found = measure(inside, free)
    assert found["pop_through_per_min"] == pytest.approx(10.0)
    assert found["false_release_per_min"] == pytest.approx(10.0)
    # Lying 0.2 mm higher holds a little longer, on the same side.
    higher = changed(held(6000), contact=(slice(2200, None), 0))
    assert measure(higher, free)["pop_through_per_min"] == 0.0


@pytest.mark.parametrize("loop_hz", [1000.0, 4000.0])
def test_sinusoidal_vibration_of_known_amplitude(loop_hz: float) -> None:
    reference = held(int(2 * loop_hz), loop_hz=loop_hz)
    at_s = reference.time_s

    def shaken(frequency_hz: float, amplitude_n: float) -> Record:
        force = 1.0 + amplitude_n * np.sin(2 * np.pi * frequency_hz * at_s)
        return changed(reference, force_n=((slice(None), 2), force))

    assert measure(shaken(100.0, 0.06), reference)["facet_vibration_n"] == pytest.approx(0.06 / np.sqrt(2))
    assert measure(shaken(10.0, 0.06), reference)["facet_vibration_n"] == pytest.approx(0.0, abs=1e-9)
    expected = 0.06 / np.sqrt(2) / FELT.force_threshold_n(100.0)
    assert felt_vibration(shaken(100.0, 0.06), reference) == pytest.approx(expected)
    if loop_hz > 1000:
        assert measure(shaken(700.0, 0.06), reference)["facet_vibration_n"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("ticks", [500, 501])
def test_vibration_spectrum_keeps_the_energy(ticks: int) -> None:
    error = np.random.default_rng(0).normal(size=(ticks, 3))
    frequency, power = vibration_spectrum(error, 1000.0)
    assert power.sum() == pytest.approx(np.square(error).sum())
    assert len(frequency) == len(power) and frequency[-1] <= 500.0


def press_cycle(release_factor: float = 1.0, damping: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Air, 1 mm into a wall of 1 N/mm at z = 0 and out again; stiffer or softer on the way out."""
    phase = np.linspace(0.0, np.pi, 1001)
    depth = np.concatenate([np.zeros(100), np.sin(phase), np.zeros(100)])
    stiffness = np.where(np.arange(len(depth)) < 600, 1.0, release_factor)
    speed = np.gradient(depth)
    contact = depth > 1e-12
    force = (stiffness * depth + damping * speed) * contact
    zero = np.zeros_like(depth)
    return np.column_stack([zero, zero, force]), np.column_stack([zero, zero, -depth]), contact


def test_energy_of_a_known_cycle() -> None:
    # F on the hand is k d along +z, the hand goes to -d and back: a spring gives back what it took.
    assert cycle_energies_mj(*press_cycle()) == pytest.approx(0.0, abs=1e-9)
    # released by a spring of 1.5 N/mm from 1 mm: 0.75 mJ given back for 0.5 mJ taken
    assert cycle_energies_mj(*press_cycle(1.5)) == pytest.approx(0.25, abs=2e-3)
    assert cycle_energies_mj(*press_cycle(0.5)) == pytest.approx(-0.25, abs=2e-3)
    # damping c x' against the motion: dissipates c * integral of x'^2 = c pi^2 / (2 * 1000)
    assert cycle_energies_mj(*press_cycle(1.0, 10.0)) == pytest.approx(-10 * np.pi**2 / 2000, rel=5e-3)


def test_energy_counts_complete_cycles_and_takes_the_worst() -> None:
    force, hip, contact = (np.concatenate(parts) for parts in zip(press_cycle(1.5), press_cycle(0.5), strict=True))
    assert len(cycle_energies_mj(force, hip, contact)) == 2
    assert len(cycle_energies_mj(force[:1500], hip[:1500], contact[:1500])) == 1  # the second is cut short
    rows = np.zeros(len(force), dtype=RECORD_DTYPE)
    rows["force_n"], rows["hip_mm"], rows["contact"] = force, hip, contact
    rows["scp_mm"] = np.where(contact[:, None], 0.0, hip)
    record = Record(rows, 1000.0, 100.0, 1.0, (1,), (1,))
    found = measurement(record, record)
    assert found.n_contact_cycles == 2
    assert found.metrics["energy_out_mj"] == pytest.approx(0.25, abs=2e-3)
    assert found.metrics["penetration_p99_mm"] == pytest.approx(1.0, rel=1e-2)


def test_records_of_several_motions_are_pooled_and_nothing_crosses_between_them() -> None:
    quiet = held(1000)
    loud = changed(
        held(3000), force_n=(slice(None), [0.0, 0.0, 1.2]), cost_ns=(slice(None), 50_000.0), level=(slice(None), 1)
    )
    found = measurement([quiet, loud], [held(1000), held(3000)])
    assert found.n_ticks == 4000 and found.n_switches == 0
    assert found.metrics["force_error_rms_n"] == pytest.approx(0.2 * np.sqrt(0.75))
    assert found.metrics["loop_cost_mean_us"] == pytest.approx(40.0)
    assert found.metrics["memory_mb"] == 3.5


def test_senseless_pairs_are_refused() -> None:
    with pytest.raises(ValueError, match="not of one motion"):
        measure(held(100), held(101))
    with pytest.raises(ValueError, match="different motions"):
        measure(changed(held(), hip_mm=(5, 1.0)), held())
    with pytest.raises(ValueError, match="force_n is not finite at tick 7"):
        measure(changed(held(), force_n=(7, np.nan)), held())
    with pytest.raises(ValueError, match="one reference per record"):
        measure([held()], [])


def test_stretches_and_events_at_the_ends() -> None:
    np.testing.assert_array_equal(stretches(np.array([True, False, True, True])), [[0, 1], [2, 4]])
    assert stretches(np.zeros(3, dtype=bool)).shape == (0, 2)
    lost = np.array([True, True, False])
    np.testing.assert_array_equal(false_releases(lost, np.ones(3, dtype=bool), 25), [2])  # cut short by the end
    assert len(far_sides(np.zeros((5, 3)), np.zeros((5, 3)), 1)) == 0
