"""Clean a triangle mesh and count truthfully what was found and what was mended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hapticlod.box import box_diagonal
from hapticlod.caps import contract_dust, flip_caps, is_flat
from hapticlod.errors import InputError
from hapticlod.morton import morton_order
from hapticlod.orientation import faces_to_flip, inside_out
from hapticlod.repair_report import Count, RepairReport
from hapticlod.topology import edge_table, vertex_components
from hapticlod.welding import weld_equal, weld_near_borders

# A face lower than this part of the extent has no normal to speak of: float32 coordinates resolve no better.
DEGENERATE_HEIGHT_OF_EXTENT = 1e-7
# Beyond this no scan is in mm: one stray vertex at 1e30 would leave every other vertex in a single cell.
LARGEST_COORDINATE_MM = 1e9
# A vertex so many times as far from the middle as nearly all others reach is a stray: levels are float32 about the
# centre, and what is small beside a stray would count as flat.
STRAY_OF_REACH = 1e3


def clean(
    vertices: np.ndarray, faces: np.ndarray, where: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, RepairReport]:
    """Weld, drop what is no triangle, orient, and sort along a space-filling curve.

    Args:
        vertices: (n, 3) float64 mm. faces: (m, 3) int, each index in 0..n-1. where: name for error messages.

    Returns:
        vertices (n', 3) float64 mm, each used by a face; faces (m', 3) int32; for each of these the face of the input
        (m',) that it comes from; the report. No coordinate is changed: every vertex of the result is a vertex of the
        input, bit for bit.

    Raises:
        InputError: nothing usable is left, a coordinate is beyond LARGEST_COORDINATE_MM, or a vertex is a stray.
    """
    count: dict[str, Any] = {}
    faces = faces.astype(np.int64)
    finite = _all_of_three(np.isfinite(vertices))
    usable = _all_of_three(finite[faces])
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    count["not_finite_vertices"] = _all_fixed((~finite).sum())
    count["faces_on_not_finite"] = _all_fixed((~usable).sum())
    count["unused_vertices"] = _all_fixed((~used & finite).sum())
    source = np.flatnonzero(usable)
    faces = _some_left(faces[usable], where, "every face has a vertex that is NaN or infinite")
    _check_places(vertices, faces, where)

    vertices, faces = _compact(vertices, faces)
    keep, group = weld_equal(vertices)
    count["equal_vertices"] = _all_fixed(len(vertices) - len(keep))
    vertices, faces = vertices[keep], group[faces]
    repeated = _repeats(faces)
    collapsed, faces, source = int(repeated.sum()), faces[~repeated], source[~repeated]
    _some_left(faces, where, "every face is degenerate (two of its corners are one point)")
    tolerance, goal = weld_near_borders(vertices, faces)
    count["near_vertices"] = _all_fixed((goal != np.arange(len(goal))).sum())
    faces = goal[faces]
    repeated = _repeats(faces)
    collapsed, faces, source = collapsed + int(repeated.sum()), faces[~repeated], source[~repeated]
    _some_left(faces, where, "every face is degenerate (two of its corners are one point)")
    height = DEGENERATE_HEIGHT_OF_EXTENT * box_diagonal(vertices)
    flat = is_flat(vertices, faces, height)
    collapsed += int(flat.sum())
    if flat.any():
        firm = source[~flat]
        faces = contract_dust(vertices, faces, height)[faces]
        repeated = _repeats(faces)
        source = source[~repeated]
        faces = flip_caps(vertices, faces[~repeated], height, source)
        flat = is_flat(vertices, faces, height)
        faces, source = faces[~flat], source[~flat]
        _some_left(faces, where, f"every face is lower than {height:.3g} mm, 1e-7 of its extent, so it has no normal")
        # Where dust lies in heaps, contracting it takes faces along that were not flat themselves.
        left_over = np.zeros(len(usable), dtype=bool)
        left_over[source] = True
        collapsed += int((~left_over[firm]).sum())
    count["degenerate_faces"] = _all_fixed(collapsed)
    single = _first_of_each(faces)
    count["duplicate_faces"] = _all_fixed(len(faces) - len(single))
    faces, source = faces[single], source[single]
    vertices, faces = _compact(vertices, faces)

    edges = edge_table(faces)
    clash = int((~edges.consistent).sum())
    flip = faces_to_flip(len(faces), edges)
    faces[flip] = faces[flip][:, ::-1]
    turned = int(flip.sum())
    left = edges if turned == 0 else edge_table(faces)
    count["inconsistent_edges"] = Count(clash, clash - int((~left.consistent).sum()))
    count["boundary_edges"] = Count(len(left.boundary))
    count["non_manifold_edges"] = Count(left.non_manifold)

    parts, part = vertex_components(faces, len(vertices))
    closed, inward, outward = inside_out(vertices, faces, parts, part, left)
    turn = outward[part]
    faces[turn] = faces[turn][:, ::-1]
    count["inside_out_components"] = Count(int(inward.sum()), int(outward.sum()))

    vertices, faces, order = _spatial_order(vertices, faces)
    report = RepairReport(
        triangles_read=len(usable),
        vertices_read=len(finite),
        triangles=len(faces),
        vertices=len(vertices),
        components=parts,
        closed_components=int(closed.sum()),
        weld_tolerance_mm=tolerance,
        turned_faces=turned + int(turn.sum()),
        **count,
    )
    return vertices, faces.astype(np.int32), source[order], report


def _all_of_three(mask: np.ndarray) -> np.ndarray:
    return mask[:, 0] & mask[:, 1] & mask[:, 2]  # several times faster than .all(axis=1)


def _all_fixed(number: float) -> Count:
    return Count(int(number), int(number))


def _some_left(faces: np.ndarray, where: str, what: str) -> np.ndarray:
    if len(faces) == 0:
        raise InputError(where, what, "export the scan again as a surface of triangles")
    return faces


def _check_places(vertices: np.ndarray, faces: np.ndarray, where: str) -> None:
    """Raise InputError naming the vertex that lies beyond what a scan can be, or a thousand times beyond the others."""
    mask = np.zeros(len(vertices), dtype=bool)
    mask[faces.ravel()] = True
    used = np.flatnonzero(mask)
    columns = [vertices[used, k] for k in range(3)]
    far, worst = _farthest(columns, (0.0, 0.0, 0.0))
    if far > LARGEST_COORDINATE_MM:
        raise InputError(
            f"{where}, vertex {used[worst]}",
            f"lies {far:.3g} mm from the origin, beyond {LARGEST_COORDINATE_MM:.0e} mm",
            "delete the stray vertex, or state the right unit",
        )
    spans = [np.quantile(column, (0.05, 0.5, 0.95)) for column in columns]
    reach_mm = max(float(max(high - middle, middle - low)) for low, middle, high in spans)
    far, worst = _farthest(columns, [float(middle) for _, middle, _ in spans])
    if far > STRAY_OF_REACH * reach_mm > 0.0:
        raise InputError(
            f"{where}, vertex {used[worst]}",
            f"lies {far:.3g} mm from the middle of the scan, which reaches {reach_mm:.3g} mm",
            "delete the stray vertex, or the part that it belongs to",
        )


def _farthest(columns: Sequence[np.ndarray], origin: Sequence[float]) -> tuple[float, int]:
    """Greatest distance along an axis of points, given by their coordinates (n,), from the origin; and whose it is."""
    distance = np.maximum.reduce([np.abs(x - at) for x, at in zip(columns, origin, strict=True)])
    worst = int(distance.argmax())
    return float(distance[worst]), worst


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop vertices that no face uses."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    if bool(used.all()):
        return vertices, faces
    return vertices[used], (np.cumsum(used) - 1)[faces]


def _repeats(faces: np.ndarray) -> np.ndarray:
    return (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])


def _first_of_each(faces: np.ndarray) -> np.ndarray:
    """Indices, ascending, of the first face over every set of three vertices."""
    low = np.minimum.reduce([faces[:, k] for k in range(3)])
    high = np.maximum.reduce([faces[:, k] for k in range(3)])
    middle = faces.sum(axis=1) - low - high
    order = np.argsort(low * (int(high.max()) + 1) + high, kind="stable")
    low, middle, high = low[order], middle[order], high[order]
    # Two vertices belong to few faces: sort by the third only where the first two agree.
    tie = (low[1:] == low[:-1]) & (high[1:] == high[:-1])
    run = np.concatenate(([0], np.cumsum(~tie)))
    tied = np.flatnonzero(np.concatenate((tie, [False])) | np.concatenate(([False], tie)))
    inner = tied[np.lexsort((order[tied], middle[tied], run[tied]))]
    repeat = np.zeros(len(faces), dtype=bool)
    repeat[order[inner[1:]]] = (run[inner[1:]] == run[inner[:-1]]) & (middle[inner[1:]] == middle[inner[:-1]])
    return np.flatnonzero(~repeat)


def _spatial_order(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    order = morton_order(vertices)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    vertices, faces = vertices[order], rank[faces]
    by_place = morton_order(vertices[faces].sum(axis=1))
    return vertices, faces[by_place], by_place
