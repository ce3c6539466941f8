"""hapticlod.h is what a C program includes: plain C99, no warning, its records as large as the manual says."""

import shutil
import subprocess
from pathlib import Path

import pytest

INCLUDE = Path(__file__).resolve().parent.parent / "runtime" / "include"

PROGRAM = """
#include "hapticlod/hapticlod.h"
typedef char record_is_144_bytes[sizeof(hlod_record) == 144 ? 1 : -1];
static double follow(hlod_renderer* renderer, const double position_mm[3]) {
    hlod_record record;
    if (hlod_tick(renderer, 0.0, position_mm, NULL, &record) != HLOD_OK || (record.errors & HLOD_ERR_START_INSIDE)) {
        return 0.0;
    }
    return record.force_n[2];
}
int main(void) {
    const double position_mm[3] = {0.0, 0.0, 0.0};
    const hlod_options options = {sizeof(hlod_options), 0.5, 0.0, 0.0};
    return (int)follow(NULL, position_mm) + (int)options.loop_hz + (int)sizeof(record_is_144_bytes);
}
"""


@pytest.mark.parametrize(("compiler", "standard"), [("cc", "c99"), ("c++", "c++11")])
def test_header_compiles_alone(tmp_path: Path, compiler: str, standard: str) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} here: install build-essential")
    language = "c" if compiler == "cc" else "c++"
    source = tmp_path / "host.txt"
    source.write_text(PROGRAM)
    flags = [f"-std={standard}", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{INCLUDE}"]
    result = subprocess.run(
        [compiler, "-x", language, *flags, str(source)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
