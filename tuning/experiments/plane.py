"""Experiment 1 (section 3.1): a plane of 100 x 100 mm, slid over at several speeds (figures 10 to 19)."""

from __future__ import annotations

from hapticlod.config import LodConfig, load_config
from hapticlod.replay import replay_levels
from hapticlod.shipped import shipped_config
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.experiments.beginning import Slide, draw_beginning
from tuning.experiments.meshes import PLANE_TRIANGLES, mesh_level, plane
from tuning.experiments.ours import OURS
from tuning.experiments.outcome import Outcome, Surface, figure_of, run_both
from tuning.experiments.slides import slide_on_plane

# Mean speeds within the paper's words slow (< 30 mm/s), medium (30-80) and fast (> 80; > 120 for the coarser planes).
SPEEDS_MM_S = {"slow": 20.0, "medium": 55.0, "fast": 130.0}
# The paper's pairs of figures: force and speed of one mesh at one speed.
FIGURES = {(800, "fast"): "10, 11", (5000, "fast"): "12, 13", (80000, "slow"): "14, 15", (80000, "medium"): "16, 17",
           (80000, "fast"): "18, 19"}  # fmt: skip
# "Hard to get above 200 mm/s": the paper on its figures 18 and 19.
UNREACHED_MM_S = 200.0
# Figures 12 and 16 have jumps that the machine as assumed has not: drawn on a slower one, beside what the paper saw
# stable there: a coarser mesh (figure 10), a slower hand (14).
BEGINNINGS = (
    (Slide(5000, "fast", SPEEDS_MM_S["fast"]), Slide(800, "fast", SPEEDS_MM_S["fast"])),
    (Slide(80000, "medium", SPEEDS_MM_S["medium"]), Slide(80000, "slow", SPEEDS_MM_S["slow"])),
)


def plane_experiment(station: Station, tool: Tool, seconds: float) -> Outcome:
    """Each mesh alone at each speed, then the paper's rule and ours over all three."""
    out = Outcome()
    paper = load_config(shipped_config("levels/paper_plane.toml"))
    scans = [plane(count) for count in PLANE_TRIANGLES]
    levels = [mesh_level(scan, scan.centre_mm, level.cell_mm) for scan, level in zip(scans, paper.levels, strict=True)]
    origin = scans[0].centre_mm
    for speed, mean_mm_s in SPEEDS_MM_S.items():
        motion = slide_on_plane(mean_mm_s, seconds, station.loop_hz)
        alone = [LodConfig(levels=(level,)) for level in paper.levels]
        truth = replay_levels(levels[:1], alone[0], origin, motion, tool, station, 1, cut_short=False)
        for mesh, (count, config) in enumerate(zip(PLANE_TRIANGLES, alone, strict=True)):
            surface = Surface([levels[mesh]], origin)
            name = f"{count} triangles, {speed}"
            record, late, row = run_both(name, config, surface, motion, tool, station, truth)
            out.rows.append(row)
            if (count, speed) in FIGURES:
                title = f"Plane, {count} triangles, {speed} ({mean_mm_s:g} mm/s mean), old machine"
                out.figures[f"plane-{count}-{speed}"] = figure_of(title, record, late, motion, station)
        for name, config in (("the paper's rule", paper), ("ours", paper.changed(**OURS, l_in_mm=1.0, l_out_mm=1.0))):
            record, late, row = run_both(
                f"{name}, {speed}", config, Surface(levels, origin), motion, tool, station, truth
            )
            out.rows.append(row)
            if speed == "fast":
                short = "paper" if config is paper else "ours"
                title = f"Plane, three levels, {name}, {speed}, old machine"
                out.figures[f"plane-lod-{short}"] = figure_of(title, record, late, motion, station)
    motion = slide_on_plane(UNREACHED_MM_S, seconds, station.loop_hz)
    config, surface = LodConfig(levels=paper.levels[:1]), Surface(levels[:1], origin)
    truth = replay_levels(levels[:1], config, origin, motion, tool, station, 1, cut_short=False)
    for ending, cut_short in (("", False), (", cut short", True)):
        name = f"{PLANE_TRIANGLES[0]} triangles, {UNREACHED_MM_S:g} mm/s{ending}"
        record, late, row = run_both(name, config, surface, motion, tool, station, truth, cut_short=cut_short)
        out.rows.append(row)
        if cut_short:
            file = f"plane-{PLANE_TRIANGLES[0]}-{UNREACHED_MM_S:g}-mm-s"
            out.figures[file] = figure_of(f"Plane, {name}, old machine", record, late, motion, station)
    for unstable, stable in BEGINNINGS:
        draw_beginning(out, unstable, stable, station, tool, seconds)
    return out
