"""What happens to contact in a record, beside its reference: losses, far sides, cycles and their energy."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_OPPOSED = -0.5  # cosine below which two penetration directions are held to be of opposite sides


def stretches(flags: Flags) -> NDArray[np.intp]:
    """(S, 2) first index and end (exclusive) of every run of True."""
    edges = np.diff(np.concatenate([[0], np.asarray(flags, dtype=np.int8), [0]]))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])


def false_releases(contact: Flags, reference_contact: Flags, slack_ticks: int) -> NDArray[np.intp]:
    """Ticks at which contact is lost though the reference is in contact then and for `slack_ticks` more.

    A rung that lies a little lower is left a little earlier: that is an error of force, not a false release.
    """
    lost = np.flatnonzero(contact[:-1] & ~contact[1:]) + 1
    if len(lost) == 0:
        return lost
    ends = np.minimum(lost + slack_ticks, len(contact) - 1)
    free_before = np.concatenate([[0], np.cumsum(~reference_contact)])
    return lost[free_before[ends + 1] == free_before[lost]]


def far_sides(out: Array, reference_out: Array, slack_ticks: int) -> NDArray[np.intp]:
    """First ticks of stretches longer than `slack_ticks` in which the tool is held from the far side.

    Args:
        out, reference_out: (T, 3) SCP - HIP of record and reference, 0 where not in contact.
        slack_ticks: shortest stretch that counts; the reference's last direction is held four times as long, for
            a tool that comes out of a body it has fallen into is held back when the reference is free already.
    """
    held, held_since = _held(reference_out)
    lengths = np.linalg.norm(out, axis=1) * np.linalg.norm(held, axis=1)
    cosine = np.einsum("ij,ij->i", out, held) / np.where(lengths > 0, lengths, 1.0)
    runs = stretches((cosine < _OPPOSED) & (held_since <= 4 * slack_ticks))
    return runs[runs[:, 1] - runs[:, 0] > slack_ticks, 0]


def _held(vectors: Array) -> tuple[Array, NDArray[np.intp]]:
    """The newest nonzero vector at every tick, and how many ticks old it is."""
    ticks = np.arange(len(vectors))
    newest = np.maximum.accumulate(np.where((vectors != 0).any(axis=1), ticks, -1))
    return np.where(newest[:, None] >= 0, vectors[newest], 0.0), ticks - newest


def cycle_energies_mj(force_n: Array, hip_mm: Array, contact: Flags) -> Array:
    """Energy given to the hand in every complete contact cycle, mJ: the integral of F dx, F the force on the hand.

    Trapezoidal, from the last tick before a contact to the first after it. An ideal spring gives 0, a damper less, a
    renderer that moves its spring's rest position toward the HIP for nothing gives more.
    """
    work = np.zeros(len(contact))
    work[1:] = np.einsum("ij,ij->i", 0.5 * (force_n[1:] + force_n[:-1]), np.diff(hip_mm, axis=0))
    total = np.concatenate([[0.0], np.cumsum(work)])
    runs = stretches(contact)
    runs = runs[(runs[:, 0] > 0) & (runs[:, 1] < len(contact))]
    return total[runs[:, 1] + 1] - total[runs[:, 0]]
