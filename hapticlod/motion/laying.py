"""Lays a recording that was made elsewhere on a scan.

The path is rolled onto the surface (developed): every bit of it keeps its length and its turn against the bit
before, so that speeds and bends are the recorded hand's own, times the stated scales. Its place, its height above its
main plane and its closed loops do not survive; the provenance says so.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hapticlod.errors import InputError
from hapticlod.motion.hand import Press, hand_motion
from hapticlod.motion.motion import Motion
from hapticlod.motion.smooth import low_passed
from hapticlod.motion.strokes import BASE_HZ
from hapticlod.motion.surface import ScanLike, surface_of
from hapticlod.motion.synthesise import Turns
from hapticlod.motion.track import track_over
from hapticlod.motion.walk import step_for
from hapticlod.tool import Tool, point

Array = NDArray[np.float64]

_NOISE_HZ = 12.0  # voluntary motion is below; measuring noise would lengthen the path


def near_share(motion: Motion, scan: ScanLike, within_mm: float) -> float:
    """Share of a motion's ticks that are within `within_mm` of the scan's surface, 0 to 1."""
    return surface_of(scan).near_share(motion.position_mm, within_mm)


def lay_on_scan(
    motion: Motion,
    scan: ScanLike,
    *,
    tool: Tool | None = None,
    stiffness_n_mm: float = 1.0,
    force_n: float = 0.8,
    max_force_n: float = 12.0,
    encoder_mm: float = 0.023,
    time_scale: float = 1.0,
    space_scale: float | None = None,
    seed: int = 0,
) -> Motion:
    """The hand of `motion`, on the surface of `scan`, at the motion's loop rate.

    Args:
        motion: a recording; its time may be slowed by `time_scale` (3 to 8 makes probing of arm motion), its path
            scaled by `space_scale` (None: down to the scan's extent where it is larger, otherwise 1).
        scan, tool, stiffness_n_mm, force_n, max_force_n, encoder_mm: as in `synthesise`.
        seed: of the place where it starts, of force and tremor.

    Raises:
        InputError: a scale that is not positive, or a motion that does not move.
    """
    for field, value in {"time_scale": time_scale, "space_scale": 1.0 if space_scale is None else space_scale}.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(field, f"{value} is no factor", "give a positive number")
    tool = tool or point()
    surface = surface_of(scan)
    path_extent_mm = float(np.linalg.norm(np.ptp(motion.position_mm, axis=0)))
    if path_extent_mm <= 0:
        raise InputError(f"motion {motion.name}", "does not move", "give a motion that does")
    if space_scale is None:
        space_scale = min(1.0, surface.extent_mm / path_extent_mm)

    smooth = low_passed(motion.position_mm, _NOISE_HZ, motion.loop_hz)
    flat, flatness = _main_plane(smooth * space_scale)
    stretched_s = motion.time_s * time_scale
    at_s = np.arange(max(round(float(stretched_s[-1]) * BASE_HZ) + 1, 20)) / BASE_HZ
    flat = np.asarray(CubicSpline(stretched_s, flat)(np.minimum(at_s, stretched_s[-1])))
    velocity = np.gradient(flat, 1.0 / BASE_HZ, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    travelled = np.cumsum(speed) / BASE_HZ
    step_mm = step_for(surface, float(travelled[-1]), float(at_s[-1]))
    rng = np.random.default_rng([seed, 97])
    turns = Turns(np.append(travelled, 1e30), _headings(flat, travelled, step_mm))
    track, normals = track_over(surface, 1.1 * float(travelled[-1]), step_mm, turns, tool.reference_radius_mm, rng)
    press = Press(force_n, 0.5, max_force_n, stiffness_n_mm, encoder_mm)
    provenance = {
        **motion.provenance,
        "laid_on_scan": str(getattr(scan, "digest", "")),
        "laid_how": "path rolled onto the surface; height above its main plane dropped; force and tremor synthesised",
        "laid_time_scale": time_scale,
        "laid_space_scale": round(space_scale, 6),
        "laid_planar_share": round(flatness, 4),
        "laid_seed": seed,
        "source_digest": motion.digest,
    }
    name = f"{motion.name}-laid"
    return hand_motion(surface, track, normals, speed, [], press, tool, motion.loop_hz, rng, name, provenance)


def _main_plane(path: Array) -> tuple[Array, float]:
    """The path (T, 2) in the plane that holds most of it, and the share of its variance that lies there."""
    centred = path - path.mean(axis=0)
    _, values, axes = np.linalg.svd(centred[:: max(1, len(centred) // 20_000)], full_matrices=False)
    energy = np.square(values)
    return centred @ axes[:2].T, float(energy[:2].sum() / energy.sum())


def _headings(flat: Array, travelled: Array, step_mm: float) -> Array:
    """Heading (T + 1,) of the path at every tick, taken over one step of the walk, unwrapped."""
    ahead = np.searchsorted(travelled, travelled + step_mm).clip(max=len(flat) - 1)
    chord = flat[ahead] - flat
    still = np.linalg.norm(chord, axis=1) < 0.2 * step_mm
    heading = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    if still.all():
        return np.zeros(len(flat) + 1)
    moving = np.flatnonzero(~still)
    held = heading[moving[np.searchsorted(moving, np.arange(len(flat)), side="right").clip(min=1) - 1]]
    return np.append(held, held[-1])
