"""Cleaned scans kept between runs: reading and mending a large one takes longer than tuning it for another budget."""

from __future__ import annotations

import hashlib

from hapticlod.scan import Scan, load_scan
from hapticlod.scan_file import CheckedFile
from tuning import kept

# Formats whose whole content is in the one file: others name files beside them, which a digest of theirs misses.
_WHOLE = {".ply", ".stl", ".off"}


def load_kept_scan(file: CheckedFile, unit: str | None, *, strict: bool = False) -> Scan:
    """`hapticlod.scan.load_scan`, or what it gave for a file of the same content and name."""
    if file.path.suffix.lower() not in _WHOLE:
        return load_scan(file, unit, strict=strict)
    digest = hashlib.blake2b(file.data, digest_size=20).hexdigest()
    key = kept.key_of("scan", digest, str(file.path), unit, strict, kept.code_digest())
    found = kept.load("scans", key)
    if found is None:
        found = load_scan(file, unit, strict=strict)
        _ = found.digest  # kept with it
        kept.store("scans", key, found)
    return found
