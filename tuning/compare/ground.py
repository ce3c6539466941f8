"""What cells share: a scan with its ladder, hand motions on it, and the records that feel is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from hapticlod.config import LodConfig
from hapticlod.errors import InputError
from hapticlod.ladder import Ladder, build_ladder
from hapticlod.motion import Motion, lay_on_scan, load_motion
from hapticlod.replay import Record, replay_levels, runtime_levels
from hapticlod.scan import Scan, load_scan
from hapticlod.station import Station
from hapticlod.tool import Tool
from tuning import kept
from tuning.baselines import finest_only
from tuning.compare.cell import Cell, MotionSet, ScanFile
from tuning.make_hands import Hand, make_hands
from tuning.recordings import lies_on

_SEED = 700  # strokes of the tuner have other seeds: it must not have seen these


@dataclass(frozen=True)
class Ground:
    """A ladder and the motions on its scan, for one tool and station."""

    ladder: Ladder
    motions: tuple[Motion, ...]
    tool: Tool
    station: Station

    def records(self, config: LodConfig, repeats: int) -> list[Record]:
        """One record per motion, ticks solved to the end: the same whatever the budget."""
        levels = runtime_levels(config, self.ladder)
        origin = self.ladder.scan.centre_mm
        return [
            replay_levels(levels, config, origin, motion, self.tool, self.station, repeats, cut_short=False)
            for motion in self.motions
        ]


# A worker goes through the cells of a ground one after the other: the last ground is all it needs.
_last: dict[tuple[str, ...], Ground] = {}
_last_reference: dict[tuple[str, ...], list[Record]] = {}


def ground_of(cell: Cell) -> Ground:
    """Made once, kept until a cell of another ground comes. Raises InputError where scan or motion cannot be used."""
    if cell.ground not in _last:
        _last.clear()
        ladder = ladder_of(cell.scan)
        motions = tuple(_motions(cell.motion, ladder.scan, cell.tool, cell.station))
        _last[cell.ground] = Ground(ladder, motions, cell.tool, cell.station)
    return _last[cell.ground]


def reference_of(cell: Cell) -> list[Record]:
    """The finest level's records, one per motion."""
    if cell.ground not in _last_reference:
        _last_reference.clear()
        ground = ground_of(cell)
        _last_reference[cell.ground] = ground.records(finest_only(ground.ladder, cell.tool), 1)
    return _last_reference[cell.ground]


@lru_cache(maxsize=1)
def scan_of(file: ScanFile) -> Scan:
    """The cleaned scan."""
    return load_scan(file.path, file.unit)


@lru_cache(maxsize=1)
def ladder_of(file: ScanFile) -> Ladder:
    """The scan's ladder: the one that tuning keeps between runs, made where it is not kept yet."""
    scan = scan_of(file)
    key = kept.key_of("ladder", scan.digest, kept.code_digest())
    ladder = kept.load("ladders", key)
    if ladder is None:
        ladder = build_ladder(scan)
        kept.store("ladders", key, ladder)
    return ladder


def _motions(asked: MotionSet, scan: Scan, tool: Tool, station: Station) -> Sequence[Motion]:
    if asked.path is None:
        hands = [Hand(mode, asked.seconds, 1000 * asked.seed + _SEED + i) for i, mode in enumerate(asked.modes)]
        return make_hands(scan, station, tool, hands, 1)
    press = {
        "tool": tool, "stiffness_n_mm": station.stiffness_n_mm, "max_force_n": station.max_force_n,
        "encoder_mm": station.encoder_mm,
    }  # fmt: skip
    recorded = load_motion(asked.path, station.loop_hz)
    placed = [m if lies_on(m, scan, tool) else lay_on_scan(m, scan, **press) for m in recorded]
    if not placed:
        raise InputError(str(asked.path), "holds no motion", "give a recording")
    return placed
