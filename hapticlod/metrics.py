"""The metrics of PERCEPTION.md section 1, measured from records: one definition each.

F is the rendered force, R the force of the reference: rung 0, the same tool, the same motion. Where several records
are given (one per motion), ticks, switches and contact cycles of all are pooled; nothing crosses from one to the next.

| key | definition as measured |
|---|---|
| loop_cost_{mean,p50,p99,p999,max}_us | over all ticks; a p99.9 needs 10^5 ticks: quote `n_ticks` beside it |
| deadline_miss_rate, longest_miss_run | ticks with cost > budget: their share; the longest run of them |
| force_error_{rms,p99,max}_n | norm(F - R) over ticks where record or reference is in contact |
| felt_error_jnd | rms over the same ticks of norm(F - R) / JND(norm R), squares times the felt share at hand speed |
| switch_jump_{p50,p99,max}_n | over switches in contact: the greatest norm(dF) - norm(dR), at least 0, of a tick from |
| | the switch to the end of its blend (or to the next switch), d the change since the tick before |
| discontinuity_per_s | sum over these switches of the chance to notice the jump, per second of contact |
| facet_vibration_n | rms of F - R in the preset's band, over ticks where both are in contact |
| switches_per_s | level changes per second |
| mapping_hit_rate | mappings that found the surface (segment or closest point) / mappings tried; 1 where none was |
| false_release_per_min | contact lost though the reference is in contact then and for the preset's slack after |
| pop_through_per_min | the tool is held from the far side for longer than the slack |
| penetration_p99_mm | norm(SCP - HIP) over ticks in contact |
| energy_out_mj | worst complete contact cycle: integral of F dx, F the force on the hand; passive: at most 0 |
| memory_mb | resident bytes of the loaded levels / 10^6, of the record that needs most |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hapticlod.contact_events import cycle_energies_mj, false_releases, far_sides, stretches
from hapticlod.layout import MAPPED_MISS, MAPPED_NONE
from hapticlod.motion.smooth import low_passed
from hapticlod.perception import Perception, load_perception

if TYPE_CHECKING:
    from hapticlod.replay import Record

Array = NDArray[np.float64]

HAND_SPEED_HZ = 15.0  # low-pass of the hand's speed: voluntary motion and tremor are below

METRIC_KEYS = (
    "loop_cost_mean_us",
    "loop_cost_p50_us",
    "loop_cost_p99_us",
    "loop_cost_p999_us",
    "loop_cost_max_us",
    "deadline_miss_rate",
    "longest_miss_run",
    "force_error_rms_n",
    "force_error_p99_n",
    "force_error_max_n",
    "felt_error_jnd",
    "switch_jump_p50_n",
    "switch_jump_p99_n",
    "switch_jump_max_n",
    "discontinuity_per_s",
    "facet_vibration_n",
    "switches_per_s",
    "mapping_hit_rate",
    "false_release_per_min",
    "pop_through_per_min",
    "penetration_p99_mm",
    "energy_out_mj",
    "memory_mb",
)


@dataclass(frozen=True)
class Measurement:
    """Metrics, and how much they rest on."""

    metrics: dict[str, float]
    n_ticks: int
    n_contact_ticks: int
    n_switches: int
    n_switches_in_contact: int
    n_contact_cycles: int


def measure(
    record: "Record | Sequence[Record]",
    reference: "Record | Sequence[Record]",
    perception: Perception | None = None,
) -> dict[str, float]:
    """The metrics, with exactly the keys `METRIC_KEYS`. See `measurement`."""
    return measurement(record, reference, perception).metrics


def measurement(
    record: "Record | Sequence[Record]",
    reference: "Record | Sequence[Record]",
    perception: Perception | None = None,
) -> Measurement:
    """Measures one record, or several, against its reference on the same motion.

    Args:
        record, reference: one per motion, in the same order.
        perception: preset of thresholds; the shipped default where none is given.

    Raises:
        ValueError: no record, or a record and its reference that are not of the same motion, or not finite.
    """
    records = list(record) if isinstance(record, Sequence) else [record]
    references = list(reference) if isinstance(reference, Sequence) else [reference]
    if not records or len(records) != len(references):
        raise ValueError(f"{len(records)} records and {len(references)} references: give one reference per record")
    felt = perception or load_perception()
    return _pooled([_terms(one, its, felt) for one, its in zip(records, references, strict=True)])


def hand_speed_mm_s(hip_mm: Array, loop_hz: float) -> Array:
    """(T,) the hand's speed, mm/s, without the encoder's steps: zero-phase low-pass, then differences."""
    smooth = low_passed(hip_mm, HAND_SPEED_HZ, loop_hz)
    return np.linalg.norm(np.gradient(smooth, 1.0 / loop_hz, axis=0), axis=1)


def switch_jumps_n(force_n: Array, reference_n: Array, switches: NDArray[np.intp], blend_ticks: int) -> Array:
    """(S,) jump of every switch, N: see the table at the top."""
    excess = np.zeros(len(force_n))
    excess[1:] = np.linalg.norm(np.diff(force_n, axis=0), axis=1) - np.linalg.norm(np.diff(reference_n, axis=0), axis=1)
    excess = np.maximum(excess, 0.0)
    ends = np.minimum(switches + 1 + blend_ticks, np.append(switches[1:], len(force_n)))
    return np.array([excess[start:end].max() for start, end in zip(switches, ends, strict=True)])


def vibration_spectrum(error_n: Array, loop_hz: float) -> tuple[Array, Array]:
    """Frequencies (B,) Hz and squared spectral amplitudes (B,) N^2; these sum to the sum over ticks of norm^2."""
    ticks = len(error_n)
    power = np.square(np.abs(np.fft.rfft(error_n, axis=0))).sum(axis=1) / ticks
    power[1:] *= 2.0
    if ticks % 2 == 0:
        power[-1] *= 0.5
    return np.asarray(np.fft.rfftfreq(ticks, 1.0 / loop_hz), dtype=np.float64), power


def felt_vibration(record: "Record", reference: "Record", perception: Perception | None = None) -> float:
    """Facet vibration in units of what is felt: as facet_vibration_n, every frequency divided by F_th(f)."""
    felt = perception or load_perception()
    both = record.contact & reference.contact
    frequency, power = vibration_spectrum((record.force - reference.force) * both[:, None], record.loop_hz)
    band = (frequency >= felt.vibration_low_hz) & (frequency <= felt.vibration_high_hz)
    ratio = power[band] / np.square(felt.force_threshold_n(frequency[band]))
    return float(np.sqrt(ratio.sum() / max(int(both.sum()), 1)))


@dataclass(frozen=True)
class _Terms:
    """What one record adds to each metric."""

    cost_us: Array
    over_budget: NDArray[np.bool_]
    error_n: Array
    felt_square: Array
    jumps_n: Array
    noticed: float
    contact_s: float
    vibration_square: float
    both_ticks: int
    switches: int
    seconds: float
    mapped: int
    tried: int
    false_releases: int
    pop_throughs: int
    penetration_mm: Array
    cycles_mj: Array
    memory_mb: float


def _terms(record: "Record", reference: "Record", felt: Perception) -> _Terms:
    _check_pair(record, reference)
    loop_hz = record.loop_hz
    force, truth = record.force, reference.force
    contact, true_contact = record.contact, reference.contact
    either, both = contact | true_contact, contact & true_contact
    error = np.linalg.norm(force - truth, axis=1)
    jnd = felt.jnd_n(np.linalg.norm(truth, axis=1))
    share = felt.felt_share(hand_speed_mm_s(record.hip, loop_hz))

    level = record.level.astype(np.int64)
    switches = np.flatnonzero(np.diff(level)) + 1
    jumps = switch_jumps_n(force, truth, switches, round(record.blend_s * loop_hz))
    touching = contact[switches] | contact[switches - 1]
    jumps, at = jumps[touching], switches[touching]

    frequency, power = vibration_spectrum((force - truth) * both[:, None], loop_hz)
    band = (frequency >= felt.vibration_low_hz) & (frequency <= felt.vibration_high_hz)
    tried = record.mapping != MAPPED_NONE
    slack = round(felt.slack_ms * 1e-3 * loop_hz)
    out = (record.scp - record.hip) * contact[:, None]
    true_out = (reference.scp - reference.hip) * true_contact[:, None]
    return _Terms(
        cost_us=record.cost_us,
        over_budget=record.cost_us > record.budget_us,
        error_n=error[either],
        felt_square=(np.square(error / jnd) * share)[either],
        jumps_n=jumps,
        noticed=float(felt.noticed(jumps / jnd[at]).sum()),
        contact_s=float(either.sum()) / loop_hz,
        vibration_square=float(power[band].sum()),
        both_ticks=int(both.sum()),
        switches=len(switches),
        seconds=len(force) / loop_hz,
        mapped=int((tried & (record.mapping != MAPPED_MISS)).sum()),
        tried=int(tried.sum()),
        false_releases=len(false_releases(contact, true_contact, slack)),
        pop_throughs=len(far_sides(out, true_out, slack)),
        penetration_mm=np.linalg.norm(out[contact], axis=1),
        cycles_mj=cycle_energies_mj(force, record.hip, contact),
        memory_mb=sum(record.level_bytes) / 1e6,
    )


def _pooled(terms: list[_Terms]) -> Measurement:
    def all_of(field: str) -> Array:
        return np.concatenate([getattr(term, field) for term in terms])

    def sum_of(field: str) -> float:
        return float(sum(getattr(term, field) for term in terms))

    cost, error, jumps, cycles = all_of("cost_us"), all_of("error_n"), all_of("jumps_n"), all_of("cycles_mj")
    runs = np.concatenate([np.diff(stretches(term.over_budget), axis=1) for term in terms])
    minutes = sum_of("seconds") / 60.0
    values = (
        float(cost.mean()),
        *(_quantile(cost, q) for q in (0.5, 0.99, 0.999, 1.0)),
        float(all_of("over_budget").mean()),
        float(runs.max(initial=0)),
        _rms(error),
        *(_quantile(error, q) for q in (0.99, 1.0)),
        float(np.sqrt(all_of("felt_square").mean())) if len(error) else 0.0,
        *(_quantile(jumps, q) for q in (0.5, 0.99, 1.0)),
        sum_of("noticed") / sum_of("contact_s") if len(error) else 0.0,
        float(np.sqrt(sum_of("vibration_square") / max(sum_of("both_ticks"), 1.0))),
        sum_of("switches") / sum_of("seconds"),
        sum_of("mapped") / sum_of("tried") if sum_of("tried") else 1.0,
        sum_of("false_releases") / minutes,
        sum_of("pop_throughs") / minutes,
        _quantile(all_of("penetration_mm"), 0.99),
        float(cycles.max()) if len(cycles) else 0.0,
        max(term.memory_mb for term in terms),
    )
    return Measurement(
        metrics=dict(zip(METRIC_KEYS, values, strict=True)),
        n_ticks=len(cost),
        n_contact_ticks=len(error),
        n_switches=int(sum_of("switches")),
        n_switches_in_contact=len(jumps),
        n_contact_cycles=len(cycles),
    )


def _quantile(values: Array, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else 0.0


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def _check_pair(record: "Record", reference: "Record") -> None:
    if len(record) != len(reference) or record.loop_hz != reference.loop_hz:
        raise ValueError(
            f"a record of {len(record)} ticks at {record.loop_hz:g} Hz and a reference of {len(reference)} ticks at "
            f"{reference.loop_hz:g} Hz are not of one motion"
        )
    if len(record) < 2:
        raise ValueError(f"a record of {len(record)} ticks measures nothing")
    if not np.array_equal(record.hip, reference.hip):
        raise ValueError("record and reference are of different motions: replay both over the same one")
    for name, rows in (("record", record.rows), ("reference", reference.rows)):
        for field in ("force_n", "scp_mm", "hip_mm", "cost_ns"):
            bad = ~np.isfinite(rows[field]).reshape(len(rows), -1).all(axis=1)
            if bad.any():
                raise ValueError(f"{name}: {field} is not finite at tick {int(np.argmax(bad))}")
