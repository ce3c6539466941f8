"""The mesh of the page's 3-D view: positions, corners and one byte per vertex and colouring, packed as text."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_TRIANGLES = 400_000
# From dark blue to yellow, in order also in grey and with every kind of colour vision (cividis, in six stops).
RAMP = ((0, 34, 78), (55, 70, 109), (104, 107, 114), (148, 142, 119), (199, 180, 99), (254, 232, 56))
GREY = (225, 225, 225)
# Okabe and Ito's, as in the figures.
CLASSES = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0), (90, 90, 90),
           (240, 228, 66))  # fmt: skip


@dataclass(frozen=True)
class Colouring:
    """One field over the vertices. `values` (n,): numbers from 0 to `most`, or, with `names`, indices into these."""

    title: str
    values: NDArray[Any]
    most: float = 1.0
    unit: str = ""
    names: tuple[str, ...] = ()

    def about(self) -> dict[str, Any]:
        if self.names:
            colours = [GREY, *CLASSES][: len(self.names)]
            return {"title": self.title, "classes": True, "names": self.names, "colours": colours}
        return {"title": self.title, "classes": False, "most": f"{self.most:.3g} {self.unit}", "colours": RAMP}

    def packed(self) -> bytes:
        scaled = self.values if self.names else 255.0 * np.clip(self.values / max(self.most, 1e-12), 0.0, 1.0)
        return np.round(scaled).astype(np.uint8).tobytes()


def view_html(vertices: NDArray[Any], faces: NDArray[Any], colourings: Sequence[Colouring], title: str) -> str:
    """The view as HTML with its data and program inside. vertices (n, 3) mm, faces (m, 3)."""
    least, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-9)
    steps = np.round((vertices - least) / size * 65535.0).astype("<u2").T.reshape(-1)
    planes = steps.view(np.uint8).reshape(-1, 2).T
    difference = np.diff(faces.reshape(-1).astype(np.int64), prepend=0)
    zigzag = np.where(difference >= 0, 2 * difference, -2 * difference - 1).astype("<u4")
    corners = zigzag.view(np.uint8).reshape(-1, 4).T
    data = planes.tobytes() + corners.tobytes() + b"".join(c.packed() for c in colourings)
    about = {
        "vertices": len(vertices), "triangles": len(faces), "size_mm": size.tolist(),
        "fields": [c.about() for c in colourings],
    }  # fmt: skip
    options = "".join(f"<option>{escape(c.title)}</option>" for c in colourings)
    text = base64.b64encode(zlib.compress(data, 9)).decode()
    program = (Path(__file__).parent / "view3d.js").read_text(encoding="utf-8")
    return (
        f'<div class="controls"><label>Coloured by <select id="colouring">{options}</select></label>'
        '<button id="reset" type="button">Reset the view</button></div>'
        f'<div class="view"><canvas id="view" tabindex="0" role="img" aria-label="{escape(title, quote=True)}">'
        "</canvas></div>"
        '<div class="legend" id="legend"></div><p class="quiet" id="view-state">Loading the mesh.</p>'
        f'<script type="application/json" id="mesh-about">{_json(about)}</script>'
        f'<script type="text/plain" id="mesh-data">{text}</script><script>{program}</script>'
    )


def _json(value: Any) -> str:
    # "</script>" in a name must not end the script that holds it.
    return json.dumps(value).replace("<", "\\u003c")
