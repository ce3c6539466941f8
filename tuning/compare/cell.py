"""A cell of a comparison: one configuration on one scan with one tool, station and motion; and the key it has."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from hapticlod import _runtime
from tuning.kept import code_digest, key_of

if TYPE_CHECKING:
    from hapticlod.config import LodConfig
    from hapticlod.motion.strokes import Mode
    from hapticlod.scheme import Scheme
    from hapticlod.station import Station
    from hapticlod.tool import Tool

TUNED = "tuned"


@dataclass(frozen=True)
class ScanFile:
    """A scan by its file: name in tables, path, unit of its numbers (None: to be found), digest of its bytes."""

    name: str
    path: Path
    unit: str | None
    digest: str


@dataclass(frozen=True)
class MotionSet:
    """Hand motions that are measured together: strokes made on the scan, or a recording.

    Attributes:
        name: in tables.
        modes: of strokes, `seconds` each from `seed`; empty for a recording.
        path, digest: of the recording; None and "" for strokes.
    """

    name: str
    modes: tuple[Mode, ...] = ()
    seconds: float = 0.0
    seed: int = 0
    path: Path | None = None
    digest: str = ""


@dataclass(frozen=True)
class Cell:
    """What is measured once. `config` is None where it is to be tuned first, from `tuning_seed`."""

    scan: ScanFile
    config_name: str
    config: Scheme | LodConfig | None
    tool: Tool
    station: Station
    motion: MotionSet
    tuning_seed: int = 0

    @property
    def names(self) -> tuple[str, str, str, str, str]:
        """Scan, configuration, tool, station, motion."""
        return self.scan.name, self.config_name, self.tool.name, self.station.name, self.motion.name

    @property
    def ground(self) -> tuple[str, str, str, str]:
        """Cells of one ground share scan, motions and reference: a worker keeps these while it stays on one."""
        return f"{self.scan.digest} {self.scan.unit}", self.tool.digest, _text(self.station), repr(self.motion)

    @cached_property
    def key(self) -> str:
        """Under which the ledger keeps the cell: changes with every input and with the code that measures."""
        config = self.tuning_key if self.config is None else _text(self.config)
        motion = (self.motion.modes, self.motion.seconds, self.motion.seed, self.motion.digest)
        names = self.names  # tables name cells: the same file under another name is another row
        inputs = self.scan.digest, self.scan.unit, self.tool.digest, _text(self.station)
        return key_of("cell", names, inputs, config, motion, measuring_digest())

    @property
    def tuning_key(self) -> str:
        """Under which the tuned configuration of a scan, tool and station is kept: it does not hang on the motion."""
        inputs = self.scan.digest, self.scan.unit, self.tool.digest, _text(self.station)
        return key_of("tuning", inputs, self.tuning_seed, code_digest())


def _text(model: Station | Scheme | LodConfig) -> str:
    return model.model_dump_json()


@lru_cache(maxsize=1)
def measuring_digest() -> str:
    """Hex digest of the native module and of the Python code that measures a cell: the ledger's "code version"."""
    hasher = hashlib.blake2b(digest_size=16)
    native = Path(str(_runtime.__file__))
    here = Path(__file__).parent
    model = sorted((native.parent).rglob("*.py"))
    for path in [native, *model, here / "measuring.py", here / "ground.py"]:
        hasher.update(path.name.encode())
        hasher.update(path.read_bytes())
    return hasher.hexdigest()
