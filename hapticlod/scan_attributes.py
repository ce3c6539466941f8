"""What a mesh file says of its surface besides its shape: materials as PLY face properties, colours."""

from __future__ import annotations

from typing import Any

import numpy as np

from hapticlod.errors import InputError
from hapticlod.material import COLUMNS, check_materials

# Accepted names of a face's property, by column of `hapticlod.material.COLUMNS`.
PROPERTY_NAMES = {
    "stiffness_n_mm": ("stiffness_n_mm", "stiffness"),
    "friction_static": ("friction_static",),
    "friction_dynamic": ("friction_dynamic",),
}


def face_materials(part: Any, faces: int, where: str) -> np.ndarray | None:
    """(faces, 3) materials of a trimesh that came from a PLY file, NaN where it has no value; None: it has none.

    Raises:
        InputError: a property is given twice or not for every triangle, friction is given in part, or a value is
            impossible.
    """
    raw = part.metadata.get("_ply_raw", {}).get("face", {}).get("data")
    names = set(raw if isinstance(raw, dict) else getattr(getattr(raw, "dtype", None), "names", None) or ())
    found: dict[str, str] = {}
    for column, accepted in PROPERTY_NAMES.items():
        given = [name for name in accepted if name in names]
        if len(given) > 1:
            raise InputError(where, f"its faces have both {' and '.join(given)}", "keep one of them")
        if given:
            found[column] = given[0]
    if not found:
        return None
    friction = [name for name in COLUMNS[1:] if name in found]
    if len(friction) == 1:
        missing = next(name for name in COLUMNS[1:] if name not in found)
        raise InputError(where, f"its faces have {friction[0]} without {missing}", "give both coefficients of friction")
    values = np.full((faces, 3), np.nan)
    for column, name in found.items():
        assert raw is not None
        row = np.asarray(raw[name])
        if row.size != faces or row.dtype.kind not in "iuf":
            raise InputError(
                where, f"{name} has {row.size} values for {faces} triangles", "split its polygons into triangles first"
            )
        values[:, COLUMNS.index(column)] = row.reshape(faces)
    return check_materials(values, faces, where)


def corner_colours(part: Any, faces: np.ndarray) -> np.ndarray | None:
    """(m, 3, 3) uint8 red, green, blue of every corner of `faces`; a face's own colour thrice. None: no colours."""
    kind = getattr(part.visual, "kind", None)
    if kind == "vertex":
        return np.asarray(part.visual.vertex_colors, dtype=np.uint8)[:, :3][faces]
    if kind == "face":
        return np.repeat(np.asarray(part.visual.face_colors, dtype=np.uint8)[:, None, :3], 3, axis=1)
    return None
