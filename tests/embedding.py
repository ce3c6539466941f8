"""What the tests of the C ABI share: the built library, a C compiler."""

import os
import shutil
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


def build_tree() -> Path:
    """The CMake tree, $HAPTICLOD_BUILD or build/release; skips where libhapticlod was not built in it."""
    tree = Path(os.environ.get("HAPTICLOD_BUILD") or REPOSITORY / "build" / "release")
    if not (tree / "libhapticlod.so").exists():
        pytest.skip("libhapticlod is not built: run make build")
    return tree


def library() -> Path:
    """libhapticlod.so."""
    return build_tree() / "libhapticlod.so"


def compiler() -> str:
    """A C compiler; skips without one."""
    return needed("cc", "build-essential")


def needed(program: str, package: str) -> str:
    """Where a program is; skips where it is not."""
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"no {program} here: install {package}")
    return found
