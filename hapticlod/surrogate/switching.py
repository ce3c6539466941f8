"""Which level a tick uses, smoothly: filtered speed, soft Schmitt triggers, the flow of switches.

One trigger per threshold: s = 1 where the level lies above it. With ordered thresholds K - 1 independent triggers are
the runtime's state machine exactly (a jump over several levels trips several of them). Each is affine in its state,
s_t = (1 - u_t - d_t) s_{t-1} + u_t, so a scan runs them (DESIGN.md section 7).
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def _recurrence(gain: Float[Array, "T *s"], offset: Float[Array, "T *s"]) -> Float[Array, "T *s"]:
    """On a CPU a plain loop, which XLA compiles into one small kernel: measured, it is several times faster than
    `associative_scan`, and its compilation ten times. Elsewhere the parallel scan."""
    if jax.default_backend() != "cpu":

        def join(first, second):
            return first[0] * second[0], second[0] * first[1] + second[1]

        return jax.lax.associative_scan(join, (gain, offset))[1]

    def step(x, now):
        x = now[0] * x + now[1]
        return x, x

    return jax.lax.scan(step, jnp.zeros_like(offset[0]), (gain, offset))[1]


@jax.custom_jvp
def affine_scan(gain: Float[Array, "T *s"], offset: Float[Array, "T *s"]) -> Float[Array, "T *s"]:
    """x_t = gain_t x_{t-1} + offset_t from x = 0 before the first step. Both of one shape."""
    return _recurrence(gain, offset)


@affine_scan.defjvp
def _affine_scan_jvp(primals, tangents):
    # The tangent obeys the same recurrence: no need to differentiate products of many gains.
    gain, offset = primals
    x = affine_scan(gain, offset)
    before = jnp.concatenate([jnp.zeros_like(x[:1]), x[:-1]])
    return x, _recurrence(gain, tangents[0] * before + tangents[1])


def filtered_speed_mm_s(
    velocity_mm_s: Float[Array, "T 3"],
    starts: Bool[Array, " T"],
    filter_hz: Float[Array, ""],
    tick_s: float,
) -> Float[Array, " T"]:
    """Speed after the runtime's one-pole filter on each component.

    **Arguments:**

    - `velocity_mm_s`: raw velocity per tick.
    - `starts`: ticks that begin a new motion: the filter is empty there.
    - `filter_hz`: cut-off; 0 is the raw difference.
    - `tick_s`: loop period.
    """
    on = filter_hz > 0
    keep = jnp.where(on, jnp.exp(-2 * jnp.pi * jnp.where(on, filter_hz, 1.0) * tick_s), 0.0)
    gain = jnp.broadcast_to(jnp.where(starts, 0.0, keep)[:, None], velocity_mm_s.shape)
    velocity = affine_scan(gain, (1 - keep) * velocity_mm_s)
    return jnp.sqrt(jnp.sum(velocity**2, axis=1) + 1e-12)


class Switching(eqx.Module):
    """Soft level assignment over ticks.

    - `weights`: (K, T) probability of each level; they sum to 1.
    - `up`, `down`: (K - 1, T) flow i -> i + 1 and i + 1 -> i that happens in this tick.
    """

    weights: Float[Array, "K T"]
    up: Float[Array, "J T"]
    down: Float[Array, "J T"]

    @property
    def switches(self) -> Float[Array, ""]:
        """Expected number of level changes."""
        return jnp.sum(self.up) + jnp.sum(self.down)


def soft_switching(
    speed_mm_s: Float[Array, " T"],
    starts: Bool[Array, " T"],
    log_speeds: Float[Array, " J"],
    hysteresis: Float[Array, ""],
    sharpness: Float[Array, ""] | float,
    dwell_ticks: int = 0,
    dwell_rounds: int = 2,
) -> Switching:
    """Runs the soft triggers.

    **Arguments:**

    - `speed_mm_s`: filtered speed.
    - `starts`: ticks that begin a new motion, at level 0.
    - `log_speeds`: ln of the switching speeds in mm/s, increasing; a huge one is never reached.
    - `hysteresis`: eta; up above V (1 + eta), down below V (1 - eta).
    - `sharpness`: the sigmoid's width is eta / sharpness in ln speed. Soft triggers over-count when it is below 5.
    - `dwell_ticks`: least ticks from one switch to the next, of any kind; up to 1: none. Not differentiated.
    - `dwell_rounds`: fixed-point rounds for the dwell.
    """
    log_speed = jnp.log(speed_mm_s)[None, :]
    width = hysteresis / sharpness
    up_rate = jax.nn.sigmoid((log_speed - log_speeds[:, None] - jnp.log1p(hysteresis)) / width)
    down_rate = jax.nn.sigmoid((log_speeds[:, None] + jnp.log1p(-hysteresis) - log_speed) / width)
    # The first tick of a motion has speed 0: level 0.
    up_rate = jnp.where(starts, 0.0, up_rate)

    def run(open_share):
        up_now, down_now = up_rate * open_share, down_rate * open_share
        gain = jnp.where(starts, 0.0, 1 - up_now - down_now)
        above = affine_scan(gain.T, up_now.T).T
        before = jnp.where(starts, 0.0, jnp.concatenate([jnp.zeros_like(above[:, :1]), above[:, :-1]], axis=1))
        return above, (1 - before) * up_now, before * down_now

    open_share = jnp.ones_like(log_speed)
    above, up, down = run(open_share)
    for _ in range(dwell_rounds if dwell_ticks > 1 else 0):
        # Half steps: a switch that is blocked must not unblock the next one at once.
        open_share = 0.5 * (open_share + _open_share(up, down, starts, dwell_ticks - 1))
        above, up, down = run(open_share)
    ones, zeros = jnp.ones_like(above[:1]), jnp.zeros_like(above[:1])
    ladder = jnp.concatenate([ones, above, zeros])
    return Switching(ladder[:-1] - ladder[1:], up, down)


def _open_share(up, down, starts, closed_ticks: int) -> Float[Array, "1 T"]:
    """Share of histories with no switch in the last `closed_ticks` ticks: 1 minus the flow there, at least 0."""
    flow = jnp.sum(up, axis=0) + jnp.sum(down, axis=0)
    keep = jnp.where(starts, 0.0, 1.0)
    total = affine_scan(keep, flow)
    age = affine_scan(keep, jnp.ones_like(flow))  # 1 in a motion's first tick
    delayed = lambda ticks: jnp.concatenate([jnp.zeros(ticks, flow.dtype), total])[: flow.shape[0]]
    before = jnp.where(age > 1, delayed(1), 0.0)
    earlier = jnp.where(age > closed_ticks + 1, delayed(closed_ticks + 1), 0.0)
    return jnp.clip(1 - (before - earlier), 0.0, 1.0)[None, :]
