"""Models as TOML text (the standard library only reads TOML)."""

import json
from typing import Any

from pydantic import BaseModel


def to_toml(model: BaseModel) -> str:
    """`model` as TOML text."""
    return "\n".join(_table_lines(model.model_dump(mode="python", exclude_none=True), ())) + "\n"


def _table_lines(table: dict[str, Any], path: tuple[str, ...]) -> list[str]:
    nested = {key: value for key, value in table.items() if _is_table(value) or _is_tables(value)}
    lines = [f"{key} = {_literal(value)}" for key, value in table.items() if key not in nested]
    for key, value in nested.items():
        name = ".".join((*path, key))
        if _is_table(value):
            lines += ["", f"[{name}]", *_table_lines(value, (*path, key))]
        else:
            for item in value:
                lines += ["", f"[[{name}]]", *_table_lines(item, (*path, key))]
    return lines


def _is_table(value: Any) -> bool:
    return isinstance(value, dict)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and all(isinstance(item, dict) for item in value)


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_literal(item) for item in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
