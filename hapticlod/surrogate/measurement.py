"""What replays of a ladder gave, as arrays: everything the surrogate knows about a scan, a tool, a hand and a station.

Time is kept at three rates. Ticks: velocity, for filter and triggers. Bins of a few ticks: what levels do to the feel
(means within a bin). Instants, every few bins: what a switch would do there; that is dear to ask, so a long motion has
fewer of them, all over it. Axes: R rungs (finest first), B ball subsets (all balls first), T ticks, m bins of all
motions, n bins of the feel (all that fill an instant), I instants.
"""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from hapticlod.perception import Perception
from hapticlod.surrogate.cost import CostModel
from hapticlod.surrogate.ladder_curves import LadderCurves
from hapticlod.surrogate.traps import Traps


class Feel(eqx.Module):
    """What a level does to the feel, per bin: curves with trailing shape (n,), means over the bin's ticks.

    F is the level's force, R the reference's; "either" and "both" say which of them is in contact.

    - `felt`: |F - R|^2 / JND(R)^2 times the felt share, where either; without what `Traps` holds of it.
    - `force_sq`: |F - R|^2, N^2, where either; likewise. `peak_n`: the bin's largest |F - R|.
    - `band_sq`: |band-passed (F - R)|^2, N^2, of the error where both.
    - `either`, `both`, `contact`: shares of ticks; `contact` is F's.
    - `depth_mm`: |SCP - HIP|, mean over the bin's ticks in contact.
    - `release`, `pop`: contacts lost and far sides begun, per tick.
    - `work_mj`: F dx on the hand, per tick.
    """

    felt: LadderCurves
    force_sq: LadderCurves
    peak_n: LadderCurves
    band_sq: LadderCurves
    either: LadderCurves
    both: LadderCurves
    contact: LadderCurves
    depth_mm: LadderCurves
    release: LadderCurves
    pop: LadderCurves
    work_mj: LadderCurves


class Instants(eqx.Module):
    """What a switch meets. All forces in N.

    - `offset_n`: (R, B, I, 3) stiffness times (SCP of the rung - SCP of the finest), both from the same place.
    - `gap_mm`: (R, B, I) how far outward the rung's surface lies of the finest's, along the force.
    - `held`: (R, B, I) 1 where the rung is in contact, else 0.
    - `rough_n`: (R, B, W, I) largest |dF| - |dR| of a tick, at least 0, in the window that begins here; W windows.
    - `rough_noticed`: (R, B, W, I) probability that it is noticed as a jump.
    - `windows`: (W,) ticks in these windows beyond the first, from 0.
    - `force_n`, `step_n`: (I, 3) reference force, and its change in one tick.
    - `contact`: (I,) share of the instant's ticks in which the reference is in contact.
    - `starts`: (I,) instants that begin a motion.
    - `lost_felt`, `lost_force_sq`: (I,) what `felt` and `force_sq` would be with no contact.
    - `ticks`: that one instant stands for.
    - `felt_per_n2`: (I,) felt share / JND^2: what an error of 1 N would be felt as.
    """

    offset_n: Float[Array, "R B I 3"]
    gap_mm: Float[Array, "R B I"]
    held: Float[Array, "R B I"]
    rough_n: Float[Array, "R B W I"]
    rough_noticed: Float[Array, "R B W I"]
    windows: Float[Array, " W"]
    force_n: Float[Array, "I 3"]
    step_n: Float[Array, "I 3"]
    contact: Float[Array, " I"]
    starts: Bool[Array, " I"]
    lost_felt: Float[Array, " I"]
    lost_force_sq: Float[Array, " I"]
    felt_per_n2: Float[Array, " I"]
    ticks: Float[Array, ""]


class LadderMeasurement(eqx.Module):
    """Everything measured.

    - `coarseness`: (R,) ln(N_0 / N). `log_finest`: ln N_0.
    - `thinness`: (B,) ln(P_0 / P). `log_all_balls`: ln P_0.
    - `log_edge_mm`: (R,) ln mean edge.
    - `velocity_mm_s`: (T, 3) raw.
    - `starts`: (T,) ticks that begin a motion.
    - `felt_bins`: (n,) the feel's bins among all.
    - `cycle`: (n,) contact cycle of the reference that a bin belongs to; 0: none, or one that is not complete.
    - `cycles`: how many there are, 0 among them.
    - `log_bytes`: curves with trailing shape (H,): ln bytes of a level by cell size; `log_cell_edges`: (H,).
    - `tick_s`, `dwell_ticks`, `stiffness_n_mm`, `perception`: of the loop, the configuration space and the station.
    """

    coarseness: Float[Array, " R"]
    thinness: Float[Array, " B"]
    log_finest: Float[Array, ""]
    log_all_balls: Float[Array, ""]
    log_edge_mm: Float[Array, " R"]
    velocity_mm_s: Float[Array, "T 3"]
    starts: Bool[Array, " T"]
    felt_bins: Int[Array, " n"]
    cycle: Int[Array, " n"]
    feel: Feel
    traps: Traps
    instants: Instants
    cost: CostModel
    log_bytes: LadderCurves
    log_cell_edges: Float[Array, " H"]
    stiffness_n_mm: Float[Array, ""]
    cycles: int = eqx.field(static=True)
    tick_s: float = eqx.field(static=True)
    dwell_ticks: int = eqx.field(static=True)
    perception: Perception = eqx.field(static=True)

    @property
    def ticks(self) -> int:
        """T."""
        return self.velocity_mm_s.shape[0]

    @property
    def ticks_per_bin(self) -> int:
        """T / m."""
        return self.ticks // self.cost.contact.shape[0]

    @property
    def bins(self) -> int:
        """n."""
        return self.cycle.shape[0]

    @property
    def felt_seconds(self) -> float:
        """Duration of the feel's part."""
        return self.bins * self.ticks_per_bin * self.tick_s

    @property
    def seconds(self) -> float:
        """Duration of all motions together."""
        return self.ticks * self.tick_s
