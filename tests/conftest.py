"""What every test shares: where the real scans are, a small dentition, float64 in jax."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hapticlod.scan import Scan

# Read by jax when a test first imports it; tests that never touch jax do not pay for importing it.
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# What these tests cost is compiling. Programs that run for milliseconds are translated quickly rather than well.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")

# One cache for all processes of a run, and none of the user's: what one test has compiled, another reads.
if "PYTEST_XDIST_WORKER" not in os.environ:
    _CACHE = tempfile.mkdtemp(prefix="hapticlod-tests-")
    os.environ["HAPTICLOD_CACHE"] = _CACHE
    os.environ["JAX_COMPILATION_CACHE_DIR"] = f"{_CACHE}/compiled"

    def pytest_unconfigure() -> None:
        """Remove the cache."""
        shutil.rmtree(_CACHE, ignore_errors=True)


REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session", autouse=True)
def config_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A configuration folder in which there is no signing key and one trusted key, whatever the user has in theirs."""
    folder = tmp_path_factory.mktemp("config")
    # The public half of plate_bundle.TEST_KEY.
    (folder / "trusted_keys").write_text("ed25519 A6EHv/POEL4dcN0Y50vAmWfk1jCbpQ1fHdyGZBJVMbg= tests\n")
    (folder / "trusted_keys").chmod(0o644)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTICLOD_CONFIG", str(folder))
        yield folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The long ones first: at the end no process waits for another."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Keep float64 on, even where a module under test switched it off, and keep what is compiled for all processes."""
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    if "tuning.compile_cache" in sys.modules:
        sys.modules["tuning.compile_cache"].keep_compiled()


DATA = Path(os.environ.get("HAPTICLOD_DATA") or REPOSITORY.parent / "shared" / "data")


@pytest.fixture(scope="session")
def data_dir_or_none() -> Path | None:
    """Folder of the real scans and hand motions, for tests that use them where they are."""
    return DATA if (DATA / "meshes").is_dir() else None


@pytest.fixture(scope="session")
def data_dir(data_dir_or_none: Path | None) -> Path:
    """Folder of the real scans and hand motions ($HAPTICLOD_DATA, else ../shared/data beside the repository)."""
    folder = DATA
    if data_dir_or_none is None:
        pytest.skip(
            f"real scans not found in {folder}: set HAPTICLOD_DATA to the folder that holds meshes/ and motion/"
        )
    return folder


@pytest.fixture(scope="session")
def small_dentition() -> Scan:
    """A generated lower dentition of about 20 000 triangles."""
    from hapticlod.dentition import make_dentition

    return make_dentition(triangles=20_000, seed=0)
