"""Experiment 2 (section 3.2): a sphere of 100 mm diameter; V01 = 20 and V12 = 150 mm/s (figures 20 to 22)."""

from __future__ import annotations

from hapticlod.config import LodConfig, load_config
from hapticlod.replay import replay_levels
from hapticlod.shipped import shipped_config
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.experiments.meshes import SPHERE_VERTICES, mesh_level, sphere
from tuning.experiments.ours import OURS
from tuning.experiments.outcome import Outcome, Surface, figure_of, run_both
from tuning.experiments.slides import slide_on_sphere

MEAN_MM_S = 110.0  # strokes from rest to 206 mm/s: all three levels in each


def sphere_experiment(station: Station, tool: Tool, seconds: float) -> Outcome:
    """Level 0 alone, level 2 alone, the paper's rule, ours."""
    out = Outcome()
    paper = load_config(shipped_config("levels/paper_sphere.toml"))
    scans = [sphere(count) for count in SPHERE_VERTICES]
    origin = scans[0].centre_mm
    levels = [mesh_level(scan, origin, level.cell_mm) for scan, level in zip(scans, paper.levels, strict=True)]
    motion = slide_on_sphere(MEAN_MM_S, seconds, station.loop_hz)
    runs = {
        "level 0 alone": (LodConfig(levels=paper.levels[:1]), Surface(levels[:1], origin), "sphere-level0"),
        "level 2 alone": (LodConfig(levels=paper.levels[2:]), Surface(levels[2:], origin), "sphere-level2"),
        "the paper's rule": (paper, Surface(levels, origin), "sphere-lod-paper"),
        # The coarsest sphere lies up to 0.3 mm below the finest.
        "ours": (paper.changed(**OURS, l_in_mm=1.0, l_out_mm=1.0), Surface(levels, origin), "sphere-lod-ours"),
    }
    config, surface, _ = runs["level 0 alone"]
    truth = replay_levels(list(surface.levels), config, origin, motion, tool, station, 1, cut_short=False)
    for name, (config, surface, file) in runs.items():
        record, late, row = run_both(name, config, surface, motion, tool, station, truth)
        out.rows.append(row)
        for machine, loop in (("old machine", late), ("on time", None)):
            ending = "" if loop is not None else "-on-time"
            title = f"Sphere, {name}, {machine}"
            out.figures[file + ending] = figure_of(title, record, loop, motion, station, magnitude=True)
    return out
