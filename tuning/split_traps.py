"""Divides what a rung's replay errs by into what its surface does and what its past does (`surrogate.traps`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

Array = NDArray[np.float64]

# A rung is trapped where its error (squared) is so many times that of a fresh arrival, and of its own usual ones.
_TRAPPED = 4.0
# Instants that a trap may seem to be over for and is not.
_GAP = 3


def split_traps(own: Array, fresh: Array, starts: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """The excess that a rung owes to its past, and where it begins.

    Args:
        own: (R, B, I) squared error of the rungs' replays, means over instants.
        fresh: (R, B, I) of an arrival from the finest level.
        starts: (I,) instants that begin a motion.

    Returns:
        (R, B, I) excess, at least 0, and (R, B, I) bool.
    """
    touched = own.max(axis=(0, 1)) > 0
    usual = np.median(own[..., touched], axis=-1, keepdims=True) if touched.any() else np.zeros((*own.shape[:2], 1))
    limit = _TRAPPED * np.maximum(np.maximum(fresh, usual), 1e-12)
    over = np.asarray(binary_closing(own > limit, np.ones((1, 1, _GAP))), dtype=bool)
    before = np.concatenate([np.zeros_like(over[..., :1]), over[..., :-1]], axis=-1)
    excess = np.where(over, np.maximum(own - limit, 0.0), 0.0)
    return excess, over & (~before | starts)
