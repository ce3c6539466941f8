"""Files that a command will write: refused before the work, not after it."""

from collections.abc import Sequence
from pathlib import Path

from hapticlod.errors import InputError


def check_writable(path: Path, taken: Sequence[Path] = ()) -> None:
    """Raises InputError where `path` cannot be written, or is one of `taken`, which must stay."""
    if path.resolve() in [other.resolve() for other in taken]:
        raise InputError(str(path), "is also an input or the other output", "give another name")
    if path.is_dir():
        raise InputError(str(path), "is a folder", "give the name of a file")
    if not path.resolve().parent.is_dir():
        raise InputError(str(path), f"the folder {path.resolve().parent} does not exist", "create it first")
