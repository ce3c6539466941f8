"""`hapticlod check`: what is wrong with a scan, and what loading it would mend. Nothing is tuned or written."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from hapticlod.scan import Scan


def check_command(scan: Path, /, *, unit: str | None = None, strict: bool = False, json: bool = False) -> None:
    """Load and clean a scan as `hapticlod tune` would, and print what that found.

    Parameters
    ----------
    scan
        Triangle mesh: STL, PLY, OBJ, OFF, GLB or 3MF.
    unit
        Unit of the scan's coordinates: mm, cm, m, um or in. Default: what the file says, else a guess from its size.
    strict
        Refuse a scan that needs repair (exit status 2) instead of mending it.
    json
        Print JSON.
    """
    from hapticlod.scan import load_scan

    loaded = load_scan(scan, unit, strict=strict)
    out = Console(highlight=False, soft_wrap=True)
    if json:
        import json as writer

        out.out(writer.dumps(diagnosis(loaded), indent=2, allow_nan=False))
        return
    size = " x ".join(f"{side:.4g}" for side in loaded.vertices.max(axis=0) - loaded.vertices.min(axis=0))
    out.print(f"{scan}: {size} mm, read in {loaded.unit}", markup=False)
    for line in loaded.report.lines():
        out.print(f"    {line}", markup=False)
    mended = loaded.report.repaired()
    out.print("usable after repair" if mended else "usable as it is")


def diagnosis(scan: "Scan") -> dict[str, Any]:
    """What `--json` prints: the repair report, and the mesh that it leaves."""
    return {
        "name": scan.name,
        "source": scan.source,
        "unit": scan.unit,
        "extent_mm": scan.extent_mm,
        "least_mm": scan.vertices.min(axis=0).tolist(),
        "most_mm": scan.vertices.max(axis=0).tolist(),
        "has_materials": scan.face_materials is not None,
        "has_colours": scan.corner_colours is not None,
        "needs_repair": bool(scan.report.repaired()),
        "report": scan.report.to_dict(),
    }
