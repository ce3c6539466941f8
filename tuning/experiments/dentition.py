"""Experiment 3 (section 3.3): a lower dentition; V01 = 30 and V12 = 120 mm/s, L = 5 mm (figures 24 to 26)."""

from __future__ import annotations

from pathlib import Path
from typing import cast

from hapticlod.config import LadderLike, load_config
from hapticlod.dentition import make_dentition
from hapticlod.ladder import build_ladder
from hapticlod.motion import synthesise
from hapticlod.motion.strokes import Mode
from hapticlod.replay import replay_levels, runtime_levels
from hapticlod.scan import Scan, load_scan
from hapticlod.shipped import shipped_config
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.baselines import finest_only
from tuning.experiments.ours import OURS
from tuning.experiments.outcome import Outcome, Surface, figure_of, run_both

TRIANGLES = 66224
# The paper's two hands: a fast probe over the teeth and a slow search for caries.
HANDS: dict[str, Mode] = {"fast": "transfer", "slow": "probe"}
_OFFSETS = 4.0  # of the coarsest level: the mapping length of ours


def dentition_experiment(
    station: Station, tool: Tool, seconds: float, scan: Path | None = None, unit: str | None = None, seed: int = 0
) -> Outcome:
    """Level 0 alone, the paper's rule and ours, with a fast and a slow hand.

    Args:
        scan: a file; its levels get the paper's proportions. None: the generated dentition, with the paper's numbers.
    """
    out = Outcome()
    given: Scan = make_dentition(TRIANGLES, seed) if scan is None else load_scan(scan, unit)
    ladder = build_ladder(given, rungs=4, coarsest_ratio=8.0)
    paper = load_config(shipped_config("levels/paper_dentition.toml")).scaled_to(
        cast(LadderLike, ladder), given.triangles
    )
    coarsest = min(ladder.rungs, key=lambda rung: abs(rung.triangles - paper.levels[-1].triangles))
    reach_mm = _OFFSETS * coarsest.rms_mm
    ours = paper.changed(**OURS, l_in_mm=reach_mm, l_out_mm=reach_mm)
    alone = finest_only(ladder, tool)
    origin = given.centre_mm
    finest, three = runtime_levels(alone, ladder), runtime_levels(paper, ladder)
    out.assumed["scan"] = {"name": given.name, "triangles": [level.triangles for level in paper.levels]}
    prefix = "dentition" if scan is None else f"dentition-{given.name}"
    for hand, mode in HANDS.items():
        motion = synthesise(
            given, mode, seconds=seconds, loop_hz=station.loop_hz, seed=seed, tool=tool,
            stiffness_n_mm=station.stiffness_n_mm, max_force_n=station.max_force_n, encoder_mm=station.encoder_mm,
        )  # fmt: skip
        truth = replay_levels(finest, alone, origin, motion, tool, station, 1, cut_short=False)
        for name, config, levels, file in (
            ("level 0 alone", alone, finest, "level0"),
            ("the paper's rule", paper, three, "lod-paper"),
            ("ours", ours, three, "lod-ours"),
        ):
            surface = Surface(levels, origin)
            record, late, row = run_both(f"{name}, {hand}", config, surface, motion, tool, station, truth)
            out.rows.append(row)
            title = f"{given.name}, {name}, {hand} hand, old machine"
            out.figures[f"{prefix}-{file}-{hand}"] = figure_of(title, record, late, motion, station, magnitude=True)
    return out
