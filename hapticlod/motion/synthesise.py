"""Hand motions made on a scan's surface, in four modes (PERCEPTION.md section 4).

probe: slow strokes this way and that, with bursts of taps. trace: along crests and grooves, slower where it bends
(two-thirds power law, Lacquaniti et al. 1983). scan: to and fro in neighbouring sweeps. transfer: long fast strokes,
about half of them sliding in contact (that is what levels of detail must handle), the others just above the surface.
"""

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from hapticlod.errors import InputError
from hapticlod.motion.hand import Lift, Press, hand_motion
from hapticlod.motion.motion import Motion
from hapticlod.motion.strokes import BASE_HZ, MODES, STROKES, Drawn, Mode, brownian_heading, draw_strokes, stroke_speed
from hapticlod.motion.surface import ScanLike, surface_of
from hapticlod.motion.track import track_over
from hapticlod.motion.walk import Path, step_for
from hapticlod.tool import Tool, point

Array = NDArray[np.float64]

_TRANSFER_CONTACT = 0.6


def synthesise(
    scan: ScanLike,
    mode: Mode,
    *,
    seconds: float,
    loop_hz: float,
    seed: int,
    tool: Tool | None = None,
    stiffness_n_mm: float = 1.0,
    force_n: float = 0.8,
    max_force_n: float = 12.0,
    encoder_mm: float = 0.023,
) -> Motion:
    """A motion on the surface of a scan. The same seed is the same hand at every loop rate.

    Args:
        scan: vertices in mm and faces; a Surface is built once per scan object.
        mode: probe, trace, scan or transfer.
        seconds: duration, at least 1 s.
        loop_hz: the loop rate.
        seed: of everything random.
        tool: what is held (a point by default); it is laid on the surface by its reference ball, and a tool of
            several balls is turned so that its shaft follows the surface's normal slowly.
        stiffness_n_mm, force_n, max_force_n: the HIP is pushed in by force / stiffness; force_n is the median of a
            log-normal force (0.8 N light, 3 N an explorer), capped by max_force_n.
        encoder_mm: position steps of the device; 0: none.

    Raises:
        InputError: an unknown mode, or a number that makes no motion.
    """
    if mode not in MODES:
        raise InputError("motion mode", f"{mode!r} is none of {', '.join(get_args(Mode))}", "choose one of these")
    positive = {"seconds": seconds, "loop_hz": loop_hz, "stiffness_n_mm": stiffness_n_mm, "force_n": force_n}
    for field, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(field, f"{value} is not above 0", "give a positive number")
    if seconds < 1.0:
        raise InputError("seconds", f"{seconds} s is too short for a hand", "give at least 1 s")
    tool = tool or point()
    rng = np.random.default_rng([seed, MODES.index(mode)])
    surface = surface_of(scan)
    ticks = round(seconds * BASE_HZ)
    drawn = draw_strokes(STROKES[mode], ticks / BASE_HZ, rng)
    speed = stroke_speed(drawn, ticks)
    travelled = np.cumsum(speed) / BASE_HZ
    heading = _heading(mode, ticks, drawn.start_s, rng)
    margin = 1.3 if tool.reference_radius_mm > 0 or mode == "trace" else 1.1
    length_mm = margin * float(travelled[-1])
    step_mm = step_for(surface, float(travelled[-1]), seconds)
    turn = Turns(np.append(travelled, 1e30), np.append(heading, heading[-1]))
    crest = 1.0 if mode == "trace" else 0.0
    track, normals = track_over(surface, length_mm, step_mm, turn, tool.reference_radius_mm, rng, crest=crest)
    if mode == "trace":
        speed = _slowed_in_bends(speed, track)
    press = Press(force_n, 0.5, max_force_n, stiffness_n_mm, encoder_mm)
    provenance = {
        "kind": "synthesised",
        "mode": mode,
        "seed": seed,
        "seconds": seconds,
        "scan": str(getattr(scan, "name", "")),
        "scan_digest": str(getattr(scan, "digest", "")),
    }
    lifts = _lifts(mode, seconds, drawn, rng)
    name = f"{mode}-{seed}"
    return hand_motion(surface, track, normals, speed, lifts, press, tool, loop_hz, rng, name, provenance)


class Turns:
    """Walked distance -> change of heading since it was last asked."""

    def __init__(self, travelled_mm: Array, heading_rad: Array) -> None:
        self.travelled_mm, self.heading_rad = travelled_mm, heading_rad
        self.now = float(heading_rad[0])

    def __call__(self, walked_mm: float) -> float:
        heading = float(self.heading_rad[np.searchsorted(self.travelled_mm, walked_mm)])
        turn, self.now = heading - self.now, heading
        return turn


def _heading(mode: Mode, ticks: int, starts: Array, rng: np.random.Generator) -> Array:
    """Heading (T,): a random walk, plus a turn at the start of every stroke that depends on the mode."""
    heading = brownian_heading(ticks, rng)
    if mode == "trace":
        return heading
    spread = {"probe": 0.9, "scan": 0.1, "transfer": 0.5}[mode]
    turns = spread * rng.normal(size=len(starts))
    if mode == "scan":  # sweeps: half a turn, to the left and to the right in turn, so that they lie side by side
        turns += np.where(np.arange(len(starts)) % 2 == 0, 1.0, -1.0) * np.pi
    turns[0] = 0.0
    first = np.minimum(np.round(starts * BASE_HZ).astype(int), ticks - 1)
    steps = np.zeros(ticks)
    np.add.at(steps, first, turns)
    # a hand turns over some hundredths of a second, not at once
    width = round(0.06 * BASE_HZ)
    return heading + np.convolve(np.cumsum(steps), np.ones(width) / width)[:ticks]


def _slowed_in_bends(speed: Array, track: Path) -> Array:
    """v = K (kappa + 0.02/mm)^(-1/3), smoothed to about 5 Hz, with K such that the median speed stays."""
    spacing = float(track.walked_mm[-1]) / (len(track.walked_mm) - 1)
    smooth = max(round(float(np.median(speed)) / 5.0 / spacing), 1)
    window = np.ones(smooth) / smooth
    points = np.stack([np.convolve(track.points_mm[:, k], window, mode="same") for k in range(3)], axis=1)
    tangent = np.gradient(points, axis=0)
    length = np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)
    bend = np.linalg.norm(np.gradient(tangent / length[:, None], axis=0), axis=1) / length
    bend[:smooth] = bend[-smooth:] = np.median(bend)
    factor = (np.convolve(bend, window, mode="same") + 0.02) ** (-1.0 / 3.0)
    factor = np.clip(factor / np.median(factor), 0.5, 1.6)
    # ds/dt = v(t) factor(s): walked "effort" is the integral of ds / factor
    effort = np.concatenate([[0.0], np.cumsum(np.diff(track.walked_mm) / factor[1:])])
    place = np.interp(np.cumsum(speed) / BASE_HZ, effort, track.walked_mm)
    return np.diff(place, prepend=0.0) * BASE_HZ


def strokes_in_air(peak_mm_s: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(S,) which transfer strokes fly: every n-th by speed, so that those are neither slower nor faster than others."""
    share = 1.0 - _TRANSFER_CONTACT
    place = np.argsort(np.argsort(peak_mm_s)) * share + rng.random()
    return np.floor(place + share) > np.floor(place)


def _lifts(mode: Mode, seconds: float, drawn: Drawn, rng: np.random.Generator) -> list[Lift]:
    """When the tool leaves the surface."""
    if mode == "transfer":
        starts, stops = drawn.start_s, np.append(drawn.start_s[1:], seconds)
        in_air = strokes_in_air(drawn.peak_mm_s, rng)
        heights = rng.uniform(0.5, 2.0, len(starts))
        return [Lift(*span) for span in zip(starts[in_air], stops[in_air], heights[in_air], strict=True)]
    lifts: list[Lift] = []
    pause_s = {"probe": 2.5, "trace": 6.0, "scan": 4.0}[mode]
    at_s = 0.6 + rng.uniform(0.5, 1.0) * pause_s
    while at_s < seconds - 1.0:
        if mode == "probe":  # a burst of taps, 2 to 4 per second
            for _ in range(int(rng.integers(2, 6))):
                period_s = 1.0 / rng.uniform(2.0, 4.0)
                lifts.append(Lift(at_s, at_s + 0.6 * period_s, rng.uniform(0.3, 0.6)))
                at_s += period_s
        else:
            lifts.append(Lift(at_s, at_s + 0.35, rng.uniform(0.5, 1.5)))
        at_s += rng.uniform(0.7, 1.3) * pause_s
    return lifts
