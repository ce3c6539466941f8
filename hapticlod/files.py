"""Files are never half-written: write beside, fsync, rename."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from hapticlod.errors import InputError


def write_atomic(path: str | os.PathLike[str], data: bytes | bytearray | memoryview | str) -> None:
    """Write a file so that at every moment it is either the old one or the whole new one.

    Args:
        path: where the file goes; a symbolic link is followed, so that the link itself survives.
        data: its content; text is encoded as UTF-8.

    Raises:
        InputError: the place cannot be written. Nothing is left behind.
    """
    with atomic_stream(path) as stream:
        stream.write(data.encode("utf-8") if isinstance(data, str) else data)


@contextmanager
def atomic_stream(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """`write_atomic` for what is written piece by piece: the new file is there when the block ends, whole.

    Raises:
        InputError: the place cannot be written. Nothing is left behind, as after any other error in the block.
    """
    target = Path(os.path.realpath(path))
    try:
        descriptor, beside = tempfile.mkstemp(prefix=f".{target.name[:100]}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        with os.fdopen(descriptor, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(beside, _mode_for(target))
        os.replace(beside, target)
    except BaseException as error:  # also on Ctrl-C: leave no part file
        os.unlink(beside)
        if isinstance(error, OSError):
            raise _cannot_write(path, error) from error
        raise
    _sync_folder(target.parent)


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` as indented JSON, atomically. NaN and infinity are refused: JSON has no words for them.

    Raises:
        InputError: the place cannot be written.
        ValueError: `value` holds a number that is not finite.
    """
    write_atomic(path, json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def _mode_for(target: Path) -> int:
    """Mode of the file that is replaced, else what the umask would have given."""
    try:
        return target.stat().st_mode & 0o7777
    except OSError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask


def _sync_folder(folder: Path) -> None:
    # The rename itself must survive a power cut; some file systems cannot sync a folder, which is no fault of the user.
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        pass
    finally:
        os.close(descriptor)


def _cannot_write(path: str | os.PathLike[str], error: OSError) -> InputError:
    return InputError(
        os.fspath(path), f"cannot be written ({error.strerror})", "choose a folder that exists and is writable"
    )
