"""The configuration files that come with HapticLOD: tools, stations, level sets, presets of perception."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
# A wheel carries configs/ inside the package; a source tree has it beside the package.
_FOLDERS = (_PACKAGE / "configs", _PACKAGE.parent / "configs")


def shipped_config(name: str) -> Path:
    """Path of a shipped configuration file, e.g. `shipped_config("tools/point.toml")`.

    Raises:
        FileNotFoundError: there is none of that name.
    """
    for folder in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"no shipped configuration named {name}")
