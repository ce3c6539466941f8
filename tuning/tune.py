"""The tuning loop: ladder, replay, surrogate, optimise, verify in the runtime, correct, choose on measured numbers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder, build_ladder
from hapticlod.motion import Motion, lay_on_scan, near_share, synthesise
from hapticlod.perception import load_perception
from hapticlod.scan import Scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning.assemble import assemble
from tuning.compile_cache import keep_compiled
from tuning.explain import explain
from tuning.grid import Grid, make_clock, make_grid
from tuning.replays import Bench
from tuning.sample import Costing, sample_ladder
from tuning.search import Limits, Search, objective
from tuning.space import Space
from tuning.verify import Verifier

Progress = Callable[[str, float], None]
MODES = ("probe", "trace", "scan", "transfer")
MOTION_S = 4.0
ROUNDS = 3
LEADERS = 2  # level counts that are tried again after a correction
AGREE = 0.05  # predicted and measured p99.9 may differ by this before the surrogate's budget is corrected
NEAR_MM = 2.0


@dataclass(frozen=True)
class Candidate:
    """A configuration with what was predicted of it and what was measured."""

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    objective: float
    feasible: bool


@dataclass(frozen=True)
class TuneResult:
    """What tuning gave.

    Attributes:
        config: the chosen configuration.
        predicted, measured: its metrics by the surrogate, and in the runtime on motions kept apart.
        baselines: by name, measured alike: "finest only", "coarsest only", "the paper's".
        feasible: by name ("tuned" and the baselines), whether budget and memory hold.
        candidates: everything that was measured, best first.
        stages_s: seconds per stage.
        explanation: one paragraph.
        ladder, motions: what the bundle is made of; `motions` are those kept apart.
    """

    config: LodConfig
    predicted: dict[str, float]
    measured: dict[str, float]
    baselines: dict[str, dict[str, float]]
    feasible: dict[str, bool]
    candidates: tuple[Candidate, ...]
    stages_s: dict[str, float]
    explanation: str
    ladder: Ladder
    motions: tuple[Motion, ...]
    costing: Costing


@dataclass
class _Stages:
    """Times stages while it passes their progress on."""

    told: Progress
    seconds: dict[str, float] = field(default_factory=dict)
    _name: str = ""
    _since: float = 0.0

    def __call__(self, name: str, part: float) -> None:
        now = time.monotonic()
        if name != self._name:
            self.close()
            self._name, self._since = name, now
        self.told(name, part)

    def close(self) -> None:
        if self._name:
            spent = time.monotonic() - self._since
            self.seconds[self._name] = self.seconds.get(self._name, 0.0) + spent
        self._name = ""


def tune(
    scan: Scan,
    station: Station,
    tool: Tool,
    motions: Sequence[Motion] | None = None,
    *,
    levels: tuple[int, int] = (1, 5),
    seed: int = 0,
    progress: Progress | None = None,
) -> TuneResult:
    """Tunes the levels of detail of a scan for a station and a tool.

    Args:
        scan: cleaned. station: rate, budget, limits; cost coefficients of its own where it is another machine.
        tool: 1 to 4096 balls.
        motions: recorded at the station's rate: the first halves make the surrogate, the second halves verify.
            None: strokes of all four modes, made on the scan.
        levels: fewest and most levels to consider.
        seed: of motions and starts.
        progress: told every stage's name and the part done.

    Raises:
        InputError: no configuration holds the budget (it says which budget would), or the motions never touch.
    """
    keep_compiled()
    stages = _Stages(progress or (lambda name, part: None))
    ladder = build_ladder(scan, progress=stages)
    stages("prepare the motions", 0.0)
    seen, apart = _motions(scan, station, tool, motions, seed)
    rungs: list[Any] = list(ladder.rungs)
    grid, clock = make_grid(rungs, tool), make_clock(seen)
    bench = Bench(ladder.rungs, scan.centre_mm, tool, station, grid)
    offset_mm = _offset_mm(ladder)
    data, costing = sample_ladder(bench, seen, clock, load_perception(), 4.0 * offset_mm, 2, stages)
    if not data.reference.contact.any():
        raise InputError("motions", "never touch the scan", "give motions that do, or none to have some made")
    stages("build the surrogate", 0.0)
    space = _space(grid, data.reference.velocity_mm_s, offset_mm)
    with jax.enable_x64(True):
        measured = assemble(data, station.stiffness_n_mm, space.dwell_ms * 1e-3)
    search = Search(measured, space, station.budget_us)
    verifier = Verifier(ladder, tool, station, apart, costing)

    counts = [k for k in range(levels[0], levels[1] + 1) if space.fits(k)] or [1]
    candidates = _explore(search, verifier, space, station, counts, seed, stages)
    stages("measure the baselines", 0.0)
    baselines, feasible = {}, {}
    for i, config in enumerate((verifier.finest(), verifier.coarsest(), verifier.paper())):
        baselines[config.name] = verifier.measured(config)
        feasible[config.name] = _holds(baselines[config.name], station)
        stages("measure the baselines", (i + 1) / 3)
    stages.close()
    # The finest level alone is a candidate like any other.
    alone = verifier.finest()
    candidates.append(
        Candidate(
            alone,
            {},
            baselines[alone.name],
            float(objective(baselines[alone.name], station.budget_us)),
            feasible[alone.name],
        )
    )
    ranked = sorted(candidates, key=lambda c: (not c.feasible, c.objective))
    chosen = ranked[0]
    if not chosen.feasible:
        raise _nothing_fits(candidates, station)
    predicted = chosen.predicted or search.look(space.point(chosen.config), 1, _limits(station, 1.0)).predicted
    feasible["tuned"] = True
    return TuneResult(
        config=chosen.config.changed(name="tuned"),
        predicted=predicted,
        measured=chosen.measured,
        baselines=baselines,
        feasible=feasible,
        candidates=tuple(ranked),
        stages_s=stages.seconds,
        explanation=explain(ranked, baselines, station, scan.triangles, tool),
        ladder=ladder,
        motions=tuple(apart),
        costing=costing,
    )


def _explore(
    search: Search, verifier: Verifier, space: Space, station: Station, counts: Sequence[int], seed: int,
    stages: _Stages,
) -> list[Candidate]:  # fmt: skip
    """The best of every level count, measured; then the leaders again, with the surrogate's budget corrected."""
    made: list[Candidate] = []
    warm: dict[int, np.ndarray] = {}

    def attempt(count: int, correction: float, turn: int) -> Candidate:
        stages("optimise", len(made) / (len(counts) + LEADERS))
        extra = [warm[count]] if count in warm else []
        found = search.best(count, _limits(station, correction), seed + turn, extra)
        warm[count] = found.x
        config = space.config(found.x, count, f"{count} levels")
        stages("verify in the runtime", len(made) / (len(counts) + LEADERS))
        metrics = verifier.measured(config)
        value = float(objective(metrics, station.budget_us))
        made.append(Candidate(config, found.predicted, metrics, value, _holds(metrics, station)))
        return made[-1]

    latest = {count: attempt(count, 1.0, 0) for count in counts}
    for turn in range(1, ROUNDS):
        corrections = {count: _correction(latest[count], station) for count in counts}
        wrong = [count for count in counts if corrections[count] is not None]
        # Those that could still win: the best by what was measured, whether or not they held the budget.
        for count in sorted(wrong, key=lambda k: latest[k].objective)[:LEADERS]:
            latest[count] = attempt(count, float(corrections[count] or 1.0), turn)
    return made


def _correction(candidate: Candidate, station: Station) -> float | None:
    """What the surrogate's budget must be multiplied by so that the measured cost meets it; None: they agree."""
    predicted, measured = candidate.predicted["loop_cost_p999_us"], candidate.measured["loop_cost_p999_us"]
    apart = measured / station.budget_us
    if candidate.feasible and apart > 1.0 - 2 * AGREE:
        return None  # as near to the budget as makes sense
    if candidate.feasible and predicted < (1.0 - 2 * AGREE) * station.budget_us:
        return None  # the budget does not bind
    return float(np.clip(predicted / measured, 0.1, 2.0))


def _limits(station: Station, correction: float) -> Limits:
    return Limits(station.budget_us * correction, station.memory_mb)


def _holds(metrics: dict[str, float], station: Station) -> bool:
    return metrics["loop_cost_p999_us"] <= station.budget_us and metrics["memory_mb"] <= station.memory_mb


def _nothing_fits(candidates: list[Candidate], station: Station) -> InputError:
    small = [c for c in candidates if c.measured["memory_mb"] <= station.memory_mb] or candidates
    nearest = min(small, key=lambda c: c.measured["loop_cost_p999_us"])
    needed = nearest.measured["loop_cost_p999_us"]
    return InputError(
        f"station {station.name}",
        f"no configuration holds a budget of {station.budget_us:g} us within {station.memory_mb:g} MB",
        f"the cheapest measured needs {needed:.3g} us and {nearest.measured['memory_mb']:.3g} MB: allow that much, "
        "lower the loop rate, or take a tool with fewer balls",
    )


def _motions(
    scan: Scan, station: Station, tool: Tool, given: Sequence[Motion] | None, seed: int
) -> tuple[list[Motion], list[Motion]]:
    """Motions for the surrogate, and motions kept apart."""
    if given:
        placed = [m if near_share(m, scan, NEAR_MM) > 0.2 else lay_on_scan(m, scan, tool=tool) for m in given]
        halves = [(m.part(0.0, m.seconds / 2), m.part(m.seconds / 2, m.seconds)) for m in placed]
        return [first for first, _ in halves], [second for _, second in halves]

    def made(first_seed: int) -> list[Motion]:
        return [
            synthesise(
                scan, mode, seconds=MOTION_S, loop_hz=station.loop_hz, seed=first_seed + i, tool=tool,
                stiffness_n_mm=station.stiffness_n_mm, max_force_n=station.max_force_n, encoder_mm=station.encoder_mm,
            )
            for i, mode in enumerate(MODES)
        ]  # fmt: skip

    return made(1000 * seed), made(1000 * seed + 500)


def _offset_mm(ladder: Ladder) -> float:
    """How far rungs lie apart where tools touch: the coarsest rung's rms distance."""
    return max(ladder.rungs[-1].rms_mm, 1e-3 * ladder.rungs[0].mean_edge_mm)


def _space(grid: Grid, velocity_mm_s: np.ndarray, offset_mm: float) -> Space:
    order = np.argsort(grid.triangles)
    speed = np.linalg.norm(velocity_mm_s, axis=1)
    slow, fast = np.quantile(speed, [0.1, 0.999])
    return Space(
        triangles=(float(grid.triangles[-1]), float(grid.triangles[0])),
        balls=(float(grid.balls[-1]), float(grid.balls[0])),
        edge_log_triangles=np.log(np.array(grid.triangles, dtype=np.float64))[order],
        edge_log_mm=np.log(np.array(grid.edge_mm))[order],
        speeds_mm_s=(float(max(slow, 1.0)), float(max(fast, 4.0 * max(slow, 1.0)))),
        l_mm=(0.1 * offset_mm, 20.0 * offset_mm),
    )
