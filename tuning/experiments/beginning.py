"""On how much slower a machine than the assumed one jumps on a plane begin (the paper's figures 12 and 16).

The assumed factor rests on one sentence of the paper (jumps above 80 mm/s on 80 000 triangles) and is fixed by when
ticks are late, not by when the force jumps. Here it is raised until the force does: ticks are cut short where a
deployed runtime ends them, the tool stays behind the hand, and the plane resists the slide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hapticlod.config import LodConfig, load_config
from hapticlod.motion import Motion
from hapticlod.replay import replay_levels
from hapticlod.shipped import shipped_config
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.experiments.meshes import PLANE_TRIANGLES, mesh_level, plane
from tuning.experiments.old_machine import run_late
from tuning.experiments.outcome import SETTLED_S, Outcome, Surface, figure_of, run_both
from tuning.experiments.slides import slide_on_plane

STEP, MOST = 0.1, 10.0  # factors on the assumed slowdown: from 1 in steps to at most
DRAGGED_N = 0.1  # along a plane the right force is 0: this much is a jump


@dataclass(frozen=True)
class Slide:
    """One mesh at one speed, in the paper's word for it."""

    triangles: int
    word: str
    mean_mm_s: float


def draw_beginning(out: Outcome, unstable: Slide, stable: Slide, station: Station, tool: Tool, seconds: float) -> None:
    """Adds rows of both slides on the first machine on which the one jumps, and its figure; nothing if none does.

    Args:
        station: the assumed machine; slower ones are multiples of its slowdown.
    """
    config, surface = _plane(unstable.triangles)
    motion = slide_on_plane(unstable.mean_mm_s, seconds, station.loop_hz)
    slower = next((f for f in _factors() if dragged(config, surface, motion, _slower(station, f), tool)), None)
    if slower is None:
        return
    machine = _slower(station, slower)
    for slide in (unstable, stable):
        config, surface = _plane(slide.triangles)
        motion = slide_on_plane(slide.mean_mm_s, seconds, station.loop_hz)
        truth = replay_levels(
            list(surface.levels), config, surface.origin_mm, motion, tool, station, 1, cut_short=False
        )  # fmt: skip
        name = f"{slide.triangles} triangles, {slide.word}, cut short, {slower:g} times slower"
        record, late, row = run_both(name, config, surface, motion, tool, machine, truth, cut_short=True)
        out.rows.append({**row, "slower": slower})
        if slide is unstable:
            title = (
                f"Plane, {slide.triangles} triangles, {slide.word} ({slide.mean_mm_s:g} mm/s mean), old machine "
                f"{slower:g} times slower, ticks cut short"
            )
            out.figures[f"plane-{slide.triangles}-{slide.word}-slower"] = figure_of(
                title, record, late, motion, machine
            )


def dragged(config: LodConfig, surface: Surface, motion: Motion, station: Station, tool: Tool) -> bool:
    """Whether the plane resists a slide over it, which a plane without friction does not."""
    late = run_late(list(surface.levels), config, surface.origin_mm, motion, tool, station, cut_short=True)
    along = late.felt_n[motion.time_s > SETTLED_S, :2]
    return bool(np.linalg.norm(along, axis=1).max() > DRAGGED_N)


def _factors() -> Iterator[float]:
    return (round(1.0 + STEP * n, 6) for n in range(1 + round((MOST - 1.0) / STEP)))


def _slower(station: Station, factor: float) -> Station:
    reason = f"{station.slowdown_reason}; {factor:g} times that"
    return station.adjusted(slowdown=factor * station.slowdown, slowdown_reason=reason)


def _plane(triangles: int) -> tuple[LodConfig, Surface]:
    paper = load_config(shipped_config("levels/paper_plane.toml"))
    level = paper.levels[PLANE_TRIANGLES.index(triangles)]
    scan = plane(triangles)
    return LodConfig(levels=(level,)), Surface([mesh_level(scan, scan.centre_mm, level.cell_mm)], scan.centre_mm)
