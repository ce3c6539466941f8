"""The page about one bundle: what was chosen, why, what it costs and feels like, where its levels are used."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hapticlod import _runtime
from hapticlod.bundle.read import Bundle, BundleLevel
from hapticlod.closest import SurfaceIndex
from hapticlod.config import MAPPINGS, POLICIES
from hapticlod.errors import InputError
from hapticlod.layout import RECORD_DTYPE
from hapticlod.replay import Record
from hapticlod.scan import Scan
from hapticlod.trust import judge_trust, read_trusted_keys, standard_trust_files
from tuning.load import load_in_words
from tuning.report import plots
from tuning.report.page import figures, folded, page, section, table, words
from tuning.report.view3d import MOST_TRIANGLES, Colouring, view_html
from tuning.tables import COLUMNS

Json = Mapping[str, Any]
_NEAR_OF_EXTENT = 0.01  # a vertex counts as touched within this share of the extent


def bundle_report(
    held: Bundle, front: Json | None = None, quality: Json | None = None, scan: Scan | None = None
) -> str:
    """HTML of the page.

    Args:
        held: the bundle.
        front: what `hapticlod pareto` wrote for the same scan; quality: what `make evaluate-surrogate` wrote.
        scan: that the bundle was made of, for the 3-D view; without it the finest level is shown.

    Raises:
        InputError: the bundle was made of another scan.
    """
    manifest = held.manifest
    about: Json = manifest["scan"] if isinstance(manifest.get("scan"), dict) else {}
    if scan is not None and about.get("digest") not in (None, scan.digest):
        raise InputError(scan.source, f"is not the scan that {held.path.name} was made of", "give that one, or none")
    name = str(about.get("name") or held.path.stem)
    record = None if held.golden_record is None else _record(held, held.golden_record)
    parts = [section("Summary", *_summary(held, record)), section("Configuration", _configuration(held), _levels(held))]
    title = "Predicted and measured" if manifest.get("predicted") else "Measured"
    parts.append(section(title, _measured(manifest), *_predicted(manifest)))
    if record is not None:
        parts.append(section("The golden motion", _golden_words(held, record), _golden(held, record)))
    else:
        parts.append(section("The golden motion", words("The bundle holds no recorded motion.")))
    parts.append(section("What a budget buys", _front(front, manifest)))
    parts.append(section("How far the model can be trusted", _quality(quality)))
    parts.append(section("The scan in 3-D", *_view(held, record, scan)))
    parts.append(section("Provenance", *_provenance(held)))
    return page(f"{name} with {held.tool.name}: levels of detail", parts)


def _summary(held: Bundle, record: Record | None) -> list[str]:
    manifest, config = held.manifest, held.config
    told = [words(str(manifest["explanation"]))] if manifest.get("explanation") else []
    sizes = ", ".join(f"{level.triangles:,}".replace(",", "\u00a0") for level in held.levels)
    many = len(held.levels) > 1
    told.append(
        words(
            f"The bundle holds {len(held.levels)} level{'s' if many else ''} of {sizes} triangles for "
            f"{held.tool.name} ({held.tool.balls} ball{'s' if held.tool.balls > 1 else ''}), made for a loop of "
            f"{config['loop_hz']:g} Hz with a budget of {config['budget_us']:g} µs per tick."
        )
    )
    measured = manifest.get("measured")
    if isinstance(measured, dict):
        known = [c for c in COLUMNS if isinstance(measured.get(c.key), int | float)]
        pairs = [(*c.name.rsplit(" ", 1), c.text(measured)) for c in known]
        said = ", ".join(f"{name} {value} {unit.replace('1/s', 'per s')}" for name, unit, value in pairs)
        told.append(words(f"Measured on motions kept apart: {said}."))
    if record is not None and many:
        shares = [100.0 * float((record.level == k).mean()) for k in range(len(held.levels))]
        used = ", ".join(f"level {k} {share:.0f} %" for k, share in enumerate(shares))
        told.append(
            words(f"On the golden motion of {len(record) / record.loop_hz:.1f} s the levels were in use for: {used}.")
        )
    return told


def _configuration(held: Bundle) -> str:
    c = held.config
    count = len(held.levels)
    unit = "mm/s" if POLICIES[c["policy"]] == "velocity" else "mm"
    thresholds = ", ".join(f"{v:.1f}" for v in c["speeds_mm_s"][: count - 1])
    switching = [
        ("levels change by", f"{POLICIES[c['policy']]}, at {thresholds} {unit}"),
        ("hysteresis", f"{100 * c['hysteresis']:.3g} %"),
        ("speed filter", f"{c['filter_hz']:.3g} Hz" if c["filter_hz"] > 0 else "none"),
        ("least time on a level", f"{1e3 * c['dwell_s']:.3g} ms"),
        ("mapping", f"{MAPPINGS[c['mapping']]}, {c['l_in_mm']:.3g} mm in, {c['l_out_mm']:.3g} mm out"),
        ("blend", f"{1e3 * c['blend_s']:.3g} ms"),
    ]
    rows = [
        *(switching if count > 1 else [("levels", "one: nothing switches")]),
        ("force shading", "yes" if c["shading"] else "no"),
        ("loop", f"{c['loop_hz']:g} Hz, budget {c['budget_us']:g} µs"),
        ("stiffness, force limit", f"{c['stiffness_n_mm']:.3g} N/mm, {c['max_force_n']:.3g} N"),
    ]
    return table(("setting", "value"), rows, "How the loop runs", texts=2)


def _levels(held: Bundle) -> str:
    rows = [
        (k, level.triangles, f"{level.cell_mm:.3f}", int(held.config["balls"][k]), f"{level.bytes / 1e6:.1f}")
        for k, level in enumerate(held.levels)
    ]
    return table(("level", "triangles", "cell mm", "balls", "MB"), rows, "Levels, finest first", texts=0)


def _measured(manifest: Json) -> str:
    named = {"tuned": manifest.get("measured")}
    if isinstance(manifest.get("baselines"), dict):
        named |= {key.replace("_", " "): value for key, value in manifest["baselines"].items()}
    rows = []
    for name, found in named.items():
        if isinstance(found, dict):
            known = [c.text(found) if isinstance(found.get(c.key), int | float) else "-" for c in COLUMNS]
            holds = manifest.get("feasible") if name == "tuned" else found.get("feasible")
            rows.append((name, *known, "-" if holds is None else "yes" if holds else "no"))
    if not rows:
        return words("The bundle says nothing that was measured.")
    headings = ("", *(c.name for c in COLUMNS), "holds budget and memory")
    return table(headings, rows, "Measured in the runtime on motions that the model had not seen")


def _predicted(manifest: Json) -> list[str]:
    predicted, measured = manifest.get("predicted"), manifest.get("measured")
    if not (isinstance(predicted, dict) and predicted and isinstance(measured, dict)):
        return []  # nothing is predicted of the full scan
    figure = plots.predicted_and_measured(_numbers(predicted), _numbers(measured))
    return [figures((figure, "What the model predicted over what the runtime measured, metric by metric."))]


def _numbers(values: Json) -> dict[str, float]:
    return {key: float(value) for key, value in values.items() if isinstance(value, int | float)}


def _record(held: Bundle, rows: NDArray[Any]) -> Record:
    c = held.config
    station = held.manifest.get("station")
    slowdown = station.get("slowdown") if isinstance(station, dict) else None
    return Record(
        rows=rows, loop_hz=float(c["loop_hz"]), budget_us=float(c["budget_us"]),
        stiffness_n_mm=float(c["stiffness_n_mm"]), level_triangles=tuple(level.triangles for level in held.levels),
        level_bytes=tuple(level.bytes for level in held.levels), blend_s=float(c["blend_s"]),
        slowdown=float(slowdown) if isinstance(slowdown, int | float) else 1.0,
    )  # fmt: skip


def _finest(held: Bundle) -> Record:
    """The golden motion on the bundle's finest level alone, replayed now: the reference of the figures."""
    motion, level = held.golden_motion, held.levels[0]
    assert motion is not None
    data = np.array([held.config])  # a copy: the file is mapped for reading
    data["level_count"], data["work_limit"] = 1, 0.0
    materials = None
    if level.materials is not None:
        materials = np.column_stack([level.materials[name] for name in level.materials.dtype.names or ()])
    built = _runtime.Level(
        np.ascontiguousarray(level.vertices), np.ascontiguousarray(level.faces), level.cell_mm, materials
    )
    renderer = _runtime.Renderer([built], data.tobytes(), held.tool.rows)
    orientation = None if motion.orientation is None else np.ascontiguousarray(motion.orientation)
    time_s, position = np.ascontiguousarray(motion.time_s), np.ascontiguousarray(motion.position_mm)
    rows = np.frombuffer(renderer.replay(time_s, position, orientation, 1), dtype=RECORD_DTYPE)
    return _record(held, rows)


def _golden_words(held: Bundle, record: Record) -> str:
    about = held.manifest.get("golden_motion")
    name = about.get("name") if isinstance(about, dict) else None
    return words(
        f"{name or 'The motion'} of {len(record) / record.loop_hz:.1f} s ({len(record)} ticks) is in the bundle. "
        "Its costs were timed once, on the machine that wrote the bundle; grey is the finest level, replayed just now.",
        quiet=True,
    )  # fmt: skip


def _golden(held: Bundle, record: Record) -> str:
    reference = _finest(held)
    count = len(held.levels)
    by_speed = POLICIES[held.config["policy"]] == "velocity"
    thresholds = held.config["speeds_mm_s"][: count - 1] if by_speed else []
    costs = {"all": record.cost_us}
    drawn = []
    if count > 1:
        costs |= {f"level {k}": record.cost_us[record.level == k] for k in range(count)}
        text = "What each change of level in contact did to the force, beyond what the finest level did then."
        drawn.append((plots.jumps_at_switches(record, reference), text))
    return figures(
        (
            plots.force_and_speed(record, reference, thresholds_mm_s=list(thresholds)),
            "Rendered force beside the finest level's, the hand's speed with the thresholds, and the level in use.",
        ),
        (
            plots.cost_distribution(costs, record.budget_us),
            "How large a share of ticks takes longer than the time below; the upright line is the budget.",
        ),
        *drawn,
    )


def _front(front: Json | None, manifest: Json) -> str:
    if front is None:
        return words("Not looked at: give what `hapticlod pareto` wrote with --front.", quiet=True)
    measured = manifest.get("measured")
    station = manifest.get("station")
    chosen = None
    if isinstance(measured, dict) and isinstance(station, dict) and measured.get("felt_error_jnd") is not None:
        chosen = (float(station["budget_us"]), float(measured["felt_error_jnd"]))
    return figures((plots.pareto_front(front["points"], chosen=chosen), "The best felt error at each budget."))


def _quality(quality: Json | None) -> str:
    if quality is None:
        return words("Not looked at: give what `make evaluate-surrogate JSON=...` wrote with --quality.", quiet=True)
    text = "How well predictions rank random configurations, and how well two measurements of them rank each other."
    return figures((plots.surrogate_quality(quality["metrics"]), text))


def _view(held: Bundle, record: Record | None, scan: Scan | None) -> list[str]:
    meshes = {
        f"Level {k}, as it is in the bundle": (np.asarray(level.vertices, dtype=np.float64), np.asarray(level.faces))
        for k, level in enumerate(held.levels)
    }
    if scan is not None:
        meshes = {"The scan": (scan.vertices - held.config["origin_mm"], scan.faces), **meshes}
    fitting = [name for name, (_, faces) in meshes.items() if len(faces) <= MOST_TRIANGLES] or [list(meshes)[-1]]
    vertices, faces = meshes[fitting[0]]
    told = f"{fitting[0]}: {len(faces)} triangles."
    if fitting[0] != next(iter(meshes)):
        told += f" What has more than {MOST_TRIANGLES} triangles is left out of this page."
    colourings = [] if record is None else [_usage(held, record, vertices)]
    for k, level in enumerate(held.levels):
        if not fitting[0].startswith(f"Level {k},"):  # a level lies on itself
            colourings.append(_distance(k, level, vertices))
    if not colourings:
        colourings.append(Colouring("nothing", np.zeros(len(vertices)), 1.0, ""))
    title = f"{fitting[0]}, {len(faces)} triangles, coloured by the chosen quantity"
    return [words(told, quiet=True), view_html(vertices, faces, colourings, title)]


def _usage(held: Bundle, record: Record, vertices: NDArray[np.float64]) -> Colouring:
    """Every vertex by the level of the touch nearest to it."""
    touched = record.contact
    reach = _NEAR_OF_EXTENT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    level = np.zeros(len(vertices), dtype=np.uint8)
    if touched.any():
        scp = record.scp[touched] - held.config["origin_mm"]
        found: Any = KDTree(scp).query(vertices, distance_upper_bound=reach + held.tool.reference_radius_mm)
        distance, nearest = found
        near = np.isfinite(distance)
        level[near] = 1 + record.level[touched][nearest[near]]
    names = ("not touched", *(f"level {k}" for k in range(len(held.levels))))
    return Colouring("where each level was used (golden motion)", level, names=names)


def _distance(number: int, level: BundleLevel, vertices: NDArray[np.float64]) -> Colouring:
    index = SurfaceIndex(np.asarray(level.vertices, dtype=np.float64), np.asarray(level.faces, dtype=np.int64))
    far = index.nearest(vertices).distance_mm
    most = max(float(np.quantile(far, 0.995)), 1e-6)  # a few far vertices would leave no colours for the rest
    return Colouring(f"distance to level {number} ({level.triangles} triangles)", far, most, "mm or more")


def _provenance(held: Bundle) -> list[str]:
    manifest = held.manifest
    rows = [("bundle", f"{held.path.name}, {held.file_bytes / 1e6:.1f} MB, all digests match")]
    trusted = [key for path in standard_trust_files() for key in read_trusted_keys(path)]
    rows.append(("signature", judge_trust(held.signer, trusted)[1]))
    for key in ("hapticlod", "seed"):
        if key in manifest:
            rows.append((key, str(manifest[key])))
    for key in ("scan", "tool", "station", "golden_motion"):
        if isinstance(manifest.get(key), dict):
            rows.append((key.replace("_", " "), _flat(manifest[key])))
    rows += _timing(manifest)
    apart = manifest.get("motions")
    motions = [(m.get("name", ""), _flat(m)) for m in apart if isinstance(m, dict)] if isinstance(apart, list) else []
    digests = [(section.name, section.length, section.digest.hex()) for section in held.sections]
    return [
        table(("what", "from"), rows, "What the bundle was made of", texts=2),
        folded("Motions kept apart", table(("motion", "made of"), motions, "As the bundle says", texts=2)),
        folded("Digests of every section", table(("section", "bytes", "BLAKE2b-256"), digests, "As stored")),
    ]


def _timing(manifest: Json) -> list[tuple[str, str]]:
    """On what machine ticks were timed, and how busy it was."""
    machine, clock, golden = (manifest.get(key) for key in ("machine", "clock", "golden_load"))
    rows = [("timed on", _flat(machine))] if isinstance(machine, dict) else []
    if isinstance(clock, dict):
        runs = clock.get("runs")
        load = {key.removeprefix("load_"): value for key, value in clock.items() if key.startswith("load_")}
        often = f", mean of {runs:g} run{'s' if runs > 1 else ''}" if isinstance(runs, int | float) else ""
        rows.append((f"load while it was verified{often}", load_in_words(load)))
    if isinstance(golden, dict):
        rows.append(("load while the golden motion was timed", load_in_words(golden)))
    return rows


def _flat(value: Json) -> str:
    def text(key: str, held: Any) -> str:
        return Path(held).name if key == "source" else f"{held:.6g}" if isinstance(held, float) else str(held)

    return ", ".join(f"{key} {text(key, held)}" for key, held in value.items() if held not in (None, "", {}))
