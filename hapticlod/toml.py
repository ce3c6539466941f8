"""TOML files as checked models, and back. Every fault of a file is reported with its file, line, column and field.

A model is a `TomlModel`: unknown keys are faults, values are not coerced ("3" is no number, nan is none either).
A validator that concerns one field of several raises `fault_at(field, message)`, so that the report points there.
"""

import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from hapticlod.errors import InputError
from hapticlod.files import write_atomic
from hapticlod.toml_faults import described, faults_of, pointed
from hapticlod.toml_text import to_toml


class TomlModel(BaseModel):
    """Base of everything that lives in a TOML file: immutable, closed, finite numbers only."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)


def fault_at(field: str, message: str) -> PydanticCustomError:
    """An error for a model validator that should point at `field` of that model; dots lead into tables below it."""
    return PydanticCustomError("fault_at", "{message}", {"field": field, "message": message})


def load_toml(path: str | Path, model: type[Model]) -> Model:
    """Reads `path` as `model`. Raises InputError naming file:line:column and field of every fault."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        reason = "is a folder" if path.is_dir() else (error.strerror or str(error))
        raise InputError(str(path), reason, "give the path of a readable TOML file") from None
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"not UTF-8 text (byte {error.start})", "save the file as UTF-8") from None
    return parse_toml(text, model, str(path))


def parse_toml(text: str, model: type[Model], name: str = "<text>") -> Model:
    """`load_toml` on a text; `name` stands for the file in messages."""
    text = text.replace("\r\n", "\n")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(name, text, str(error)) from None
    try:
        return model.model_validate(_tuples(data), strict=True)
    except ValidationError as error:
        (where, what), *others = faults_of(error, model, text, name)
        what = " | ".join([what, *(f"{place}: {text}" for place, text in others)])
        raise InputError(where, what, f"correct these {len(others) + 1} entries" if others else "correct it") from None


def checked(model: type[Model], values: dict[str, Any], where: str) -> Model:
    """A model from values that come from code (`where` names their origin). Raises InputError."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        details = error.errors(include_url=False)
        faults = [f"{'.'.join(map(str, pointed(fault)))}: {described(fault, model)}" for fault in details]
        raise InputError(where, " | ".join(faults), "change it") from None


def save_toml(path: str | Path, model: BaseModel, comment: str = "") -> None:
    """Writes `model` so that `load_toml` gives it back equal. None is left out. `comment` goes on top."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    write_atomic(Path(path), head + to_toml(model))


def _tuples(value: Any) -> Any:
    """TOML arrays as tuples: strict validation takes no list for a tuple."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return value


def _syntax_error(name: str, text: str, message: str) -> InputError:
    found = re.search(r" \(at line (\d+), column (\d+)\)$", message)
    if found:
        place, message = f"{found[1]}:{found[2]}", message[: found.start()]
    else:
        message = message.removesuffix(" (at end of document)")
        place = f"{text.count(chr(10)) + 1}:{len(text) - text.rfind(chr(10))}"
    return InputError(f"{name}:{place}", f"not TOML: {message[:1].lower() + message[1:]}", "mend the syntax there")
