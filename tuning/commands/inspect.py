"""`hapticlod inspect`: checks a bundle and says what it holds."""

from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from hapticlod.config import MAPPINGS
from tuning.load import load_in_words
from tuning.tables import COLUMNS


def inspect_command(bundle: Path, /) -> None:
    """Check a bundle and show what it holds.

    Parameters
    ----------
    bundle
        The bundle to read (.hlod).
    """
    from hapticlod.bundle import read_bundle
    from hapticlod.trust import judge_trust, read_trusted_keys, standard_trust_files

    held = read_bundle(bundle)
    out = Console(highlight=False, soft_wrap=True)
    config = held.config

    def line(name: str, text: str) -> None:
        out.print(f"{name:<11}{text}", markup=False)

    line("bundle", f"{held.path}, {held.file_bytes / 1e6:.1f} MB, {len(held.sections)} sections, all digests match")
    trusted = [key for path in standard_trust_files() for key in read_trusted_keys(path)]
    line("signature", judge_trust(held.signer, trusted)[1])
    scan = held.manifest.get("scan")
    if isinstance(scan, dict):
        line("scan", f"{scan.get('name')}, {scan.get('triangles')} triangles, from {scan.get('source')}")
    made_of = scan.get("materials") if isinstance(scan, dict) else None
    if isinstance(made_of, dict):
        line("materials", ", ".join(f"{name} {least:g} to {most:g}" for name, (least, most) in made_of.items()))
    line("tool", f"{held.tool.name}, {held.tool.balls} ball{'s' if held.tool.balls > 1 else ''}")
    line(
        "loop",
        f"{config['loop_hz']:g} Hz, budget {config['budget_us']:g} us, stiffness {config['stiffness_n_mm']:g} N/mm, "
        f"at most {config['max_force_n']:g} N",
    )
    line(
        "switching",
        f"filter {config['filter_hz']:.3g} Hz, hysteresis {config['hysteresis']:.3g}, "
        f"mapping {MAPPINGS[config['mapping']]} ({config['l_in_mm']:.3g} mm in, {config['l_out_mm']:.3g} mm out), "
        f"blend {config['blend_s'] * 1e3:.3g} ms",
    )
    if held.golden_motion is not None:
        golden = held.golden_motion
        record = "with its record" if held.golden_record is not None else "no record"
        line("golden", f"{golden.name}, {len(golden.time_s)} ticks, {record}")
    for part in held.parts:
        counts = ", ".join(f"{triangles}" for triangles in part.triangles)
        line("part", f"{part.name}{' (hidden at first)' if part.hidden else ''}: {counts} triangles")
    out.print(_levels(held))
    measured = held.manifest.get("measured")
    if isinstance(measured, dict):
        known = [c for c in COLUMNS if isinstance(measured.get(c.key), int | float)]
        said = ", ".join(f"{c.name} {c.text(measured)}" for c in known)
        line("measured", said)
    clock = held.manifest.get("clock")
    if isinstance(clock, dict) and isinstance(clock.get("load_others_cores"), int | float):
        load = {key.removeprefix("load_"): value for key, value in clock.items() if key.startswith("load_")}
        line("load", f"{load_in_words(load)} (while it was verified)")
    if isinstance(held.manifest.get("explanation"), str):
        Console(highlight=False).print(held.manifest["explanation"], markup=False)


def _levels(held: Any) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("level", "triangles", "cell mm", "balls", "MB", "up to mm/s"):
        table.add_column(heading, justify="right")
    count = int(held.config["level_count"])
    speeds = [f"{speed:.1f}" for speed in held.config["speeds_mm_s"][: count - 1]]
    if held.parts:  # what the scene shows of all parts at each of its levels
        for number, speed in enumerate([*speeds, "any"]):
            shown = [held.levels[p.first_level + min(number, p.level_count - 1)] for p in held.parts]
            triangles, size = sum(level.triangles for level in shown), sum(level.bytes for level in shown)
            balls = int(held.config["balls"][number])
            table.add_row(f"{number}", f"{triangles}", "", f"{balls}", f"{size / 1e6:.1f}", speed)
        return table
    for number, (level, speed) in enumerate(zip(held.levels, [*speeds, "any"], strict=True)):
        balls = int(held.config["balls"][number])
        table.add_row(
            f"{number}", f"{level.triangles}", f"{level.cell_mm:.3f}", f"{balls}", f"{level.bytes / 1e6:.1f}", speed
        )
    return table
