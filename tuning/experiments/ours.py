"""What HapticLOD does differently from the paper's rule, at the same levels and speeds; nothing here is tuned."""

from typing import Any

OURS: dict[str, Any] = {
    "name": "ours", "mapping": "two-sided", "filter_hz": 20.0, "hysteresis": 0.15, "blend_ms": 20.0,
}  # fmt: skip
