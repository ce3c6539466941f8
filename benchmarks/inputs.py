"""What benchmarks are given on the command line, loaded: station, tool, recorded motions."""

from pathlib import Path

from hapticlod.motion import Motion, load_motion
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import Tool, load_tool
from tuning.commands.tune import DEFAULT_STATION, DEFAULT_TOOL


def load_inputs(
    station: Path | None, tool: Path | None, motions: str, budget_us: float | None = None
) -> tuple[Station, Tool, list[Motion] | None]:
    """Station (with another budget, if one is given), tool, and the motions of files parted by spaces; None: none."""
    target = load_station(station or shipped_config(DEFAULT_STATION))
    if budget_us is not None:
        target = target.adjusted(budget_us=budget_us)
    held = load_tool(tool or shipped_config(DEFAULT_TOOL))
    return (
        target,
        held,
        [motion for path in motions.split() for motion in load_motion(Path(path), target.loop_hz)] or None,
    )
