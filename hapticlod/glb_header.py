"""Check a GLB file's counts against its length before anything is allocated for what it claims (glTF 2.0, 4.4, 5.1)."""

from __future__ import annotations

import json
import struct
from typing import Any

from hapticlod.errors import InputError

_FIX = "export or copy the file again"
_SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# Compressed geometry: its accessors say nothing about the file's length, and a reader without a decoder sees zeros.
_COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def check_glb(data: bytes, where: str) -> None:
    """Raise InputError unless the file is a GLB whose accessors fit into it, without compression of its geometry."""
    if data[:4] != b"glTF":
        raise InputError(where, "does not start like a GLB file", "save it as binary glTF (.glb)")
    document = _document(data, where)
    for name in _COMPRESSIONS:
        if name in document.get("extensionsRequired", ()):
            raise InputError(where, f"is compressed with {name}, which is not read", "save it without compression")
    views = document.get("bufferViews", [])
    for number, accessor in enumerate(document.get("accessors", [])):
        try:
            count = int(accessor["count"])
            needed = count * _SIZES[accessor["componentType"]] * _NUMBERS[accessor["type"]]
            view = accessor.get("bufferView")
            held = len(data) if view is None else min(int(views[view]["byteLength"]), len(data))
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{where}, accessor {number}", "is not as glTF has it", _FIX) from error
        if count < 0 or needed > held:
            claim = f"claims {count} of {accessor['type']} ({needed} bytes), {held} bytes are there"
            raise InputError(f"{where}, accessor {number}", f"is cut short or damaged: {claim}", _FIX)


def _document(data: bytes, where: str) -> dict[str, Any]:
    try:
        length, kind = struct.unpack_from("<I4s", data, 12)
        if kind != b"JSON" or 20 + length > len(data):
            raise ValueError("its first chunk is cut short or no JSON")
        document = json.loads(data[20 : 20 + length])
        if not isinstance(document, dict):
            raise ValueError("its JSON is no object")
        return document
    except (struct.error, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:100]
        raise InputError(where, f"cannot be read as GLB ({reason})", _FIX) from error
