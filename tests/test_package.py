"""The package as users import it: light, complete, and with arrows that point one way."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import hapticlod

REPOSITORY = Path(__file__).resolve().parent.parent
SOURCES = {part: sorted((REPOSITORY / part).rglob("*.py")) for part in ("hapticlod", "tuning")}


def imports_of(source: Path) -> set[str]:
    """Top-level packages that a module names in its import statements, wherever they stand."""
    found = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("name", hapticlod.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(hapticlod, name) is not None
    assert name in dir(hapticlod)


def test_replay_is_the_function_even_after_its_module_was_imported() -> None:
    code = "import hapticlod.replay, hapticlod; assert callable(hapticlod.replay), hapticlod.replay"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = hapticlod.no_such_thing  # type: ignore[attr-defined]


def test_importing_the_package_is_light() -> None:
    code = "import sys, hapticlod; print(sorted({'jax', 'numpy', 'trimesh', 'scipy', 'tuning'} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_the_model_knows_nothing_of_the_tuner() -> None:
    assert SOURCES["hapticlod"]
    assert [str(s) for s in SOURCES["hapticlod"] if {"tuning", "rich", "cyclopts"} & imports_of(s)] == []


def test_the_surrogate_reads_and_writes_no_file() -> None:
    surrogate = [s for s in SOURCES["hapticlod"] if s.parent.name == "surrogate"]
    assert surrogate
    assert [str(s) for s in surrogate if {"os", "pathlib", "io", "trimesh"} & imports_of(s)] == []


def test_what_is_imported_is_declared() -> None:
    """A package that happens to be installed here would be missing on a fresh machine."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = " ".join([*project["dependencies"], *extras["report"], *extras["cluster"]]).lower().replace("-", "_")
    known = packages_distributions()
    used = set().union(*(imports_of(s) for part in SOURCES.values() for s in part))
    foreign = used - set(sys.stdlib_module_names) - {"hapticlod", "tuning"}
    owners = {name: {d.lower().replace("-", "_") for d in known.get(name, [name])} for name in foreign}
    # Parts of the interfaces of equinox, optimistix and pydantic, which bring them along.
    owners = {name: own for name, own in owners.items() if name not in ("jaxtyping", "lineax", "pydantic_core")}
    assert {name for name, own in owners.items() if not any(o in wanted for o in own)} == set()


def test_commands_load_none_of_the_optional_packages() -> None:
    """Figures, Parquet and Dask are extras: who did not ask for them must not need them."""
    modules = [f"tuning.commands.{path.stem}" for path in SOURCES["tuning"] if path.parent.name == "commands"]
    assert "tuning.commands.compare" in modules
    code = (
        f"import sys, importlib, tuning.cli\nfor name in {modules}: importlib.import_module(name)\n"
        "print(sorted({'matplotlib', 'pyarrow', 'distributed', 'jax'} & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"
