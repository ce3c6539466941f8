"""Pydantic's validation errors as `file:line:column: field: message`, with a suggestion for misspelt names."""

import difflib
import re
import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from hapticlod.toml_places import key_places


def faults_of(error: ValidationError, model: type[BaseModel], text: str, name: str) -> list[tuple[str, str]]:
    """(`file:line:column`, `field: message`) per fault, in file order."""
    places = key_places(text)
    details = error.errors(include_url=False)
    meant = {(*fault["loc"][:-1], _suggestion(fault, model)) for fault in details if fault["type"] == "extra_forbidden"}
    rows: list[tuple[tuple[int, int], str]] = []
    for fault in details:
        if fault["type"] == "missing" and fault["loc"] in meant:
            continue  # the misspelt key is reported; it is one fault, not two
        *parents, key = pointed(fault) or ("file",)
        path: tuple[str | int, ...] = ()
        for element in parents:
            if (*path, element) in places:  # tags of unions are no keys of the file
                path = (*path, element)
        field, message = ".".join(map(str, (*path, key))), described(fault, model)
        path = (*path, key) if (*path, key) in places else path  # a missing key has no place
        rows.append((places[path], f"{field}: {message}"))
    return [(f"{name}:{line}:{column}", text) for (line, column), text in sorted(rows, key=lambda row: row[0])]


def pointed(fault: ErrorDetails) -> tuple[str | int, ...]:
    """The path a fault is about; for faults of a whole table the key in it that is to blame."""
    context = fault.get("ctx", {})
    if fault["type"] == "fault_at":
        return (*fault["loc"], *(int(key) if key.isdigit() else key for key in context["field"].split(".")))
    if fault["type"].startswith("union_tag"):
        return (*fault["loc"], context["discriminator"].strip("'"))
    return fault["loc"]


def described(fault: ErrorDetails, model: type[BaseModel]) -> str:
    """What is wrong, in words."""
    context = fault.get("ctx", {})
    match fault["type"]:
        case "extra_forbidden":
            close = _suggestion(fault, model)
            message = "unknown key" + (f"; did you mean {close}?" if close else "")
        case "missing" | "union_tag_not_found":
            message = "missing"
        case "literal_error" | "union_tag_invalid":
            allowed = re.findall(r"'([^']*)'", str(context.get("expected", context.get("expected_tags"))))
            given = context.get("tag", fault["input"])
            close = difflib.get_close_matches(str(given), allowed, 1)
            message = f"{given!r} is none of {', '.join(allowed)}" + (f"; did you mean {close[0]}?" if close else "")
        case "fault_at":
            message = fault["msg"]
        case _:
            shown = repr(fault["input"])
            message = fault["msg"][:1].lower() + fault["msg"][1:]
            message += f" (got {shown if len(shown) < 40 else shown[:36] + ' ...'})"
    return message


def _suggestion(fault: ErrorDetails, model: type[BaseModel]) -> str | None:
    """The known key that an unknown one most resembles."""
    *parents, key = fault["loc"]
    models: set[type[BaseModel]] = set(_models_in(model, "root")) if "root" in model.model_fields else {model}
    for element in parents:
        if isinstance(element, str):
            inner = {m for parent in models if element in parent.model_fields for m in _models_in(parent, element)}
            tagged = {m for m in models if "kind" in m.model_fields and m.model_fields["kind"].default == element}
            models = inner or tagged or models
    names = sorted({name for m in models for name in m.model_fields})
    close = difflib.get_close_matches(str(key), names, 1, cutoff=0.6)
    return close[0] if close else None


def _models_in(parent: type[BaseModel], field: str) -> Iterator[type[BaseModel]]:
    stack: list[Any] = [parent.model_fields[field].annotation]
    while stack:
        kind = stack.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield kind
        else:
            stack.extend(typing.get_args(kind))
