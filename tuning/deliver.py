"""What a tuning run leaves behind: the JSON document, and the bundle with its manifest and golden record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import hapticlod
from hapticlod.bundle import write_bundle
from hapticlod.material import COLUMNS
from hapticlod.replay import replay_levels, runtime_levels
from hapticlod.scene import Scene
from tuning.load import LoadMeter
from tuning.machine import this_machine

if TYPE_CHECKING:
    from hapticlod.config import LodConfig
    from hapticlod.ladder import Ladder
    from hapticlod.motion import Motion
    from hapticlod.scan import Scan
    from hapticlod.signature import Key
    from hapticlod.station import Station
    from hapticlod.tool import Tool
    from tuning.tune import TuneResult


def document(result: TuneResult, scan: Scan) -> dict[str, Any]:
    """The tuned configuration with its predicted and measured numbers, as JSON types; what was mended of the scan.

    A metric that has no value (the hit rate of mappings that never happened) is null.

    Args:
        scan: as it was loaded. The ladder's own may be another file's that needed other repairs to become the same.
    """
    config = as_built(result)
    levels = [{"triangles": x.triangles, "cell_mm": x.cell_mm, "balls": x.balls} for x in config.levels]
    baselines = {
        _key(name): {**_numbers(metrics), "feasible": result.feasible[name], "ticks": result.ticks[name]}
        for name, metrics in result.baselines.items()
    }
    return {
        "levels": levels,
        "speeds_mm_s": list(config.speeds_mm_s),
        "hysteresis": config.hysteresis,
        "l_in_mm": config.l_in_mm,
        "l_out_mm": config.l_out_mm,
        "blend_ms": config.blend_ms,
        "filter_hz": config.filter_hz,
        "dwell_ms": config.dwell_ms,
        "mapping": config.mapping,
        "feasible": result.feasible["tuned"],
        "ticks": result.ticks["tuned"],
        "predicted": _numbers(result.predicted),
        "measured": _numbers(result.measured),
        "clock": _numbers(result.clock),
        "machine": this_machine(),
        "baselines": baselines,
        "stages_s": {name: round(seconds, 3) for name, seconds in result.stages_s.items()},
        "population": result.population,
        "sensitivities": result.sensitivities,
        "explanation": result.explanation,
        "repair": scan.report.to_dict(),
        "ladder": ladder_document(result.ladder),
    }


def ladder_document(ladder: Ladder) -> dict[str, Any]:
    """Every rung's size and what it lost, as JSON types."""
    rungs = [
        {
            "triangles": rung.triangles,
            "asked": rung.asked,
            "rms_mm": rung.rms_mm,
            "hausdorff_mm": rung.hausdorff_mm,
            "turned_part": rung.deviation.turned_part,
            "area_part": rung.area_mm2 / ladder.rungs[0].area_mm2,
            "components": rung.components,
        }
        for rung in ladder.rungs
    ]
    return {"rungs": rungs, "notes": list(ladder.notes)}


def as_built(result: TuneResult) -> LodConfig:
    """The tuned configuration with the triangle counts that its levels really have.

    A collapse removes triangles in pairs, so that a rung may miss the count it was asked for by one or two.
    """
    config = result.config
    real = [x.model_copy(update={"triangles": result.ladder.at(x.triangles).triangles}) for x in config.levels]
    return config.changed(levels=real)


def write_tuned(
    path: Path, result: TuneResult, scan: Scan, station: Station, tool: Tool, seed: int, key: Key | None = None
) -> None:
    """Write the bundle of a tuning run, signed where a key is given.

    The golden motion is the one, of those kept apart, that shows most levels.

    Raises:
        InputError: the file cannot be written.
    """
    config = as_built(result)
    levels, golden = runtime_levels(config, result.ladder), result.golden
    meter = LoadMeter()
    record = replay_levels(levels, config, scan.centre_mm, golden, tool, station, 1)
    load = meter.read()
    told = document(result, scan)
    del told["stages_s"]  # times of this run: the same answer is to give the same file
    write_bundle(
        path,
        levels=levels,
        config=config.to_runtime(station, tool, scan.centre_mm),
        tool=tool,
        manifest={
            "hapticlod": hapticlod.__version__,
            "seed": seed,
            "scan": {
                "name": scan.name,
                "source": Path(scan.source).name,
                "unit": scan.unit,
                "triangles": scan.triangles,
                "extent_mm": scan.extent_mm,
                "digest": scan.digest,
                "materials": _materials(scan),
                **_parts(scan),
            },
            "tool": {"name": tool.name, "balls": tool.balls, "digest": tool.digest},
            "station": station.model_dump(mode="json"),
            "config": config.model_dump(mode="json"),
            "motions": [_about(motion) for motion in result.motions],
            "golden_motion": _about(golden),
            "golden_load": load,
            **told,
        },
        golden_motion=golden,
        golden_record=record.rows,
        key=key,
        parts=scan.parts if isinstance(scan, Scene) else (),
    )


def _parts(scan: Scan) -> dict[str, Any]:
    """Of a scene: where its parts come from."""
    if not isinstance(scan, Scene):
        return {}
    return {
        "parts": [
            {
                "name": part.name,
                "source": Path(part.scan.source).name,
                "triangles": part.scan.triangles,
                "digest": part.scan.digest,
                "position_mm": list(part.position_mm),
                "orientation": list(part.orientation),
                "hidden": part.hidden,
            }
            for part in scan.parts
        ]
    }


def _materials(scan: Scan) -> dict[str, list[float]] | None:
    """Least and most of each property; None where everything is the station's."""
    if scan.face_materials is None:
        return None
    stated = {name: column[~np.isnan(column)] for name, column in zip(COLUMNS, scan.face_materials.T, strict=True)}
    return {name: [float(x.min()), float(x.max())] for name, x in stated.items() if len(x)}


def _about(motion: Motion) -> dict[str, Any]:
    return {**motion.provenance, "name": motion.name, "digest": motion.digest, "ticks": len(motion.time_s)}


def _key(name: str) -> str:
    """`finest only` -> `finest_only`, `the paper's` -> `paper`."""
    return name.removeprefix("the ").removesuffix("'s").replace(" ", "_")


def _numbers(metrics: Mapping[str, float]) -> dict[str, float | None]:
    return {name: float(value) if math.isfinite(value) else None for name, value in metrics.items()}
