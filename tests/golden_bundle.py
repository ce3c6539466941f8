"""The bundle whose bytes are kept in tests/golden/: `python tests/golden_bundle.py` writes it anew for a new format.

Two levels of a plate with two materials, a tool of three balls, eight ticks. It is signed by TEST_KEY.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from plate_bundle import CELLS_MM, TEST_KEY, plate, plate_config, plate_motion, plate_tool, rendered

from hapticlod import _runtime
from hapticlod.bundle import write_bundle

GOLDEN = Path(__file__).resolve().parent / "golden"


def golden_parts() -> dict[str, Any]:
    """Arguments of `write_bundle`."""
    meshes = [plate(squares) for squares in (2, 1)]
    soft = [np.where(v[:, :1] < 0, (0.5, 0.3, 0.2), (-1.0, -1.0, -1.0)).astype(np.float32) for v, _ in meshes]
    levels = [_runtime.Level(v, f, 8 * cell, s) for (v, f), cell, s in zip(meshes, CELLS_MM, soft, strict=True)]
    config, tool, motion = plate_config(levels), plate_tool(), plate_motion(8)
    return {
        "levels": levels,
        "config": config,
        "tool": tool,
        "manifest": {"scan": {"name": "plate"}, "tool": {"name": "three balls"}},
        "golden_motion": motion,
        "golden_record": rendered(levels, config, tool, motion),
        "key": TEST_KEY,
    }


if __name__ == "__main__":
    write_bundle(sys.argv[1], **golden_parts())
