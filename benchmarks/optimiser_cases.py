"""`make optimiser-cases [BUDGETS=4] [STARTS=4] [SCANS="a.ply b.ply"] [JSON=out.json]`

Our search against scipy's SLSQP on the surrogate alone: the same objective, limits, gradients and level counts. A case
is a scan with a tool, and a budget; what counts is the best over all level counts. SLSQP works at full sharpness, from
so many starts per level count, drawn by another seed than ours: the most promising of eight times as many.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from cyclopts import App
from rich.console import Console
from scipy.optimize import minimize

from hapticlod.motion import MODES
from tuning.cli import run

if TYPE_CHECKING:
    from hapticlod.scan import Scan
    from tuning.search import Limits, Search
    from tuning.space import Space

app = App(name="optimiser-cases", help="Our search against SLSQP with the same gradients, on surrogates.")
DRAWN_PER_START, MOST_STEPS, SEED = 8, 60, 1000
CLOSE = 1.01
MOTION_S, MADE = 8.0, MODES[:3]
DENTITIONS = ((6_000, 1), (20_000, 2), (60_000, 3))
REAL = ("tooth_scan_molaR_10k.ply", "tooth_human_incisor_31k.ply", "dental_ios_upper_100k.ply")
TOOLS = ("tools/ball_1mm.toml", "tools/explorer.toml")


@dataclass(frozen=True)
class Outcome:
    """One case: the least objective within the limits of either, inf where there is none, and seconds of processor."""

    scan: str
    budget_us: float
    ours: float
    slsqp: float
    ours_s: float
    slsqp_s: float

    @property
    def ratio(self) -> float:
        """Ours over SLSQP's best; at most 1 where ours is as good. NaN where neither found anything."""
        if not math.isfinite(self.slsqp):
            return 0.0 if math.isfinite(self.ours) else math.nan
        return self.ours / self.slsqp


def slsqp(search: Search, space: Space, levels: int, limits: Limits, starts: int) -> float:
    """The least objective within the limits that SLSQP ends at, from the best of many points; inf: none."""
    from tuning.search import MARGIN
    from tuning.search import Limits as Held

    rows, bounds = space.order_rows(levels)
    held = Held(MARGIN * limits.budget_us, limits.memory_mb)
    seen: dict[bytes, tuple[float, Any, Any, Any]] = {}

    def slopes(x: np.ndarray) -> tuple[float, Any, Any, Any]:
        key = np.clip(x, 0.0, 1.0).tobytes()
        if key not in seen:
            value = search.look(np.clip(x, 0.0, 1.0), levels, held).objective
            gradient, excess, jacobian = search.slopes(np.clip(x, 0.0, 1.0), levels, limits)
            seen[key] = value, excess, gradient, jacobian
        return seen[key]

    constraints = [
        {"type": "ineq", "fun": lambda x: -slopes(x)[1], "jac": lambda x: -slopes(x)[3]},
        {"type": "ineq", "fun": lambda x: bounds - rows @ x, "jac": lambda x: -rows},
    ]
    points = space.sample(DRAWN_PER_START * starts, levels, SEED + levels)
    best = math.inf
    for start in sorted(points, key=lambda x: search.look(x, levels, limits).promise)[:starts]:
        found = minimize(
            lambda x: slopes(x)[0], start, jac=lambda x: slopes(x)[2], bounds=[(0.0, 1.0)] * space.size,
            constraints=constraints, method="SLSQP", options={"maxiter": MOST_STEPS, "ftol": 1e-7},
        )  # fmt: skip
        if np.isfinite(found.x).all():
            end = search.look(space.ordered(found.x, levels), levels, limits)
            best = min(best, end.objective if end.excess <= 1e-3 else math.inf)
    return best


def compared(
    name: str, search: Search, space: Space, counts: Sequence[int], budgets_us: Sequence[float], memory_mb: float,
    starts: int,
) -> Iterator[Outcome]:  # fmt: skip
    """Cases of one surrogate, from the tightest budget."""
    from tuning.search import Limits

    for budget_us in budgets_us:
        limits = Limits(float(budget_us), memory_mb)
        begun = time.process_time()
        found = search.best_of_each(counts, limits, 0).values()
        between = time.process_time()
        ours = min((each.objective for each in found if each.excess <= 1e-3), default=math.inf)
        theirs = min(slsqp(search, space, k, limits, starts) for k in counts)
        yield Outcome(name, limits.budget_us, ours, theirs, between - begun, time.process_time() - between)


def budgets_of(search: Search, space: Space, memory_mb: float, count: int) -> list[float]:
    """Log-spaced from a little more than the cheapest of many points costs to a little less than the full scan does."""
    from tuning.search import Limits

    free = Limits(1e-3, memory_mb)
    points = [space.ordered(np.full(space.size, place), 1) for place in (0.0, 1.0)]
    points += list(space.sample(DRAWN_PER_START, 1, SEED))
    costs = [search.look(x, 1, free).predicted["loop_cost_p999_us"] for x in points]
    return [float(f"{budget:.4g}") for budget in np.geomspace(1.15 * min(costs), 0.9 * max(costs), count)]


@app.default
def optimiser_cases(
    *, budgets: int = 4, starts: int = 4, scans: str = "", most_levels: int = 4, json: Path | None = None
) -> None:
    """Compare on generated scans and, where data is there, on real ones.

    Parameters
    ----------
    budgets
        Budgets per surrogate.
    starts
        SLSQP's, per level count.
    scans
        Files parted by spaces. Default: three generated dentitions, and three real scans where HAPTICLOD_DATA has them.
    most_levels
        Level counts are 1 to this.
    json
        Also write the cases here.
    """
    from hapticlod.files import write_json
    from hapticlod.motion import synthesise
    from hapticlod.shipped import shipped_config
    from hapticlod.station import load_station
    from hapticlod.tool import load_tool
    from tuning.commands.tune import DEFAULT_STATION
    from tuning.compile_cache import keep_compiled
    from tuning.prepare import prepare
    from tuning.search import Search

    keep_compiled()
    station = load_station(shipped_config(DEFAULT_STATION))
    out, outcomes = Console(highlight=False), []
    for i, scan in enumerate(_scans(scans)):
        tool = load_tool(shipped_config(TOOLS[i % len(TOOLS)]))
        # Short: what is compared is two optimisers on one function. Not shorter: with six ticks above p99.9 it is a
        # function of chance, of many basins, that nobody tunes on.
        motions = [
            synthesise(
                scan, mode, seconds=MOTION_S, loop_hz=station.loop_hz, seed=number, tool=tool,
                stiffness_n_mm=station.stiffness_n_mm, encoder_mm=station.encoder_mm,
            )
            for number, mode in enumerate(MADE)
        ]  # fmt: skip
        ready = prepare(scan, station, tool, motions)
        search = Search(ready.measured, ready.space, station.budget_us)
        counts = [k for k in range(1, most_levels + 1) if ready.space.fits(k)]
        asked = budgets_of(search, ready.space, station.memory_mb, budgets)
        name = f"{scan.name}, {scan.triangles} triangles, {tool.name}"
        for outcome in compared(name, search, ready.space, counts, asked, station.memory_mb, starts):
            outcomes.append(outcome)
            out.print(
                f"{name}, {outcome.budget_us:g} us: ours {outcome.ours:.4g} in {outcome.ours_s:.1f} s, SLSQP "
                f"{outcome.slsqp:.4g} in {outcome.slsqp_s:.1f} s, ratio {outcome.ratio:.4f}",
                soft_wrap=True,
            )
    answered = [outcome for outcome in outcomes if not math.isnan(outcome.ratio)]
    close = sum(outcome.ratio <= CLOSE for outcome in answered)
    better = sum(outcome.ratio < 1 / CLOSE for outcome in answered)
    out.print(f"within 1 % of SLSQP's best, or better: {close} of {len(answered)}; better by more than 1 %: {better}")
    if json is not None:
        write_json(json, {"within_1_percent": close, "cases": [{**asdict(o), "ratio": o.ratio} for o in outcomes]})


def _scans(files: str) -> Iterator[Scan]:
    from hapticlod.dentition import make_dentition
    from hapticlod.scan import load_scan

    if files:
        yield from (load_scan(Path(path), None) for path in files.split())
        return
    for triangles, seed in DENTITIONS:
        yield make_dentition(triangles, seed)
    data = Path(os.environ.get("HAPTICLOD_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    yield from (load_scan(data / "meshes" / name, None) for name in REAL if (data / "meshes" / name).is_file())


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:], app))
