"""From the replay of one level to what the surrogate wants to know of it.

The definitions are those of hapticlod.metrics, tick by tick; the functions that hold a definition are called there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from hapticlod.contact_events import false_releases, far_sides, stretches
from hapticlod.metrics import hand_speed_mm_s
from hapticlod.perception import Perception
from tuning.grid import Clock

Array = NDArray[np.float64]

# Windows after a switch in which its jump is looked for, s; 0 is the switch's own tick.
WINDOWS_S = (0.0, 0.004, 0.016, 0.048, 0.144)


@dataclass(frozen=True)
class Reference:
    """The finest level's replay, motion by motion, and what follows from it alone. Axes: M motions, T ticks of all."""

    rows: tuple[NDArray, ...]
    loop_hz: float
    perception: Perception
    felt_per_n2: Array
    contact: NDArray[np.bool_]
    step_n: Array
    force_n: Array
    velocity_mm_s: Array
    cycle: NDArray[np.intp]

    @property
    def ticks(self) -> int:
        """T."""
        return len(self.contact)


def make_reference(rows: Sequence[NDArray], loop_hz: float, perception: Perception) -> Reference:
    """From the finest level's rows, one array per motion."""
    felt, steps, velocities, cycles, count = [], [], [], [], 0
    for motion in rows:
        force, hip = motion["force_n"], motion["hip_mm"]
        share = perception.felt_share(hand_speed_mm_s(hip, loop_hz))
        felt.append(share / np.square(perception.jnd_n(np.linalg.norm(force, axis=1))))
        steps.append(np.diff(force, axis=0, prepend=force[:1]))
        velocities.append(np.diff(hip, axis=0, prepend=hip[:1]) * loop_hz)
        cycle = np.zeros(len(motion), dtype=np.intp)
        for first, last in stretches(motion["contact"].astype(bool)):
            if first > 0 and last < len(motion):
                count += 1
                cycle[first : last + 1] = count
        cycles.append(cycle)
    return Reference(
        rows=tuple(rows),
        loop_hz=loop_hz,
        perception=perception,
        felt_per_n2=np.concatenate(felt),
        contact=np.concatenate([motion["contact"].astype(bool) for motion in rows]),
        step_n=np.concatenate(steps),
        force_n=np.concatenate([motion["force_n"] for motion in rows]),
        velocity_mm_s=np.concatenate(velocities),
        cycle=np.concatenate(cycles),
    )


def level_fields(rows: Sequence[NDArray], reference: Reference, clock: Clock) -> dict[str, Array]:
    """Fields of `hapticlod.surrogate.measurement.Feel` per bin (n,), and `rough_n` per window and instant (W, I).

    Args:
        rows: the level's replay, one array per motion.
        reference: of the same motions.
        clock: bins and instants.
    """
    ticks: dict[str, list[Array]] = {}
    for mine, true in zip(rows, reference.rows, strict=True):
        for name, values in _tick_fields(mine, true, reference).items():
            ticks.setdefault(name, []).append(values)
    tick = {name: np.concatenate(values, axis=-1) for name, values in ticks.items()}
    out = {
        name: clock.binned(tick[name]).mean(axis=-1)
        for name in ("force_sq", "band_sq", "either", "both", "contact", "release", "pop", "work_mj")
    }
    out["felt"] = clock.binned(tick["force_sq"] * reference.felt_per_n2).mean(axis=-1)
    out["peak_n"] = np.sqrt(clock.binned(tick["force_sq"]).max(axis=-1))
    touched = np.maximum(clock.binned(tick["contact"]).sum(axis=-1), 1.0)
    out["depth_mm"] = clock.binned(tick["depth_mm"]).sum(axis=-1) / touched
    middle = clock.ticks_per_instant // 2
    out["rough_n"] = tick["rough_n"][:, middle :: clock.ticks_per_instant]
    return out


def _tick_fields(mine: NDArray, true: NDArray, reference: Reference) -> dict[str, Array]:
    force, truth = mine["force_n"], true["force_n"]
    contact, true_contact = mine["contact"].astype(bool), true["contact"].astype(bool)
    either, both = contact | true_contact, contact & true_contact
    error = force - truth
    slack = round(reference.perception.slack_ms * 1e-3 * reference.loop_hz)
    out = (mine["scp_mm"] - mine["hip_mm"]) * contact[:, None]
    true_out = (true["scp_mm"] - true["hip_mm"]) * true_contact[:, None]
    mean_force = 0.5 * (force[1:] + force[:-1])
    work = np.zeros(len(mine))
    work[1:] = np.einsum("ij,ij->i", mean_force, np.diff(mine["hip_mm"], axis=0))
    excess = np.zeros(len(mine))
    excess[1:] = np.linalg.norm(np.diff(force, axis=0), axis=1) - np.linalg.norm(np.diff(truth, axis=0), axis=1)
    return {
        "force_sq": np.einsum("ij,ij->i", error, error) * either,
        "band_sq": np.square(band_passed(error * both[:, None], reference)).sum(axis=1),
        "either": either.astype(np.float64),
        "both": both.astype(np.float64),
        "contact": contact.astype(np.float64),
        "depth_mm": np.linalg.norm(out, axis=1),
        "release": _marks(false_releases(contact, true_contact, slack), len(mine)),
        "pop": _marks(far_sides(out, true_out, slack), len(mine)),
        "work_mj": work,
        "rough_n": np.stack([_largest_ahead(np.maximum(excess, 0.0), round(w * reference.loop_hz)) for w in WINDOWS_S]),
    }


def band_passed(signal: Array, reference: Reference) -> Array:
    """(T, 3) the part of a force in the preset's band; its squares sum to the metric's spectrum in the band."""
    spectrum = np.fft.rfft(signal, axis=0)
    frequency = np.fft.rfftfreq(len(signal), 1.0 / reference.loop_hz)
    low, high = reference.perception.vibration_low_hz, reference.perception.vibration_high_hz
    spectrum[(frequency < low) | (frequency > high)] = 0.0
    return np.fft.irfft(spectrum, len(signal), axis=0)


def _largest_ahead(values: Array, ticks: int) -> Array:
    """Largest of a tick and the `ticks` after it."""
    if ticks == 0:
        return values
    return maximum_filter1d(values, ticks + 1, origin=-((ticks + 1) // 2), mode="nearest")


def _marks(at: NDArray[np.intp], count: int) -> Array:
    out = np.zeros(count)
    np.add.at(out, at, 1.0)
    return out
