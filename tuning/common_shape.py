"""Surrogates of unlike scans in arrays of one shape, so that code compiled for one scan serves the next.

What a scan decides is how many rungs its ladder has. Rungs are added before the finest, where no level can lie: they
are given no weight, whatever they hold. (Behind the coarsest they would take its slope on the side of the ladder away.)
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from hapticlod.surrogate.ladder_curves import LadderCurves
from hapticlod.surrogate.measurement import LadderMeasurement

# Ladders of 300 to a million triangles have 5 to 15 rungs.
RUNG_STEP = 8


def in_common_shape(measured: LadderMeasurement) -> LadderMeasurement:
    """The same surrogate with its rungs filled up to a multiple of `RUNG_STEP`. One rung alone stays alone."""
    rungs = measured.coarseness.shape[0]
    added = -rungs % RUNG_STEP if rungs > 1 else 0
    if not added:
        return measured

    def filled(values: Array, axis: int = 0) -> Array:
        widths = [(0, 0)] * values.ndim
        widths[axis] = (added, 0)
        return jnp.pad(values, widths, mode="edge")

    def curves(its: LadderCurves) -> LadderCurves:
        # Level from the added rungs to the finest, whose own slope stays.
        return LadderCurves(filled(its.nodes, 1).at[1, :added].set(0.0))

    def replaced(part: eqx.Module, *names: str, axis: int = 0) -> eqx.Module:
        own = lambda whole: [getattr(whole, name) for name in names]
        made = [curves(x) if isinstance(x, LadderCurves) else filled(x, axis) for x in own(part)]
        return eqx.tree_at(own, part, made)

    feel = replaced(measured.feel, *measured.feel.__dataclass_fields__)
    traps = replaced(measured.traps, *measured.traps.__dataclass_fields__)
    instants = replaced(measured.instants, "offset_n", "gap_mm", "held", "rough_n", "rough_noticed")
    cost = replaced(measured.cost, "samples", "depth", "switch", "free_switch")
    cost = eqx.tree_at(lambda model: model.cells, cost, replaced(measured.cost.cells, "nodes", axis=2))
    ahead = -jnp.arange(added, 0, -1, dtype=measured.coarseness.dtype)
    whole = eqx.tree_at(
        lambda m: (m.coarseness, m.feel, m.traps, m.instants, m.cost),
        measured,
        (jnp.concatenate([ahead, measured.coarseness]), feel, traps, instants, cost),
    )
    return replaced(whole, "log_edge_mm", "log_bytes")  # pyright: ignore[reportReturnType] - what it was given
