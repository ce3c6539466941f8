"""Kept executables: a new process runs them without tracing, and other shapes or settings are not mistaken for them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from functools import partial
import jax, jax.numpy as jnp
from tuning import kept
from tuning.compile_cache import compiled, keep_compiled

traced = []

@compiled
def solve(matrix, right, scale):
    traced.append(1)
    factor = jax.scipy.linalg.cho_factor(matrix)
    return {"x": scale * jax.scipy.linalg.cho_solve(factor, right)}, (jnp.sum(matrix),)

keep_compiled()
kept.code_digest = lambda: sys.argv[2]
for size, scale in eval(sys.argv[1]):
    matrix = jnp.eye(size) * 4.0 + 1.0
    found, (total,) = solve(matrix, jnp.arange(float(size)), scale)
    assert jnp.allclose(matrix @ found["x"], scale * jnp.arange(float(size)))
    assert float(total) == size * (4.0 + size)
print(len(traced))
"""


def traced(folder: Path, *calls: tuple[int, float], code: str = "as it was", jax_folder: Path | None = None) -> int:
    """How many programs a new process traces to make these calls. It compiles as it does for users, not as tests do."""
    environment = {**os.environ, "HAPTICLOD_CACHE": str(folder), "XLA_FLAGS": ""}
    del environment["JAX_COMPILATION_CACHE_DIR"]
    if jax_folder is not None:
        environment |= {"JAX_COMPILATION_CACHE_DIR": str(jax_folder), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    words = [sys.executable, "-c", PROGRAM, repr(calls), code]
    return int(subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout)


def test_a_program_is_traced_once_for_all_processes(tmp_path: Path) -> None:
    assert traced(tmp_path, (3, 2.0), (3, 2.0), (5, 2.0)) == 2
    assert traced(tmp_path, (5, 2.0), (3, 2.0), (3, 7.0)) == 1
    for path in (tmp_path / "executables").glob("*.kept"):
        path.write_bytes(path.read_bytes()[:-30])
    assert traced(tmp_path, (3, 2.0)) == 1, "a damaged entry is as good as absent"


def test_a_change_that_changes_nothing_in_a_program_costs_one_tracing(tmp_path: Path) -> None:
    """What was kept is found by its program, and is the same file. An executable that jax had from a cache of the
    user's own does not run when it is written again (jax 0.10), so it is not kept."""
    jax_folder = tmp_path / "jax"
    assert traced(tmp_path, (3, 2.0), jax_folder=jax_folder) == 1
    (first,) = (tmp_path / "executables").glob("*.kept")
    assert traced(tmp_path, (3, 2.0), code="changed", jax_folder=jax_folder) == 1
    assert traced(tmp_path, (3, 2.0), code="changed", jax_folder=jax_folder) == 0
    assert list((tmp_path / "executables").glob("*.kept")) == [first]
    first.unlink()
    assert traced(tmp_path, (3, 2.0), code="changed", jax_folder=jax_folder) == 1
    assert not list((tmp_path / "executables").glob("*.kept"))


def test_what_is_called_seldom_is_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same program, compiled in a hurry, is not given to who calls it often."""
    thorough = traced(tmp_path, (3, 2.0))
    monkeypatch.setattr(
        sys.modules[__name__], "PROGRAM", PROGRAM.replace("@compiled", "@partial(compiled, seldom=True)")
    )
    assert thorough == traced(tmp_path, (3, 2.0)) == 1
    assert len(list((tmp_path / "executables").glob("*.kept"))) == 2
    assert traced(tmp_path, (3, 2.0)) == 0
