"""The C ABI does not change unnoticed: tests/abi/ holds every function, struct, field and constant of version 1.

Adding a function or constant means adding its line. Changing a line is a new HLOD_ABI_VERSION and a new file.
"""

import re
import subprocess
from pathlib import Path

import pytest
from embedding import REPOSITORY, compiler, library

HEADER = REPOSITORY / "runtime" / "include" / "hapticlod" / "hapticlod.h"
ABI = Path(__file__).resolve().parent / "abi" / "abi_1.txt"


def header_text() -> str:
    """The header without comments and preprocessor lines."""
    text = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.DOTALL)
    return re.sub(r"^#.*$", "", text, flags=re.MULTILINE)


def declared() -> list[str]:
    """What the header declares: `function name`, `constant name`, `struct name`, `field struct.name`."""
    text, lines = header_text(), []
    for body, name in re.findall(r"typedef struct \w+ \{(.*?)\} (\w+);", text, flags=re.DOTALL):
        lines.append(f"struct {name}")
        lines += [f"field {name}.{field}" for field in re.findall(r"(\w+)(?:\[\w+\])?;", body)]
    for body in re.findall(r"enum[ \w]*\{(.*?)\}", text, flags=re.DOTALL):
        lines += [f"constant {name}" for name in re.findall(r"(HLOD_\w+) =", body)]
    lines += [f"constant {name}" for name in re.findall(r"#define (HLOD_\w+) \d+u", HEADER.read_text())]
    return lines + [f"function {name}" for name in re.findall(r"(hlod_\w+)\(", text)]


def measured(folder: Path) -> list[str]:
    """The same with sizes, offsets and values, as the compiler sees them."""
    prints = []
    for line in declared():
        kind, name = line.split()
        if kind == "struct":
            prints.append(f'printf("{line} size %zu\\n", sizeof({name}));')
        elif kind == "constant":
            prints.append(f'printf("{line} %lld\\n", (long long){name});')
        elif kind == "function":
            prints.append(f'printf("{line}\\n");')
        else:
            struct, field = name.split(".")
            size = f"sizeof((({struct}*)0)->{field})"
            prints.append(f'printf("{line} at %zu size %zu\\n", offsetof({struct}, {field}), {size});')
    source = folder / "abi.c"
    source.write_text(
        "#include <stdio.h>\n#include <hapticlod/hapticlod.h>\nint main(void) {\n" + "\n".join(prints) + "\n}\n"
    )
    subprocess.run([compiler(), "-std=c99", f"-I{HEADER.parent.parent}", source, "-o", folder / "abi"], check=True)
    return subprocess.run([folder / "abi"], capture_output=True, text=True, check=True).stdout.splitlines()


def test_nothing_changed(tmp_path: Path) -> None:
    assert sorted(measured(tmp_path)) == sorted(ABI.read_text().splitlines())


def test_the_prototypes_are_the_recorded_ones() -> None:
    """Return and argument types, which no compiled number shows."""
    text = " ".join(header_text().split())
    found = sorted(match.replace(" HLOD_NOEXCEPT", "") for match in re.findall(r"HLOD_API ([^;]+);", text))
    assert found == sorted((ABI.parent / "prototypes_1.txt").read_text().splitlines())


def test_the_library_exports_these_functions_and_no_other_name() -> None:
    shown = subprocess.run(["nm", "-D", "--defined-only", library()], capture_output=True, text=True, check=True).stdout
    names = sorted(line.split()[-1] for line in shown.splitlines())
    assert names == sorted(line.split()[1] for line in ABI.read_text().splitlines() if line.startswith("function "))
    dynamic = subprocess.run(["readelf", "-d", library()], capture_output=True, text=True, check=True).stdout
    assert "soname: [libhapticlod.so.1]" in dynamic


def test_the_check_notices_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changed = tmp_path / "hapticlod" / "hapticlod.h"
    changed.parent.mkdir()
    changed.write_text(HEADER.read_text().replace("    double scp_mm[3];", "    float scp_mm[3];"))
    monkeypatch.setattr("test_abi.HEADER", changed)
    lost = set(ABI.read_text().splitlines()) - set(measured(tmp_path))
    assert "field hlod_record.scp_mm at 32 size 24" in lost
