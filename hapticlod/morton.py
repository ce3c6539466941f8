"""Spatial order: neighbours in space become neighbours in memory (worth a factor of two in the loop)."""

from __future__ import annotations

import numpy as np

from hapticlod.box import bounding_box

_BITS = 20  # per axis: cells of one millionth of the extent


def morton_order(points: np.ndarray) -> np.ndarray:
    """Permutation (n,) that sorts points (n, 3) along the Z-order curve through their bounding box (Morton, 1966)."""
    low, high = bounding_box(points)
    span = float((high - low).max())
    scale = (2**_BITS - 1) / span if span > 0.0 else 0.0
    cell = ((points - low) * scale).astype(np.uint64)
    code = _spread(cell[:, 0]) | (_spread(cell[:, 1]) << np.uint64(1)) | (_spread(cell[:, 2]) << np.uint64(2))
    return np.argsort(code, kind="stable")


def _spread(value: np.ndarray) -> np.ndarray:
    """Put two zero bits before every bit of a 21-bit number."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
