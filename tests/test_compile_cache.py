"""Kept executables: a new process runs them without tracing, and other shapes or settings are not mistaken for them."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
import jax, jax.numpy as jnp
from tuning.compile_cache import compiled, keep_compiled

traced = []

@compiled
def solve(matrix, right, scale):
    traced.append(1)
    factor = jax.scipy.linalg.cho_factor(matrix)
    return {"x": scale * jax.scipy.linalg.cho_solve(factor, right)}, (jnp.sum(matrix),)

keep_compiled()
for size, scale in eval(sys.argv[1]):
    matrix = jnp.eye(size) * 4.0 + 1.0
    found, (total,) = solve(matrix, jnp.arange(float(size)), scale)
    assert jnp.allclose(matrix @ found["x"], scale * jnp.arange(float(size)))
    assert float(total) == size * (4.0 + size)
print(len(traced))
"""


def traced(folder: Path, *calls: tuple[int, float]) -> int:
    """How many programs a new process traces to make these calls. It compiles as it does for users, not as tests do."""
    environment = {**os.environ, "HAPTICLOD_CACHE": str(folder), "XLA_FLAGS": ""}
    del environment["JAX_COMPILATION_CACHE_DIR"]
    words = [sys.executable, "-c", PROGRAM, repr(calls)]
    return int(subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout)


def test_a_program_is_traced_once_for_all_processes(tmp_path: Path) -> None:
    assert traced(tmp_path, (3, 2.0), (3, 2.0), (5, 2.0)) == 2
    assert traced(tmp_path, (5, 2.0), (3, 2.0), (3, 7.0)) == 1
    for path in (tmp_path / "executables").glob("*.kept"):
        path.write_bytes(path.read_bytes()[:-30])
    assert traced(tmp_path, (3, 2.0)) == 1, "a damaged entry is as good as absent"
