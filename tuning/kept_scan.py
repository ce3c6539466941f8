"""Cleaned scans kept between runs: reading and mending a large one takes longer than tuning it for another budget."""

from __future__ import annotations

import hashlib
from pathlib import Path

from hapticlod.scan import Scan, load_scan
from tuning import kept

# Formats whose whole content is in the one file: others name files beside them, which a digest of theirs misses.
_WHOLE = {".ply", ".stl", ".off"}


def load_kept_scan(path: Path, unit: str | None, *, strict: bool = False) -> Scan:
    """`hapticlod.scan.load_scan`, or what it gave for a file of the same content and name."""
    if path.suffix.lower() not in _WHOLE or not path.is_file():
        return load_scan(path, unit, strict=strict)
    try:
        digest = hashlib.blake2b(path.read_bytes(), digest_size=20).hexdigest()
    except OSError:
        return load_scan(path, unit, strict=strict)
    key = kept.key_of("scan", digest, str(path), unit, strict, kept.code_digest())
    found = kept.load("scans", key)
    if found is None:
        found = load_scan(path, unit, strict=strict)
        _ = found.digest  # kept with it
        kept.store("scans", key, found)
    return found
