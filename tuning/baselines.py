"""What a tuned configuration has to beat: the finest level alone, the coarsest alone, the paper's rule."""

from __future__ import annotations

from hapticlod.config import Level, LodConfig
from hapticlod.ladder import Ladder
from hapticlod.tool import Tool

# The paper's dentition: triangles per level, switching speeds, L (Zhou et al. 2009, section 3.3, table 4).
PAPER_TRIANGLES = (66224, 26556, 14830)
PAPER_SPEEDS_MM_S = (30.0, 120.0)
PAPER_L_MM = 5.0
CELL_EDGES = 4.0


def one_level(ladder: Ladder, tool: Tool, triangles: int, name: str) -> LodConfig:
    """The configuration that stays on one level, with the whole tool."""
    rung = ladder.at(triangles)
    level = Level(triangles=rung.triangles, cell_mm=CELL_EDGES * rung.mean_edge_mm, balls=tool.balls)
    return LodConfig(name=name, levels=(level,))


def finest_only(ladder: Ladder, tool: Tool) -> LodConfig:
    """The scan itself."""
    return one_level(ladder, tool, ladder.scan.triangles, "finest only")


def coarsest_only(ladder: Ladder, tool: Tool) -> LodConfig:
    """The last rung."""
    return one_level(ladder, tool, ladder.rungs[-1].triangles, "coarsest only")


def papers_rule(ladder: Ladder, tool: Tool) -> LodConfig:
    """The paper's dentition in its proportions on this scan: its speeds, its L, its mapping, no filter."""
    made: list[Level] = []
    speeds: list[float] = []
    for i, count in enumerate(PAPER_TRIANGLES):
        rung = ladder.at(max(round(ladder.scan.triangles * count / PAPER_TRIANGLES[0]), 1))
        level = Level(triangles=rung.triangles, cell_mm=CELL_EDGES * rung.mean_edge_mm, balls=tool.balls)
        if made and level.triangles >= made[-1].triangles:
            continue
        if made:
            speeds.append(PAPER_SPEEDS_MM_S[i - 1])
        made.append(level)
    return LodConfig(
        name="the paper's", levels=tuple(made), speeds_mm_s=tuple(speeds), mapping="paper", l_out_mm=PAPER_L_MM
    )


def baselines(ladder: Ladder, tool: Tool) -> tuple[LodConfig, ...]:
    """All three, in the order of the table."""
    return finest_only(ladder, tool), coarsest_only(ladder, tool), papers_rule(ladder, tool)
