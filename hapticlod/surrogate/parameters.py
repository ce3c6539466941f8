"""What the surrogate is a function of: a configuration as real numbers, padded to a fixed number of levels."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# ln mm/s that no hand reaches: the threshold of a level that is not there.
UNREACHED_LOG_SPEED = 40.0


class Parameters(eqx.Module):
    """One configuration of up to K levels, finest first. Logarithms are natural, of mm, mm/s and counts; cell sizes are
    in mean edges of the level.

    Entries of levels that are not used still hold numbers (those of the last used level do); their speeds are out of
    reach and their weight in every metric is 0.
    """

    levels: Int[Array, ""]
    log_triangles: Float[Array, " K"]
    log_balls: Float[Array, " K"]
    log_cell_edges: Float[Array, " K"]
    log_speeds: Float[Array, " J"]
    hysteresis: Float[Array, ""]
    filter_hz: Float[Array, ""]
    blend_s: Float[Array, ""]
    log_l_in: Float[Array, ""]
    log_l_out: Float[Array, ""]

    @property
    def used(self) -> Float[Array, " K"]:
        """1 for levels that are there, else 0."""
        count = self.log_triangles.shape[0]
        return jnp.where(jnp.arange(count) < self.levels, 1.0, 0.0)

    @property
    def reachable_log_speeds(self) -> Float[Array, " J"]:
        """`log_speeds`, those of unused levels out of reach."""
        count = self.log_speeds.shape[0]
        return jnp.where(jnp.arange(count) < self.levels - 1, self.log_speeds, UNREACHED_LOG_SPEED)
