"""Surface materials: stiffness and friction per face of a scan and per vertex of a level. docs/materials.md says how.

An array of materials has three columns, `COLUMNS`. NaN: the scan does not say, so it is the station's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapticlod.errors import HapticLODError, InputError

if TYPE_CHECKING:
    from hapticlod.scan import Scan

COLUMNS = ("stiffness_n_mm", "friction_static", "friction_dynamic")

AS_STATION = -1.0  # what the runtime and bundles hold for NaN
STIFFEST_N_MM, MOST_FRICTION = 1e6, 10.0  # runtime/core/material.hpp has the same limits
_FIX = "correct the value, or leave it out to have the station's"


def check_materials(values: np.ndarray, rows: int, where: str, row: str = "face") -> np.ndarray:
    """Materials as (rows, 3) float64. Raises InputError naming the first row that cannot be."""
    made = np.array(values, dtype=np.float64)
    if made.shape != (rows, 3):
        raise InputError(where, f"materials have shape {made.shape}", f"give one row of {', '.join(COLUMNS)} per {row}")
    stiffness, static, dynamic = made.T
    unstated = np.isnan(made)
    for bad, what in (
        (~unstated[:, 0] & ~((stiffness > 0) & (stiffness <= STIFFEST_N_MM)),
         lambda i: f"stiffness {stiffness[i]:g} N/mm is not above 0 and at most {STIFFEST_N_MM:g}"),
        (unstated[:, 1] != unstated[:, 2], lambda i: "has one coefficient of friction without the other"),
        (~unstated[:, 1] & ~((static >= 0) & (static <= MOST_FRICTION)),
         lambda i: f"static friction {static[i]:g} is not from 0 to {MOST_FRICTION:g}"),
        (~unstated[:, 2] & ~(dynamic >= 0), lambda i: f"dynamic friction {dynamic[i]:g} is negative"),
        (dynamic > static, lambda i: f"dynamic friction {dynamic[i]:g} exceeds the static friction {static[i]:g}"),
    ):  # fmt: skip
        if bad.any():
            at = int(np.argmax(bad))
            raise InputError(f"{where}, {row} {at}", what(at), _FIX)
    return made


def means(values: np.ndarray, weights: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Weighted mean of materials per group.

    A property is a group's where at least half of its weight states it; then the mean is over what states it. So the
    border to where nothing is stated stays in the middle.

    Args:
        values: (n, 3). weights: (n,) at least 0. group: (n,) in 0..groups-1.

    Returns:
        (groups, 3); NaN too for groups without members.
    """
    weights = np.asarray(weights, dtype=np.float64)
    weightless = np.bincount(group, weights, groups) <= 0.0
    weights = np.where(weightless[group], 1.0, weights)
    total = np.bincount(group, weights, groups)
    out = np.full((groups, 3), np.nan)
    for k in range(3):
        stated = ~np.isnan(values[:, k])
        if not stated.any():
            continue
        have = np.bincount(group[stated], weights[stated], groups)
        summed = np.bincount(group[stated], weights[stated] * values[stated, k], groups)
        enough = (have > 0.0) & (have >= 0.5 * total)
        # Clipped: rounding must not lead out of the range of what was given.
        low, high = values[stated, k].min(), values[stated, k].max()
        out[enough, k] = np.clip(summed[enough] / have[enough], low, high)
    out[:, 2] = np.minimum(out[:, 2], out[:, 1])
    return out


def vertex_means(vertices: np.ndarray, faces: np.ndarray, face_materials: np.ndarray) -> np.ndarray:
    """(n, 3): for every vertex the mean of the faces around it, weighted by their areas."""
    corners = np.asarray(faces, dtype=np.int64).ravel()
    weights = np.repeat(face_areas(vertices, faces), 3)
    return means(np.repeat(face_materials, 3, axis=0), weights, corners, len(vertices))


def transferred(values: np.ndarray, areas: np.ndarray, vertex_map: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Materials of a rung's vertices: of each the mean over the scan's vertices that became part of it, by area.

    Args:
        values: (n, 3) at the scan's vertices. areas: (n,) of the faces around them. vertex_map: (n,) into `vertices`.
        vertices: (v, 3) of the rung. One that no vertex of the scan maps to gets the material of the nearest that has.

    Raises:
        HapticLODError: the result is out of the range of what was given (a fault of this program).
    """
    made = means(values, areas, vertex_map, len(vertices))
    met = np.zeros(len(vertices), dtype=bool)
    met[vertex_map] = True
    if not met.all():
        from scipy.spatial import KDTree

        known = np.flatnonzero(met)
        made[~met] = made[known[KDTree(vertices[known]).query(vertices[~met])[1]]]
    for k, name in enumerate(COLUMNS):
        given, got = values[:, k], made[:, k]
        given, got = given[~np.isnan(given)], got[~np.isnan(got)]
        if len(got) and (len(given) == 0 or got.min() < given.min() or got.max() > given.max()):
            raise HapticLODError(f"{name} of a rung left the range of the scan's")
    if (np.isnan(made[:, 1]) != np.isnan(made[:, 2])).any() or (made[:, 2] > made[:, 1]).any():
        raise HapticLODError("friction of a rung does not fit together")
    return made


def to_runtime(materials: np.ndarray) -> np.ndarray:
    """(n, 3) float32 as the runtime takes them, `AS_STATION` for NaN."""
    return np.ascontiguousarray(np.where(np.isnan(materials), AS_STATION, materials), dtype=np.float32)


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(m,) mm^2."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n,) mm^2: of all faces around a vertex together."""
    corners = np.asarray(faces, dtype=np.int64).ravel()
    return np.bincount(corners, np.repeat(face_areas(vertices, faces), 3), len(vertices))


def material_lines(scan: Scan, stiffness_n_mm: float) -> list[str]:
    """What a scan is made of, in words, and how much of it is stiffer than a station renders (N/mm)."""
    if scan.face_materials is None:
        return []
    areas = face_areas(scan.vertices, scan.faces)
    lines = []
    for name, values in zip(COLUMNS, scan.face_materials.T, strict=True):
        stated = ~np.isnan(values)
        if stated.any():
            part = 100.0 * areas[stated].sum() / areas.sum()
            lines.append(f"{name} {values[stated].min():g} to {values[stated].max():g} on {part:.3g} % of the surface")
    capped = np.nan_to_num(scan.face_materials[:, 0]) > stiffness_n_mm
    if capped.any():
        part = 100.0 * areas[capped].sum() / areas.sum()
        lines.append(f"{part:.3g} % is stiffer than the station's {stiffness_n_mm:g} N/mm and is rendered with that")
    return lines
