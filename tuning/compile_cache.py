"""Compiled surrogates are kept between runs: the second scan with the same tool does not compile again."""

import os
from pathlib import Path

import jax


def cache_folder() -> Path:
    """$HAPTICLOD_CACHE, or the user's cache folder."""
    chosen = os.environ.get("HAPTICLOD_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hapticlod"


def keep_compiled() -> None:
    """Turns jax's persistent compilation cache on, unless the user has set one of their own."""
    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        folder = cache_folder() / "compiled"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return  # no place to keep anything: compile each time
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
