"""Vertices no scan can have, seen in the bytes of a file: refused before a parser that is slow to import is."""

from __future__ import annotations

import numpy as np

from hapticlod.errors import InputError

# Beyond 1e9 mm (`hapticlod.repair`) in the smallest unit, micrometres, and so in all.
MOST_IN_FILE = 1e12
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD_BYTES = 84


def check_facets(data: bytes, where: str) -> None:
    """Raise InputError naming a far vertex of a binary STL file. Facets on numbers that are not finite are passed over.

    Args:
        data: of a whole file; bytes after the last whole facet do not count.
    """
    count = (len(data) - _HEAD_BYTES) // _FACET.itemsize
    corners = np.frombuffer(data, _FACET, count, _HEAD_BYTES)["corners"].reshape(-1, 3, 3)
    far = np.maximum(corners.max(axis=(1, 2), initial=0.0), -corners.min(axis=(1, 2), initial=0.0))
    # A facet that holds a NaN compares as false; one with an infinite corner is dropped by cleaning.
    if len(beyond := np.flatnonzero((far > MOST_IN_FILE) & (far < np.inf))):
        facet = int(beyond[0])
        corner = int(np.abs(corners[facet]).max(axis=1).argmax())
        raise far_vertex(where, 3 * facet + corner, float(far[facet]))


def check_vertices(vertices: np.ndarray, faces: np.ndarray, where: str) -> None:
    """Raise InputError naming a far vertex that a face uses.

    Args:
        vertices: (n, 3) of the file. faces: (m, k) indices, which may be out of range.
    """
    if not len(vertices):
        return
    far = np.abs(vertices).max(axis=1)
    if len(beyond := np.flatnonzero((far > MOST_IN_FILE) & (far < np.inf))):
        finite = np.flatnonzero(np.isfinite(far))
        whole = np.isin(faces, finite).all(axis=1)
        if len(used := np.intersect1d(beyond, faces[whole])):
            raise far_vertex(where, int(used[0]), float(far[used[0]]))


def far_vertex(where: str, vertex: int, far: float) -> InputError:
    """What is said of it."""
    return InputError(
        f"{where}, vertex {vertex}", f"lies {far:.3g} from the origin, too far in any unit", "delete the stray vertex"
    )
