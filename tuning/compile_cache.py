"""Compiled surrogates are kept between runs: the second scan of a shape neither traces nor compiles again.

An executable lies under the hash of its program, and the program's hash under that of all that the program is made
from: a line of ours that changed nothing in it costs one tracing. jax's own cache is not used: an executable that came
from there cannot be written a second time (jax 0.10: functions are missing when it is called; docs/decisions.md D93).
"""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import Any

import equinox as eqx
import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from tuning import kept

# XLA's fusion emitters double the time of code generation on a CPU, and its higher levels of optimisation add another
# half; what they make of the surrogate and its slopes runs no faster (measured; docs/decisions.md D20, D56). Sums that
# YNNPACK takes over (the default of jaxlib 0.10) are made anew for each use: without it a search's step takes two
# thirds of the time (D111). Options of a backend that is not there are refused, so only on a CPU.
_CPU_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    "xla_cpu_experimental_ynn_fusion_type": "",
}

_SELDOM = {"xla_backend_optimization_level": 0}

_keeping = False


def compiled(function: Callable[..., Any], *, seldom: bool = False) -> Callable[..., Any]:
    """`eqx.filter_jit` of a function that is expensive to compile; results are built of tuples, lists and dicts.

    The backend is chosen at the first call. Calls from several threads compile once. `seldom`: it is called so seldom
    that compiling it counts: a third of the time to compile on a CPU, three times as long to run.
    """
    made: dict[Any, Any] = {}
    lock = Lock()

    def call(*args: Any) -> Any:
        arrays, fixed = eqx.partition(args, eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        signature = (tree, tuple((x.shape, str(x.dtype), x.weak_type) for x in leaves), fixed)
        if signature not in made:
            with lock:
                if signature not in made:
                    made[signature] = _executable(function, leaves, tree, fixed, signature, seldom)
        return made[signature](leaves)

    return call


def keep_compiled() -> None:
    """From now on executables are kept in the user's cache."""
    global _keeping
    _keeping = True


def _executable(
    function: Callable[..., Any], leaves: list, tree: Any, fixed: Any, signature: Any, seldom: bool = False
) -> Any:
    """From the user's cache, or compiled and kept there."""

    def run(leaves: list) -> Any:
        return function(*eqx.combine(jax.tree.unflatten(tree, leaves), fixed))

    if not _keeping:
        return jax.jit(run).lower(leaves).compile(compiler_options=_options(seldom))
    named = f"{function.__module__}.{function.__qualname__}"
    key = kept.key_of("program", named, signature, kept.code_digest(), *_backend(seldom))
    program = kept.load("programs", key)
    executable = None if program is None else _read_back(program)
    if executable is not None:
        return executable
    lowered = jax.jit(run).lower(leaves)
    program = kept.key_of("executable", hashlib.blake2b(lowered.as_text().encode()).hexdigest(), *_backend(seldom))
    kept.store("programs", key, program)
    executable = _read_back(program)
    if executable is None:
        executable = lowered.compile(compiler_options=_options(seldom))
        _keep(program, executable, leaves)
    return executable


def _read_back(program: str) -> Any | None:
    """The executable of a program; None where there is none that can be read."""
    stored = kept.load("executables", program)
    if stored is None:
        return None
    try:
        _load_linear_algebra()
        return deserialize_and_load(*stored)
    except Exception:  # of an XLA that is not quite the same: as good as absent
        return None


def _keep(program: str, executable: Any, leaves: list) -> None:
    """Keeps an executable that runs when it is read back. One that jax had from its own cache, where the user keeps
    one, does not."""
    written = serialize(executable)
    try:
        jax.block_until_ready(deserialize_and_load(*written)(leaves))
    except Exception:
        return
    kept.store("executables", program, written)


@lru_cache(maxsize=1)
def _load_linear_algebra() -> None:
    """jax looks up the addresses of LAPACK's functions when it first translates a program that calls them, and an
    executable that was read back calls them without having been translated: it would jump to address 0."""

    def factor(matrix: Any) -> Any:
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), matrix)

    jax.jit(factor).lower(jax.ShapeDtypeStruct((2, 2), "float32"))


def _options(seldom: bool) -> dict[str, Any]:
    """On a CPU ours, but what the user says in XLA_FLAGS goes first."""
    said = os.environ.get("XLA_FLAGS", "")
    chosen = {**_CPU_OPTIONS, **(_SELDOM if seldom else {})} if jax.default_backend() == "cpu" else {}
    return {name: value for name, value in chosen.items() if name not in said}


@lru_cache(maxsize=2)
def _backend(seldom: bool) -> tuple[str, ...]:
    """What machine code is made for and by: a home folder may be shared by unlike machines."""
    device = jax.devices()[0]
    client = device.client
    made_by = jax.__version__, version("jaxlib"), client.platform, client.platform_version, device.device_kind
    return (*made_by, platform.machine(), _cpu_features(), repr(_options(seldom)), os.environ.get("XLA_FLAGS", ""))


def _cpu_features() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.lower().startswith(("flags", "features"))), platform.processor())
