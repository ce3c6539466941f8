"""What was expensive to find out, kept between runs under the hash of everything it depends on.

A key covers inputs (by content), settings, the runtime's machine code and the code that measures: whatever changes,
the old entry is simply never asked for again. A damaged or foreign entry counts as absent.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

from hapticlod import _runtime
from hapticlod.files import atomic_stream
from tuning.user_cache import cache_folder

_MAGIC = b"HapticLOD kept 1\n"
# Code whose change makes kept results stale.
_SOURCES = ("hapticlod", "tuning")
_MOST_BYTES = 4 << 30
_DIGEST_BYTES = 16


def key_of(*parts: Any) -> str:
    """Hex digest of the parts' representations; give digests for arrays."""
    return hashlib.blake2b(repr(parts).encode(), digest_size=20).hexdigest()


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Hex digest of the native module and of all Python sources of both packages."""
    hasher = hashlib.blake2b(digest_size=16)
    native = Path(str(_runtime.__file__))
    root = native.parent.parent
    sources = [path for package in _SOURCES for path in sorted((root / package).rglob("*.py"))]
    for path in [native, *sources]:
        hasher.update(path.name.encode())
        hasher.update(path.read_bytes())
    return hasher.hexdigest()


def load(kind: str, key: str) -> Any | None:
    """The entry, or None where there is none that can be read."""
    path = _path(kind, key)
    head = _MAGIC + key.encode() + b"\n"
    try:
        with path.open("rb") as stream:
            if stream.read(len(head)) != head:
                return None
            left = os.fstat(stream.fileno()).st_size - len(head) - _DIGEST_BYTES
            if _digest_of(stream, left) != stream.read(_DIGEST_BYTES):
                return None
            stream.seek(len(head))
            # The folder is the user's own: what is in it is as trusted as the program itself.
            value = pickle.load(stream)
        path.touch()  # newest use last: `trim` drops the others first
    except Exception:  # an entry of another version may fail in any way; it is then as good as absent
        return None
    return value


def store(kind: str, key: str, value: Any) -> None:
    """Keeps an entry; where there is no place to, nothing happens.

    It is written as it is pickled: that of five million triangles is a gigabyte.
    """
    path = _path(kind, key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_stream(path) as stream:
            stream.write(_MAGIC + key.encode() + b"\n")
            through = _Hashing(stream)
            pickle.dump(value, through, protocol=5)  # pyright: ignore[reportArgumentType]  # it needs `write` alone
            stream.write(through.digest())
        trim(path.parent)
    except Exception:  # a full or read-only disk must not stop a tuning run
        return


class Pieces:
    """A long piece of work in pieces, each kept when it is done: `hapticlod.ladder.Keep`. Once the whole is kept, the
    pieces are of no use and should be dropped."""

    def __init__(self, kind: str, key: str) -> None:
        self._kind, self._key = kind, key
        self._keys: list[str] = []

    def __call__(self, name: str, make: Callable[[], Any]) -> Any:
        key = key_of(self._key, name)
        self._keys.append(key)
        found = load(self._kind, key)
        if found is None:
            found = make()
            store(self._kind, key, found)
        return found

    def drop(self) -> None:
        """Forget all pieces that were asked for."""
        for key in self._keys:
            with suppress(OSError):
                _path(self._kind, key).unlink(missing_ok=True)


class _Hashing:
    """Passes what is written on, and hashes it."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._hasher = hashlib.blake2b(digest_size=_DIGEST_BYTES)

    def write(self, data: Any) -> int:
        self._hasher.update(data)
        return self._stream.write(data)

    def digest(self) -> bytes:
        return self._hasher.digest()


def _digest_of(stream: BinaryIO, count: int) -> bytes:
    """Of the next `count` bytes."""
    hasher = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    while count > 0 and (block := stream.read(min(count, 1 << 20))):
        hasher.update(block)
        count -= len(block)
    return hasher.digest()


def trim(folder: Path, most_bytes: int = _MOST_BYTES) -> None:
    """Drops the entries that were not used for longest, until the folder is no larger than allowed."""
    entries = sorted(folder.glob("*.kept"), key=lambda path: path.stat().st_mtime, reverse=True)
    total = 0
    for path in entries:
        total += path.stat().st_size
        if total > most_bytes:
            path.unlink(missing_ok=True)


def _path(kind: str, key: str) -> Path:
    return cache_folder() / kind / f"{key}.kept"
