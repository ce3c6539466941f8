"""From a path on a surface to what the loop reads: depth, lifts, tremor, encoder steps, orientation."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, minimum_filter1d

from hapticlod.motion.motion import Motion
from hapticlod.motion.smooth import low_passed
from hapticlod.motion.strokes import BASE_HZ, min_jerk, slow_noise, spread_normals, tremor_mm
from hapticlod.motion.surface import Surface
from hapticlod.motion.walk import Path
from hapticlod.motion.whole_tool import yielded
from hapticlod.tool import Tool

Array = NDArray[np.float64]

_HAND_KG = 0.08
_FOLLOW_HZ = 25.0  # such a hand on 1-2 N/mm follows a surface up to about sqrt(k/m) / 2 pi
_TURN_HZ = 1.5  # how fast the shaft follows the surface's normal
_EVERY = 4  # base ticks: 250 Hz suffice for what is smooth already
_BEARING_SHARE = 0.5  # of the way to the medial axis
_LEAN_COSINE = 0.85
_APPROACH_S = 0.4
_RAMP_S = 0.11
_LIFT_MM = 2.0


@dataclass(frozen=True)
class Press:
    """How a hand presses: median force and its log-normal spread, what the device allows, and its stiffness."""

    force_n: float = 0.8
    force_sigma: float = 0.5
    max_force_n: float = 12.0
    stiffness_n_mm: float = 1.0
    encoder_mm: float = 0.023
    tremor_rms_mm: float = 0.03


@dataclass(frozen=True)
class Lift:
    """An interval in the air, s, and how high, mm."""

    start_s: float
    stop_s: float
    height_mm: float


def travelled_mm(path_length_mm: float, speed_mm_s: Array) -> Array:
    """Distance along a path at every base tick (T,); a path that is too short is walked to and fro."""
    travelled = np.concatenate([[0.0], np.cumsum(speed_mm_s)[:-1]]) / BASE_HZ
    return path_length_mm - np.abs(path_length_mm - np.mod(travelled, 2.0 * path_length_mm))


def hand_motion(
    surface: Surface,
    track: Path,
    normals: Array,
    speed_mm_s: Array,
    lifts: list[Lift],
    press: Press,
    tool: Tool,
    loop_hz: float,
    rng: np.random.Generator,
    name: str,
    provenance: dict[str, Any],
) -> Motion:
    """A hand that follows `track` (its normals (K, 3)) at `speed_mm_s` (T,) given at `BASE_HZ`."""
    ticks = len(speed_mm_s)
    along = travelled_mm(float(track.walked_mm[-1]), speed_mm_s)
    centre = _followed(surface, _interpolated(along, track.walked_mm, track.points_mm), tool.reference_radius_mm)
    raw_normal = _interpolated(along, track.walked_mm, normals)
    normal = _leaned(raw_normal)

    time_s = np.arange(ticks) / BASE_HZ
    end_s = ticks / BASE_HZ
    approach_s = min(_APPROACH_S, 0.1 * end_s)
    ends = [Lift(-1.0, approach_s, _LIFT_MM), Lift(end_s - approach_s, end_s + 1.0, _LIFT_MM)]
    depth = _depth_mm(time_s, lifts, press, rng)
    depth = round_crests(centre, normal, depth, press.stiffness_n_mm)
    depth = _borne(surface, centre, normal, depth, tool.reference_radius_mm)
    room = _room(surface, centre, normal, tool.reference_radius_mm)
    offset = -depth
    for lift in sorted([*lifts, *ends], key=lambda lift: lift.height_mm):
        ramp_s = min(_RAMP_S, 0.4 * (lift.stop_s - lift.start_s), approach_s)
        up = min_jerk((time_s - lift.start_s) / ramp_s) * (1.0 - min_jerk((time_s - lift.stop_s + ramp_s) / ramp_s))
        offset += up * (np.minimum(lift.height_mm, room) - offset)
    hip = centre + offset[:, None] * normal
    if tool.balls > 1:
        hip = _yielding(surface, hip, raw_normal, tool, np.maximum(-offset, 0.0))
    hip += tremor_mm(ticks, rng, rms_mm=press.tremor_rms_mm)

    at_s = np.arange(max(round(end_s * loop_hz), 2)) / loop_hz
    if loop_hz != BASE_HZ:
        hip = np.asarray(CubicSpline(time_s, hip)(np.minimum(at_s, time_s[-1])))
    orientation = None if tool.balls == 1 else shaft_orientation(_at(at_s, time_s, raw_normal), loop_hz)
    if press.encoder_mm > 0:
        hip = np.round(hip / press.encoder_mm) * press.encoder_mm
    facts = {
        "loop_hz": float(loop_hz),
        "tool": tool.name,
        "tool_digest": tool.digest,
        "radius_mm": tool.reference_radius_mm,
        "contact_share": round(float(np.mean(offset < 0)), 4),
        "force_n": press.force_n,
        "stiffness_n_mm": press.stiffness_n_mm,
        "max_force_n": press.max_force_n,
        "encoder_mm": press.encoder_mm,
        "tremor_rms_mm": press.tremor_rms_mm,
        "surface_spacing_mm": round(surface.spacing_mm, 6),
        "path_walked_twice": bool(np.sum(speed_mm_s) / BASE_HZ > track.walked_mm[-1]),
    }
    return Motion(at_s, hip, orientation, float(loop_hz), name, {**provenance, **facts})


def _yielding(surface: Surface, hip: Array, normals: Array, tool: Tool, pressed_mm: Array) -> Array:
    """`hip` (T, 3), shifted where more than the tip of the tool would meet the body."""
    knots = np.arange(0, len(hip), _EVERY)
    turn = shaft_orientation(normals, BASE_HZ)[knots]
    shift = yielded(surface, hip[knots], turn, tool, pressed_mm[knots])
    if not shift.any():
        return hip
    shift = low_passed(shift, _FOLLOW_HZ, BASE_HZ / _EVERY)
    return hip + _interpolated(np.arange(len(hip), dtype=np.float64), knots.astype(np.float64), shift)


def _leaned(normal: Array) -> Array:
    """Where the hand pushes from (T, 3): the normals, calmed, but nowhere far from the true ones."""
    calm = _unit(low_passed(normal, 0.5 * _FOLLOW_HZ, BASE_HZ))
    far = np.einsum("ij,ij->i", calm, normal) < _LEAN_COSINE
    leaned = calm + _softened(far, 0.015)[:, None] * (normal - calm)
    return _unit(low_passed(leaned, 2.5 * _FOLLOW_HZ, BASE_HZ))


def _softened(flags: NDArray[np.bool_], reach_s: float) -> Array:
    """Flags (T,) at `BASE_HZ`, widened by `reach_s` and with soft flanks."""
    reach = reach_s * BASE_HZ
    return np.asarray(gaussian_filter1d(maximum_filter1d(flags.astype(np.float64), 2 * round(reach) + 1), 0.5 * reach))


def _followed(surface: Surface, touched: Array, radius_mm: float) -> Array:
    """The path (T, 3) as a hand follows it: it cuts corners through the air, but not through the body.

    So a fast hand flies over hollows; over crests it goes round, as the surface makes it.
    """
    smooth = low_passed(touched, _FOLLOW_HZ, BASE_HZ)
    knots = np.arange(0, len(touched), _EVERY)
    if surface.carries(radius_mm):
        height = surface.clearance_mm(smooth[knots]) - radius_mm
    else:
        places, normals = surface.project(smooth[knots])
        height = np.einsum("ij,ij->i", smooth[knots] - places, normals) - radius_mm
    sunk = np.repeat(height < -0.25 * surface.spacing_mm, _EVERY)[: len(touched)]
    followed = low_passed(smooth + _softened(sunk, 0.015)[:, None] * (touched - smooth), 2.5 * _FOLLOW_HZ, BASE_HZ)
    sampled = followed[knots]
    lift = low_passed(surface.pushed_out(sampled, radius_mm) - sampled, 2.5 * _FOLLOW_HZ, BASE_HZ / _EVERY)
    return followed + _interpolated(np.arange(len(touched), dtype=np.float64), knots.astype(np.float64), lift)


def _borne(surface: Surface, centre: Array, normal: Array, depth: Array, radius_mm: float) -> Array:
    """`depth` (T,) made less where the body is thin or the surface is a crest.

    A HIP that swings deep below a crest would leave its contact point behind on the near flank: no hand does that,
    for it would have to push through the crest. What a ball's centre goes round is the crest widened by the ball: with
    the HIP as deep as the ball is thick, on the crest itself, the least motion sends the contact point all round it.
    """
    wanted = np.maximum(depth / _BEARING_SHARE - radius_mm, 0.0)
    bearing = _least_near(surface, centre - radius_mm * normal, normal, wanted)
    return np.minimum(depth, _BEARING_SHARE * (radius_mm + bearing))


def round_crests(centre: Array, normal: Array, depth: Array, stiffness_n_mm: float) -> Array:
    """`depth` (T,) less what it takes to carry the hand round a crest: m v^2 / R of the force is spent on the turn.

    A hand that kept its force would come out on the far side of a sharp crest faster than any hand turns, with the
    contact point left behind on the near side for as long as it presses.
    """
    path = low_passed(centre, 2.5 * _FOLLOW_HZ, BASE_HZ)
    acceleration_mm_s2 = np.gradient(np.gradient(path, axis=0), axis=0) * BASE_HZ**2
    inward = np.maximum(-np.einsum("ij,ij->i", acceleration_mm_s2, normal), 0.0)
    return np.maximum(depth - 1e-3 * _HAND_KG * inward / stiffness_n_mm, 0.0)


def _room(surface: Surface, centre: Array, normal: Array, radius_mm: float) -> Array:
    """How high (T,) the tool may be lifted before it meets the other wall of a gap, at most `_LIFT_MM`."""
    wanted = np.full(len(centre), radius_mm + _LIFT_MM)
    return np.maximum(_least_near(surface, centre - radius_mm * normal, -normal, wanted) - radius_mm, 0.0)


def _least_near(surface: Surface, feet: Array, normal: Array, wanted: Array) -> Array:
    """The least of `Surface.bearing_mm` within 30 ms of every tick, softened, (T,)."""
    knots = np.arange(0, len(feet), _EVERY)
    reach = round(0.03 * BASE_HZ / _EVERY)
    bearing = surface.bearing_mm(feet[knots], normal[knots], wanted[knots])
    bearing = gaussian_filter1d(minimum_filter1d(bearing, 2 * reach + 1), 0.5 * reach)
    return np.interp(np.arange(len(feet)), knots, bearing)


def shaft_orientation(normals: Array, loop_hz: float) -> Array:
    """Quaternions (T, 4) w x y z that keep the tool's +z along the slowly followed normals (T, 3), without twist."""
    knots = max(int(np.ceil(len(normals) / loop_hz * 50.0)) + 1, 2)
    at = np.linspace(0.0, len(normals) - 1.0, knots)
    axes = _unit(low_passed(normals, _TURN_HZ, loop_hz))[np.round(at).astype(int)]
    turned = [_shortest_turn(np.array([0.0, 0.0, 1.0]), axes[0])]
    for before, after in pairwise(axes):
        turned.append(_product(_shortest_turn(before, after), turned[-1]))
    quaternions = np.asarray(CubicSpline(at, np.array(turned))(np.arange(len(normals))))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _depth_mm(time_s: Array, lifts: list[Lift], press: Press, rng: np.random.Generator) -> Array:
    """How far the HIP is pushed in: a log-normal force per contact, with 10 % of noise below 3 Hz."""
    forces = press.force_n * np.exp(press.force_sigma * spread_normals(len(lifts) + 1, rng))
    # the change from one force to the next happens in the air, halfway through the lift
    middles = np.array(sorted(0.5 * (lift.start_s + lift.stop_s) for lift in lifts))
    force = forces[np.searchsorted(middles, time_s)] * (1.0 + 0.1 * slow_noise(len(time_s), rng))
    return np.clip(force, 0.1 * press.force_n, press.max_force_n) / press.stiffness_n_mm


def _interpolated(at: Array, knots: Array, values: Array) -> Array:
    return np.stack([np.interp(at, knots, values[:, k]) for k in range(values.shape[1])], axis=1)


def _at(at_s: Array, time_s: Array, values: Array) -> Array:
    return values if len(at_s) == len(time_s) else _interpolated(at_s, time_s, values)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _shortest_turn(before: Array, after: Array) -> Array:
    """The quaternion of the least rotation between two unit vectors."""
    turn = np.concatenate([[1.0 + before @ after], np.cross(before, after)])
    if turn[0] < 1e-6:  # opposite: half a turn about anything across
        turn = np.concatenate([[0.0], np.cross(before, np.eye(3)[int(np.argmin(np.abs(before)))])])
    return turn / np.linalg.norm(turn)


def _product(p: Array, q: Array) -> Array:
    scalar = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[scalar], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])
