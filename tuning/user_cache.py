"""Where what may be kept between runs is kept."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """$HAPTICLOD_CACHE, or the user's cache folder."""
    chosen = os.environ.get("HAPTICLOD_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hapticlod"
