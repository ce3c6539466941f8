"""Loop cost: what a tick costs at each level, what a switch adds, and the quantiles of the mixture.

Costs of neighbouring rungs are not alike tick by tick: candidates are gathered now here, now there, in bursts. What
moves smoothly along the ladder is their distribution at a speed of the hand. So windows of one motion and about one
speed make a group, whichever instants they come from: its ticks are sorted and interpolated as order statistics, in
the logarithm. A level's share of a group is that of its windows. (Sorted within single windows, a burst on one rung
met none on the next, and the tail between rungs came out a fifth to a third too low.) A group's dearest ticks are kept
one by one, the others as means: the tail is exact and the arrays stay small.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from hapticlod.surrogate.ladder_curves import LadderCurves, Places, cubic_weights, linear_weights, pchip_slopes
from hapticlod.surrogate.quantile import smooth_max, smooth_quantiles
from hapticlod.surrogate.switching import Switching, affine_scan

# Ticks of a group in one sample each, dearest first: 8 times 1, then 2, 4, 8, ... up to so large a part of the group.
SINGLE_TICKS = 8
LARGEST_PART = 8
# Of the ticks that enter a level, in one sample each, cheapest first.
SWITCH_SHARES = (0.2, 0.2, 0.2, 0.2, 0.1, 0.05, 0.03, 0.015, 0.005)


def sample_sizes(ticks: int) -> NDArray[np.int64]:
    """How many of a group's sorted ticks each sample stands for; they sum to `ticks`."""
    sizes, size, left = [], 1, ticks
    while left:
        sizes.append(min(size, left))
        left -= sizes[-1]
        if len(sizes) >= SINGLE_TICKS:
            size = max(1, min(2 * size, ticks // LARGEST_PART))
    return np.array(sizes)


def group_samples(cost: NDArray, group: NDArray[np.intp]) -> tuple[NDArray, NDArray[np.float64]]:
    """Mean costs of sorted ticks, group by group.

    **Arguments:**

    - `cost`: (..., T).
    - `group`: (windows,) the group that each window belongs to, 0 to G - 1; windows are T / windows ticks long.

    **Returns:** samples (..., G, S), dearest first, and (G, S) the ticks each stands for: 0 where a smaller group has
    none left.
    """
    windows = cost.reshape(*cost.shape[:-1], len(group), -1)
    parts, sizes = [], []
    for number in range(int(group.max()) + 1):
        ticks = windows[..., group == number, :]
        ordered = -np.sort(-ticks.reshape(*cost.shape[:-1], -1), axis=-1)
        size = sample_sizes(ordered.shape[-1])
        starts = np.concatenate([[0], np.cumsum(size)[:-1]])
        parts.append(np.add.reduceat(ordered, starts, axis=-1) / size)
        sizes.append(size)
    most = max(map(len, sizes))
    fill = [(0, 0)] * (cost.ndim - 1)
    samples = np.stack([np.pad(x, [*fill, (0, most - x.shape[-1])], mode="edge") for x in parts], axis=-2)
    return samples, np.stack([np.pad(x, (0, most - len(x))) for x in sizes]).astype(np.float64)


# A level further away than this, in the far relay's steps, costs no more to enter.
_FURTHEST = 1.5


class CellFactors(eqx.Module):
    """How cost changes with the cell size, relative to the cells that the ladder was replayed with.

    - `log_edges`: (H,) ln of cell size in mean edges, increasing.
    - `nodes`: (2, H, R, B, 3) values and slopes of the ln factor on the body of a rung's costs [..., 0], at its 99th
      [..., 1] and at its 99.9th percentile [..., 2].
    """

    log_edges: Float[Array, " H"]
    nodes: Float[Array, "2 H R B 3"]

    def levels(self, places: Places, log_cell_edges: Float[Array, " K"]) -> Float[Array, "K 3"]:
        """ln factors of each level."""
        along = cubic_weights(self.log_edges, log_cell_edges)
        return jnp.einsum("kvh,krb,vhrbt->kt", along, places.linear, self.nodes)


def cell_factors(cell_edges: NDArray, factors: NDArray) -> CellFactors:
    """From ln factors of shape (R, B, H, 3) at `cell_edges` (H,), increasing."""
    log_edges, values = np.log(cell_edges), np.moveaxis(factors, 2, 0)
    nodes = np.stack([values, pchip_slopes(log_edges, values)])
    return CellFactors(jnp.asarray(log_edges), jnp.asarray(nodes))


class SpeedFactors(eqx.Module):
    """How the cost of entering a level in contact changes with the hand's speed, relative to all entries of a relay.

    - `log_mm_s`: (C,) ln of speeds, increasing.
    - `log_factors`: (C, M) on the cost of each of `SWITCH_SHARES`.
    """

    log_mm_s: Float[Array, " C"]
    log_factors: Float[Array, "C M"]

    def at(self, log_speeds: Float[Array, " J"]) -> Float[Array, "J M"]:
        """ln factors of switches at these speeds (ln mm/s)."""
        return linear_weights(self.log_mm_s, log_speeds) @ self.log_factors


class CostModel(eqx.Module):
    """Measured tick costs of the ladder.

    - `samples`: ln ns, trailing shape (groups, samples), dearest first within a group.
    - `group`: (windows,) the group of each window.
    - `depth`: trailing shape as `samples`: how far a sample lies in its rung's tail. 0 is the body, 1 the 99th and 2
      the 99.9th percentile.
    - `switch`: ln ns of ticks that change the level in contact, by the level entered, trailing shape (M, 3): one sample
      for each of `SWITCH_SHARES`; from a next rung at either of two mapping lengths, and at the longer one from a rung
      far away. `log_reach`: (2,) ln of these lengths, mm. `steps`: (2,) |ln N - ln N'| of a next and of a far rung.
    - `free_switch`: the same without contact.
    - `by_speed`: how what `switch` says depends on the hand's speed.
    - `cells`: dependence on cell size.
    - `contact`: (m,) share of a bin's ticks in which the reference is in contact, of all bins that were priced.
    - `sizes`: (groups, samples) ticks that a sample stands for.
    - `spread`: width, in ln cost, that smooths quantiles, so that they have slopes.
    """

    samples: LadderCurves
    depth: LadderCurves
    switch: LadderCurves
    free_switch: LadderCurves
    by_speed: SpeedFactors
    log_reach: Float[Array, " 2"]
    steps: Float[Array, " 2"]
    cells: CellFactors
    contact: Float[Array, " m"]
    sizes: Float[Array, "G S"]
    group: Int[Array, " windows"]
    spread: Float[Array, ""]


class TickCosts(eqx.Module):
    """The mixture of tick costs of one configuration.

    - `log_ns`, `weights`: (n,) samples and the number of ticks each stands for.
    """

    log_ns: Float[Array, " n"]
    weights: Float[Array, " n"]

    def quantiles_us(self, probabilities: Sequence[float], spread: Float[Array, ""]) -> Float[Array, " q"]:
        """Quantiles of the loop cost, us."""
        return jnp.exp(smooth_quantiles(self.log_ns, self.weights, probabilities, spread)) * 1e-3

    def mean_us(self) -> Float[Array, ""]:
        """Mean loop cost, us."""
        return jnp.sum(self.weights * jnp.exp(self.log_ns)) / jnp.sum(self.weights) * 1e-3

    def share_over(self, budget_us: Float[Array, ""] | float, spread: Float[Array, ""]) -> Float[Array, ""]:
        """Share of ticks dearer than the budget."""
        over = jax.nn.sigmoid((self.log_ns - jnp.log(budget_us * 1e3)) / spread)
        return jnp.sum(self.weights * over) / jnp.sum(self.weights)


def tick_costs(
    model: CostModel,
    places: Places,
    log_cell_edges: Float[Array, " K"],
    switching: Switching,
    log_reach: Float[Array, ""],
    log_triangles: Float[Array, " K"],
    log_speeds: Float[Array, " J"],
) -> tuple[TickCosts, Float[Array, "K G S"], Float[Array, "K windows"]]:
    """The mixture over levels and switches; also each level's samples (ln ns) and its weight in every window.

    `log_reach` is ln of the longer mapping length, `log_triangles` of the levels' sizes, `log_speeds` of the switching
    speeds in mm/s.
    """
    depth = model.depth.levels(places)
    factors = model.cells.levels(places, log_cell_edges)
    body, p99, p999 = factors.T[:, :, None, None]
    of_cells = body + jnp.clip(depth, 0.0, 1.0) * (p99 - body) + jnp.clip(depth - 1.0, 0.0, 1.0) * (p999 - p99)
    log_ns = model.samples.levels(places) + of_cells
    levels, groups = log_ns.shape[:2]
    weights = jnp.mean(switching.weights.reshape(levels, model.group.shape[0], -1), axis=2)
    summed = jax.ops.segment_sum(weights.T, model.group, groups).T
    windows = jax.ops.segment_sum(jnp.ones_like(weights[0]), model.group, groups)
    shares = jnp.clip(summed / windows, 0.0, None)[:, :, None] * model.sizes
    # A switch's tick replaces an ordinary one; the difference of one in hundreds is left out.
    parts, counts = [log_ns.reshape(-1)], [shares.reshape(-1)]
    # The further a mapping looks, the more it meets; the further apart two levels are, the further the tool moves.
    long = jnp.clip((log_reach - model.log_reach[0]) / (model.log_reach[1] - model.log_reach[0]), 0.0, 1.0)
    span = jnp.maximum(model.steps[1] - model.steps[0], 1e-3)
    far = jnp.clip((jnp.abs(jnp.diff(log_triangles)) - model.steps[0]) / span, 0.0, _FURTHEST)  # (J,)
    mix = jnp.stack([jnp.broadcast_to(1 - long, far.shape), long - far, far])  # (3, J)
    by_speed = model.by_speed.at(log_speeds)
    free = jnp.zeros_like(by_speed)
    for curves, share_of, hurried in (
        (model.switch, model.contact, by_speed), (model.free_switch, 1 - model.contact, free),
    ):  # fmt: skip
        events = curves.levels(places)  # (K, M, 3)
        for entered, flow in ((slice(1, None), switching.up), (slice(None, -1), switching.down)):
            cost = jnp.einsum("jmx,xj->jm", events[entered], mix) + factors[entered, 1:2] + hurried
            parts.append(cost.reshape(-1))
            happened = jnp.sum(flow * share_of, axis=1)
            counts.append((happened[:, None] * jnp.array(SWITCH_SHARES, dtype=flow.dtype)).reshape(-1))
    return TickCosts(jnp.concatenate(parts), jnp.concatenate(counts)), log_ns, weights


def longest_run(
    log_ns: Float[Array, "K G S"],
    weights: Float[Array, "K windows"],
    model: CostModel,
    ticks: int,
    budget_us: Float[Array, ""] | float,
) -> Float[Array, ""]:
    """Longest expected run of ticks over budget.

    Within a window of so many ticks, and a group of windows, the order of ticks is not kept; a window whose share of
    misses is p continues a run with weight p^ticks.
    """
    over = jax.nn.sigmoid((log_ns - jnp.log(budget_us * 1e3)) / model.spread)
    share = jnp.sum(over * model.sizes, axis=2) / jnp.sum(model.sizes, axis=1)
    missed = jnp.clip(jnp.sum(weights * share[:, model.group], axis=0), 0.0, 1.0)
    # One miss is a run of 1; independent misses of share p make runs of p / (1 - p), at most the whole window.
    inside = jnp.minimum(missed * ticks, 1.0) * (1 - missed) + missed * ticks / (missed + (1 - missed) * ticks)
    run = affine_scan(missed**ticks, inside)
    return smooth_max(run, 0.05)
