"""How fast a hand moves and how it shakes: sums of minimum-jerk strokes (Flash and Hogan 1985), tremor, drift.

Parameters and the speeds they give are the table of PERCEPTION.md section 4.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mode = Literal["probe", "trace", "scan", "transfer"]
MODES: tuple[Mode, ...] = get_args(Mode)
BASE_HZ = 1000.0  # hands are made at this rate, so that a seed gives the same hand at every loop rate


@dataclass(frozen=True)
class Strokes:
    """Log-normal strokes: median and sigma (of the logarithm) of peak speed and duration, and how far they overlap."""

    peak_mm_s: float
    peak_sigma: float
    duration_s: float
    duration_sigma: float
    overlap: float


STROKES: dict[Mode, Strokes] = {
    "probe": Strokes(15.0, 0.5, 0.45, 0.3, 0.35),
    "trace": Strokes(35.0, 0.4, 0.5, 0.3, 0.4),
    "scan": Strokes(60.0, 0.4, 0.4, 0.25, 0.15),
    "transfer": Strokes(230.0, 0.3, 0.5, 0.2, 0.0),
}


@dataclass(frozen=True)
class Drawn:
    """Strokes that were drawn, (S,) each: when they start, how long they last, their peak speeds."""

    start_s: Array
    duration_s: Array
    peak_mm_s: Array


def draw_strokes(strokes: Strokes, seconds: float, rng: np.random.Generator) -> Drawn:
    """As many strokes as start within `seconds`.

    Peaks, durations and overlaps are each one from every n-th part of its distribution, in random order: each alone is
    distributed as if drawn freely, and two hands of one kind have about the same speeds.
    """
    pace_s = strokes.duration_s * np.exp(0.5 * strokes.duration_sigma**2) * (1.0 - strokes.overlap)
    count = max(round(seconds / pace_s), 1)
    while True:
        duration_s = strokes.duration_s * np.exp(strokes.duration_sigma * spread_normals(count, rng))
        stop_s = np.cumsum(duration_s * (1.0 - strokes.overlap * (0.5 + spread_uniforms(count, rng))))
        if stop_s[-1] >= seconds:
            break
        count += 1
    start_s = np.concatenate([[0.0], stop_s[:-1]])
    peak_mm_s = strokes.peak_mm_s * np.exp(strokes.peak_sigma * spread_normals(count, rng))
    within = start_s < seconds
    return Drawn(start_s[within], duration_s[within], peak_mm_s[within])


def stroke_speed(drawn: Drawn, ticks: int) -> Array:
    """Speed (T,) mm/s at `BASE_HZ`.

    A stroke of length D and duration T has speed D/T 30 u^2 (1-u)^2, u = t/T: its peak is 1.875 D/T.
    """
    speed = np.zeros(ticks)
    for start_s, duration_s, peak_mm_s in zip(drawn.start_s, drawn.duration_s, drawn.peak_mm_s, strict=True):
        first = round(start_s * BASE_HZ)
        samples = max(round(duration_s * BASE_HZ), 2)
        u = (np.arange(samples) + 0.5) / samples
        bell = peak_mm_s / 1.875 * 30.0 * u**2 * (1.0 - u) ** 2
        fits = min(samples, ticks - first)
        speed[first : first + fits] += bell[:fits]
    return speed


def brownian_heading(ticks: int, rng: np.random.Generator, rad_per_root_s: float = 0.6) -> Array:
    """Heading (T,) rad at `BASE_HZ` that drifts as a random walk."""
    return np.cumsum(rng.normal(size=ticks)) * rad_per_root_s / np.sqrt(BASE_HZ)


def spread_uniforms(count: int, rng: np.random.Generator) -> Array:
    """Numbers (n,) in [0, 1), one from each n-th part, in random order (stratified sampling)."""
    return (rng.permutation(count) + rng.random(count)) / count


def spread_normals(count: int, rng: np.random.Generator) -> Array:
    """Normal deviates (n,), one from each n-th part of the distribution, in random order (stratified sampling).

    A motion has few contacts and strokes; drawn apart from each other, their forces and speeds would make two motions
    of one hand unlike.
    """
    from scipy.special import ndtri

    return ndtri(spread_uniforms(count, rng))


def tremor_mm(ticks: int, rng: np.random.Generator, *, rms_mm: float = 0.03, centre_hz: float = 10.0) -> Array:
    """Physiological tremor (T, 3) mm at `BASE_HZ`: white noise through a resonator of quality 5."""
    from scipy.signal import lfilter  # takes a second to import: not for those who only read motions

    angle = 2.0 * np.pi * centre_hz / BASE_HZ
    radius = np.exp(-angle / (2.0 * 5.0))
    feedback = np.array([1.0, -2.0 * radius * np.cos(angle), radius * radius])
    run_in = round(BASE_HZ)
    noise = rng.normal(size=(ticks + run_in, 3))
    # the resonator's own gain, so that the rms holds for every length and is not forced on each sample
    impulse = np.asarray(lfilter([1.0], feedback, np.eye(1, 4000)[0]))
    shaken = np.asarray(lfilter([1.0], feedback, noise, axis=0))[run_in:]
    return shaken * (rms_mm / np.sqrt(np.sum(impulse**2)))


def slow_noise(ticks: int, rng: np.random.Generator, cutoff_hz: float = 3.0) -> Array:
    """Noise (T,) of rms 1 below `cutoff_hz`, at `BASE_HZ`."""
    from scipy.signal import butter, sosfiltfilt  # as above

    pad = round(BASE_HZ)
    noise = rng.normal(size=ticks + 2 * pad)
    slow = np.asarray(sosfiltfilt(butter(2, cutoff_hz, fs=BASE_HZ, output="sos"), noise))[pad:-pad]
    impulse = np.zeros(4 * pad + 1)
    impulse[2 * pad] = 1.0
    gain = np.sqrt(np.sum(np.asarray(sosfiltfilt(butter(2, cutoff_hz, fs=BASE_HZ, output="sos"), impulse)) ** 2))
    return slow / gain


def min_jerk(u: Array) -> Array:
    """The minimum-jerk step from 0 to 1 for u in [0, 1], clamped outside."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
