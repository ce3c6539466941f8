"""A generated lower dentition: a scan of known shape and any size, for tests and demos without patient data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hapticlod.dentition_teeth import RETROMOLAR_MM, Row, chewing_relief, grow_teeth
from hapticlod.errors import InputError
from hapticlod.scan import Scan, scan_from_arrays

FEWEST_TRIANGLES, MOST_TRIANGLES = 2_000, 6_000_000
# Half an ellipse; with the gum outside it the jaw is about 65 mm wide.
ARCH_HALF_WIDTH_MM, ARCH_DEPTH_MM = 27.0, 45.0
PIT_DEPTH_MM, PIT_SIGMA_MM, PITS_PER_TOOTH = 0.1, 0.2, 8
SPANS = 18  # of the spline across the ridge, from the tongue's gum border to the cheek's
TABLE = (7.0, 11.0)  # the part of those that is the chewing surface
CROWN = (5.0, 13.0)  # and the crown


@dataclass(frozen=True)
class Pits:
    """Pits in the enamel. centre_mm (n, 3): their places on the surface without pits or noise. outward (n, 3): unit."""

    centre_mm: np.ndarray
    outward: np.ndarray


def make_dentition(triangles: int = 290_000, seed: int = 0, noise_um: float = 8.0) -> Scan:
    """Make a lower jaw of 14 teeth with gum: one sheet with one border, normals outward, z up, front towards +y.

    Args:
        triangles: wanted number, 2 000 to 6 000 000; the result is within 1 % of it.
        seed: of the sizes and places of teeth and pits, and of the noise. noise_um: standard deviation of the
            scanner's noise along the normal, independent at each vertex.

    Raises:
        InputError: an argument is out of range.
    """
    if not FEWEST_TRIANGLES <= triangles <= MOST_TRIANGLES:
        wanted = f"give {FEWEST_TRIANGLES} to {MOST_TRIANGLES}"
        raise InputError("dentition", f"cannot be made of {triangles} triangles", wanted)
    if not 0.0 <= noise_um < 1000.0:
        raise InputError("dentition", f"noise of {noise_um} um is out of range", "give 0 or more, below 1000 um")
    row, pits, noise = _grow(seed)
    along_mm, across, columns = _lay_grid(row, triangles)
    grid, _ = _surface(row, along_mm, across)
    _press_pits(grid, pits, along_mm, row)
    if noise_um > 0.0:
        grid += noise.normal(0.0, noise_um * 1e-3, grid.shape[:2])[..., None] * _grid_normals(grid)
    return scan_from_arrays(grid.reshape(-1, 3), _faces(grid, columns), name="dentition")


def dentition_pits(seed: int = 0) -> Pits:
    """The pits that `make_dentition` presses into the teeth for this seed, PIT_DEPTH_MM deep."""
    return _grow(seed)[1]


def _grow(seed: int) -> tuple[Row, Pits, np.random.Generator]:
    teeth, pitting, noise = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(3))
    row = grow_teeth(teeth)
    count = len(row.kinds)
    part = 0.5 + 0.3 * pitting.uniform(-1.0, 1.0, (count, PITS_PER_TOOTH))
    along_mm = (row.start[:, None] + part * (row.end - row.start)[:, None]).ravel()
    across = pitting.uniform(CROWN[0] + 0.6, CROWN[1] - 0.6, (len(along_mm), 1))
    centre, section = _surface(row, along_mm, across)
    step = 1e-4
    ahead, _ = _surface(row, along_mm + step, across)
    aside, _ = _surface(row, along_mm, across + step)
    outward = np.cross(aside[:, 0] - centre[:, 0], ahead[:, 0] - centre[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * section[:, 0], axis=1))[:, None]
    return row, Pits(centre[:, 0], outward), noise


def _surface(row: Row, along_mm: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, m, 3) and the ridge's normals within its cross-sections, at (n,) mm along and (n, m) spans across."""
    control = _control_points(row, along_mm)
    first = np.clip(across.astype(np.int64), 0, SPANS - 1)
    x = across - first
    weights = ((1 - x) ** 3, 3 * x**3 - 6 * x**2 + 4, -3 * x**3 + 3 * x**2 + 3 * x + 1, x**3)
    slopes = (-((1 - x) ** 2), 3 * x**2 - 4 * x, -3 * x**2 + 2 * x + 1, x**2)
    line = np.arange(len(along_mm))[:, None]
    out, up, out_slope, up_slope = (np.zeros(across.shape) for _ in range(4))
    for k in range(4):
        node = control[line, first + k]
        out += weights[k] * node[..., 0] / 6.0
        up += weights[k] * node[..., 1] / 6.0
        out_slope += slopes[k] * node[..., 0]
        up_slope += slopes[k] * node[..., 1]
    length = np.hypot(out_slope, up_slope)
    normal_out, normal_up = -up_slope / length, out_slope / length

    on_table = _smooth_step(across - TABLE[0] + 0.9) * _smooth_step(TABLE[1] + 0.9 - across)
    relief = np.zeros(across.shape)
    offset = row.fields(along_mm)[:, 5:]
    for kind, mirror, start, end in zip(row.kinds, row.mirror, row.start, row.end, strict=True):
        mine = np.flatnonzero((along_mm >= start) & (along_mm < end))
        if len(mine):
            local = along_mm[mine, None] - 0.5 * (start + end)
            fade = _smooth_step(4.0 * (1.0 - np.abs(local) / (0.5 * (end - start))))
            relief[mine] = fade * chewing_relief(kind, mirror, local, out[mine] - offset[mine])
    relief *= on_table
    out += relief * normal_out
    up += relief * normal_up

    centre, cheekward = _arch(along_mm)
    points = np.empty((*across.shape, 3))
    section = np.empty_like(points)
    for axis in range(2):
        points[..., axis] = centre[:, axis, None] + cheekward[:, axis, None] * out
        section[..., axis] = cheekward[:, axis, None] * normal_out
    points[..., 2], section[..., 2] = up, normal_up
    return points, section


def _control_points(row: Row, along_mm: np.ndarray) -> np.ndarray:
    """Nodes (n, SPANS + 3, 2) of a uniform cubic spline across the ridge: mm towards the cheek, mm up."""
    half_depth, half_table, top, margin, basin, offset = row.fields(along_mm).T
    spee = 1.2 * (along_mm / 55.0) ** 2  # the curve of Spee: the back teeth stand higher
    gum = 4.3 + 1.9 / (1.0 + np.exp((32.0 - np.abs(along_mm)) / 5.0))
    rise = top - margin
    neck = np.clip(rise / 4.0, 0.0, 1.0)  # no neck where there is no crown: the sheet would fold over itself
    zero = np.zeros_like(gum)
    half = [
        (gum + 1.6, zero - 6.5),
        (gum + 1.3, zero - 5.0),
        (gum + 0.8, zero - 3.0),
        (gum + 0.25, 0.6 * margin - 1.1),
        (half_depth + 0.3, margin + 0.25 * neck),
        (half_depth * (1.0 - 0.14 * neck), margin + 0.05 * rise + 0.3 * neck),
        (half_depth * (0.94 + 0.06 * neck), margin + 0.35 * rise),
        (0.75 * half_depth + 0.25 * half_table, margin + 0.7 * rise),
        (half_table * 1.1, top - 0.3 - 0.05 * rise),
        (half_table * 0.6, top),
    ]
    points = [(-out + offset, up) for out, up in half] + [(offset, top - basin)]
    points += [(out + offset, up) for out, up in reversed(half)]
    return np.stack([np.stack((out, up + spee), axis=-1) for out, up in points], axis=1)


def _arch(along_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of the arch's middle line, and unit normals (n, 2) towards the cheek."""
    angle = np.linspace(-2.2, 2.2, 4001)
    step = np.hypot(ARCH_HALF_WIDTH_MM * np.cos(angle), ARCH_DEPTH_MM * np.sin(angle))
    length = np.concatenate(([0.0], np.cumsum(0.5 * (step[1:] + step[:-1]) * np.diff(angle))))
    at = np.interp(along_mm, length - 0.5 * length[-1], angle)
    centre = np.stack((ARCH_HALF_WIDTH_MM * np.sin(at), ARCH_DEPTH_MM * (np.cos(at) - 0.5)), axis=1)
    normal = np.stack((ARCH_DEPTH_MM * np.sin(at), ARCH_HALF_WIDTH_MM * np.cos(at)), axis=1)
    return centre, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _lay_grid(row: Row, triangles: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Places along (n,) mm and across (n, m) spans of a grid whose edges are about equal, and its columns m."""
    along = np.linspace(row.start[0] - RETROMOLAR_MM, row.end[-1] + RETROMOLAR_MM, 1200)
    across = np.linspace(0.0, SPANS, 181)
    draft, _ = _surface(row, along, np.broadcast_to(across, (len(along), len(across))))
    # The mean length keeps edges about equal; a little smoothing spares the grid sudden changes between teeth.
    stretch = np.linalg.norm(np.diff(draft, axis=0), axis=2)
    stretch = gaussian_filter1d(np.sqrt((stretch**2).mean(axis=1)), 4.0, mode="nearest")
    reach = np.concatenate(([0.0], np.cumsum(stretch)))
    girth = np.concatenate((np.zeros((len(along), 1)), np.linalg.norm(np.diff(draft, axis=1), axis=2)), axis=1)
    girth = np.cumsum(girth, axis=1)
    width = float(girth[:, -1].mean())
    girth = gaussian_filter1d(girth / girth[:, -1:], 10.0, axis=0, mode="nearest")

    columns = max(round(float(np.sqrt(0.5 * triangles * width / reach[-1]))), 1)
    rows = round(0.5 * triangles / columns)
    even = np.linspace(0.0, 1.0, columns + 1)
    spread = np.stack([np.interp(even, line, across) for line in girth])
    along_mm = np.interp(np.linspace(0.0, reach[-1], rows + 1), reach, along)
    place = np.clip((along_mm - along[0]) / (along[1] - along[0]), 0.0, len(along) - 1.000001)
    below = place.astype(np.int64)
    part = (place - below)[:, None]
    return along_mm, (1.0 - part) * spread[below] + part * spread[below + 1], columns + 1


def _press_pits(grid: np.ndarray, pits: Pits, along_mm: np.ndarray, row: Row) -> None:
    """Push vertices in by a Gaussian of their distance to each pit; only the rows of its tooth are looked at."""
    shape = grid.copy()
    for k, (centre, outward) in enumerate(zip(pits.centre_mm, pits.outward, strict=True)):
        tooth = k // PITS_PER_TOOTH
        low, high = np.searchsorted(along_mm, (row.start[tooth], row.end[tooth]))
        near = np.zeros(grid[low:high].shape[:2])
        for axis in range(3):
            near += (shape[low:high, :, axis] - centre[axis]) ** 2
        i, j = np.nonzero(near < (4.0 * PIT_SIGMA_MM) ** 2)
        depth = PIT_DEPTH_MM * np.exp(near[i, j] / (-2.0 * PIT_SIGMA_MM**2))
        grid[low + i, j] -= depth[:, None] * outward


def _grid_normals(grid: np.ndarray) -> np.ndarray:
    normal = np.cross(np.gradient(grid, axis=0), np.gradient(grid, axis=1))
    normal *= _outward_sign(grid)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return normal


def _outward_sign(grid: np.ndarray) -> float:
    """+1 where (along x across) points out of the jaw; a fixed fact of the grid, taken from its crest."""
    middle = grid.shape[1] // 2
    along, across = (np.gradient(grid[:, middle - 1 : middle + 2], axis=axis) for axis in (0, 1))
    return float(np.sign(np.cross(along, across)[..., 2].sum()))


def _faces(grid: np.ndarray, columns: int) -> np.ndarray:
    """Two triangles per cell, cut along its shorter diagonal, counter-clockwise seen from outside."""
    number = np.arange(grid.shape[0] * columns).reshape(grid.shape[0], columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    flat = grid.reshape(-1, 3)
    shorter = (((flat[a] - flat[c]) ** 2).sum(axis=1) <= ((flat[b] - flat[d]) ** 2).sum(axis=1))[:, None]
    first = np.where(shorter, np.stack((a, b, c), axis=1), np.stack((a, b, d), axis=1))
    second = np.where(shorter, np.stack((a, c, d), axis=1), np.stack((b, c, d), axis=1))
    faces = np.concatenate((first, second))
    return faces if _outward_sign(grid) > 0 else faces[:, ::-1]


def _smooth_step(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
