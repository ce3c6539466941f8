"""libhapticlod as other people use it: installed, found by CMake and pkg-config, called from C and from Python."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from embedding import REPOSITORY, build_tree, compiler, library, needed
from plate_bundle import TEST_KEY, plate_motion, plate_parts, rendered

from hapticlod.bundle import write_bundle
from hapticlod.motion import Motion
from hapticlod.signature import new_key

EXAMPLES = REPOSITORY / "examples"


def call(*words: object, **environment: str) -> str:
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where `cmake --install` put the library."""
    cmake, tree = needed("cmake", "cmake"), build_tree()
    folder = tmp_path_factory.mktemp("prefix")
    call(cmake, "--install", tree, "--component", "embed", "--prefix", folder)
    return folder


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """A bundle, a file that trusts its key, and what the example prints for it, by the Python module."""
    folder, parts = tmp_path_factory.mktemp("bundle"), plate_parts(ticks=10)
    time_s = np.arange(101) / 1000.0
    down = np.stack([0 * time_s, 0 * time_s, 20.0 + 5.0 - 100.0 * time_s], 1)
    motion = Motion(time_s, down, plate_motion(101).orientation, 1000.0, "down", {})
    rows = rendered(parts["levels"], parts["config"], parts["tool"], motion)
    write_bundle(folder / "plate.hlod", **{**parts, "golden_motion": motion, "golden_record": rows})
    (folder / "keys").write_text(TEST_KEY.public_line + "\n")
    (folder / "keys").chmod(0o644)
    most_n = float(np.linalg.norm(rows["force_n"], axis=1).max())
    assert most_n > 1.0
    return folder / "plate.hlod", folder / "keys", f"{most_n:.6f}\n"


def test_cmake_finds_it_and_the_c_example_renders(prefix: Path, bundle: tuple[Path, Path, str], tmp_path: Path) -> None:
    source, keys, expected = bundle
    call("cmake", "-S", EXAMPLES / "c", "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_BUILD_TYPE=Release")
    call("cmake", "--build", tmp_path)
    assert call(tmp_path / "touch", source, keys) == expected


def test_pkg_config_finds_it_and_faults_are_one_line(
    prefix: Path, bundle: tuple[Path, Path, str], tmp_path: Path
) -> None:
    compiler()
    needed("pkg-config", "pkg-config")
    source, keys, expected = bundle
    (found,) = prefix.rglob("hapticlod.pc")
    for name in ("touch.c", "Makefile"):
        (tmp_path / name).write_text((EXAMPLES / "c" / name).read_text())
    call("make", "-C", tmp_path, PKG_CONFIG_PATH=str(found.parent))
    path = {"LD_LIBRARY_PATH": str(next(prefix.rglob("libhapticlod.so.1")).parent)}
    assert call(tmp_path / "touch", source, keys, **path) == expected
    stranger = tmp_path / "strangers"
    stranger.write_text(new_key("mallory").public_line + "\n")
    stranger.chmod(0o644)
    for words, reason in (
        ([tmp_path / "no.hlod", keys], "no.hlod: cannot be opened"),
        ([source, stranger], "is signed by a key that is not trusted here"),
        ([source, tmp_path / "nobody"], "nobody: cannot be opened"),
        ([source], "usage: touch"),
    ):
        done = subprocess.run([tmp_path / "touch", *words], capture_output=True, text=True, env={**os.environ, **path})
        assert done.returncode == 2 and done.stdout == ""
        assert reason in done.stderr and len(done.stderr.splitlines()) == 1


def test_the_ctypes_example_renders(bundle: tuple[Path, Path, str]) -> None:
    source, keys, expected = bundle
    assert call(sys.executable, EXAMPLES / "python" / "touch.py", library(), source, keys) == expected


HOST = """
#include <hapticlod/hapticlod.h>
#include <sys/mman.h>
#include <stdexcept>
struct cVector3d {  // as much of CHAI3D's as the lines use
    double v[3];
    cVector3d(double x = 0, double y = 0, double z = 0) : v{x, y, z} {}
    double x() const { return v[0]; }
    double y() const { return v[1]; }
    double z() const { return v[2]; }
};
cVector3d operator+(const cVector3d&, const cVector3d&);
cVector3d operator*(double, const cVector3d&);
struct Device { bool getPosition(cVector3d&); bool setForce(const cVector3d&); };
struct Clock { double getCurrentTimeSeconds(); };
void host(Device* device, Clock& clock, cVector3d position_m, cVector3d origin_m, cVector3d shown_m) {
"""


def test_the_lines_for_a_chai3d_style_host_compile(tmp_path: Path) -> None:
    text = (REPOSITORY / "docs" / "embedding.md").read_text()
    (lines,) = re.findall(r"```cpp\n(.*?)```", text, flags=re.DOTALL)
    source = tmp_path / "host.cpp"
    source.write_text(f"{HOST}{lines}    (void)shown_m;\n}}\n")
    flags = ("-std=c++17", "-Wall", "-Werror", "-Wno-unused", "-fsyntax-only", f"-I{REPOSITORY}/runtime/include")
    call(needed("c++", "build-essential"), *flags, source)
