"""What was expensive to find out, kept between runs under the hash of everything it depends on.

A key covers inputs (by content), settings, the runtime's machine code and the code that measures: whatever changes,
the old entry is simply never asked for again. A damaged or foreign entry counts as absent.
"""

from __future__ import annotations

import hashlib
import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

from hapticlod import _runtime
from hapticlod.files import write_atomic
from tuning.user_cache import cache_folder

_MAGIC = b"HapticLOD kept 1\n"
# Code whose change makes kept results stale.
_SOURCES = ("hapticlod", "tuning")
_MOST_BYTES = 4 << 30


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
    try:
        data = path.read_bytes()
    except OSError:
        return None
    head = _MAGIC + key.encode() + b"\n"
    if not data.startswith(head):
        return None
    body, digest = memoryview(data)[len(head) : -16], data[-16:]
    if hashlib.blake2b(body, digest_size=16).digest() != digest:
        return None
    try:
        # The folder is the user's own: what is in it is as trusted as the program itself.
        value = pickle.loads(body)
    except Exception:  # an entry of another version may fail in any way; it is then as good as absent
        return None
    path.touch()  # newest use last: `trim` drops the others first
    return value


def store(kind: str, key: str, value: Any) -> None:
    """Keeps an entry; where there is no place to, nothing happens."""
    body = pickle.dumps(value, protocol=5)
    data = _MAGIC + key.encode() + b"\n" + body + hashlib.blake2b(body, digest_size=16).digest()
    path = _path(kind, key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, data)
        trim(path.parent)
    except Exception:  # a full or read-only disk must not stop a tuning run
        return


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
