"""`hapticlod calibrate`: what a tick costs on this machine, as a station file that any machine can tune for."""

from datetime import date
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from hapticlod.shipped import shipped_config
from tuning.commands.outputs import check_writable
from tuning.commands.tune import DEFAULT_STATION
from tuning.progress import StageProgress

_TOOLS = ("tools/point.toml", "tools/ball_1mm.toml", "tools/ball_3mm.toml", "tools/burr_flame.toml")
_HELD_OUT = "tools/explorer.toml"


def calibrate_command(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    station: Path | None = None,
    seed: int = 0,
) -> None:
    """Time a fixed course of replays on this machine, and write a station file with its cost coefficients.

    Run it on the machine that will render, while it does nothing else; then tune for that machine anywhere with
    `hapticlod tune --station FILE`.

    Parameters
    ----------
    output
        The station file to write (.toml).
    station
        Station file whose rate, budget, device and limits are taken over. Default: a desktop at 1 kHz.
    seed
        Of the motions.
    """
    from hapticlod.station import load_station
    from hapticlod.toml import save_toml
    from hapticlod.tool import load_tool

    base = load_station(station or shipped_config(DEFAULT_STATION))
    # A station file may be calibrated in place: it is read before and replaced as a whole.
    check_writable(output)
    notes = Console(stderr=True, highlight=False)
    with StageProgress(notes) as progress:
        from tuning.course import run_course

        tools = [load_tool(shipped_config(name)) for name in _TOOLS]
        found = run_course(base, tools, load_tool(shipped_config(_HELD_OUT)), seed, progress)
    cost = found.cost.model_copy(update={"measured_on": f"{found.cost.measured_on}, {date.today().isoformat()}"})
    calibrated = base.adjusted(cost=cost.model_dump(), slowdown=1.0, slowdown_reason="")
    save_toml(output, calibrated, "Cost coefficients measured by `hapticlod calibrate`: ns per count.")
    out = Console(highlight=False)
    for name, value in cost.model_dump().items():
        text = value if isinstance(value, str) else f"{value:.4g}"
        out.print(f"{name:<18}{text}", markup=False, soft_wrap=True)
    out.print(
        f"on a tool and surface left out of the fit: predicted over measured mean "
        f"{found.mean_ratio:.2f}, p99.9 {found.p999_ratio:.2f}, median error of a tick {100 * found.error_p50:.0f} %",
        markup=False, soft_wrap=True,
    )  # fmt: skip
    out.print(f"{output}: use it with `hapticlod tune --station {output}`", markup=False, soft_wrap=True)
