"""Compiled surrogates are kept between runs: the second scan with the same tool does not compile again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from tuning.user_cache import cache_folder

# XLA's fusion emitters double the time of code generation on a CPU, and what they make runs no faster (measured on the
# surrogate and its slopes; docs/decisions.md). Options of a backend that is not there are refused, so only on a CPU.
_CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`eqx.filter_jit` of a function that is expensive to compile. The backend is chosen at the first call."""
    made: list[Callable[..., Any]] = []

    def call(*args: Any) -> Any:
        if not made:
            options = _CPU_OPTIONS if jax.default_backend() == "cpu" else {}

            def run(arrays: Any, fixed: Any) -> Any:
                return function(*eqx.combine(arrays, fixed))

            made.append(jax.jit(run, static_argnums=1, compiler_options=options))
        return made[0](*eqx.partition(args, eqx.is_array))

    return call


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
