"""The bundle: what is written is read back by Python and by C++, and what is wrong is refused by both alike."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plate_bundle import TEST_KEY, plate_parts, rendered, run_station

from hapticlod.bundle import read_bundle, write_bundle
from hapticlod.bundle.content import brick_hash
from hapticlod.bundle.format import ENTRY_DTYPE, HEADER_DTYPE, LEVEL_SECTIONS, MAGIC, SectionType, digest
from hapticlod.bundle.structure import read_sections
from hapticlod.bundle.write import container
from hapticlod.errors import InputError

Sections = list[tuple[int, int, bytes]]


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    return {**plate_parts(ticks=800), "key": None}  # signatures: test_signature.py


@pytest.fixture
def bundle_path(parts: dict[str, Any], tmp_path: Path) -> Path:
    path = tmp_path / "plate.hlod"
    write_bundle(path, **parts)
    return path


def sections_of(path: Path) -> Sections:
    file = path.read_bytes()
    return [(s.type, s.level, file[s.offset : s.offset + s.length]) for s in read_bundle(path).sections]


def changed(sections: Sections, kind: int, level: int, change: Callable[[bytearray], None]) -> Sections:
    """A copy in which one section is spoiled; sealing it again gives digests that match."""
    out = []
    for number, at, data in sections:
        content = bytearray(data)
        if (number, at) == (kind, level):
            change(content)
        out.append((number, at, bytes(content)))
    return out


def resealed(file: bytes, change: Callable[[np.ndarray], None]) -> bytes:
    """The file with its table changed and the table's digest made right again."""
    spoiled = bytearray(file)
    header = np.frombuffer(spoiled, dtype=HEADER_DTYPE, count=1)
    table = np.frombuffer(spoiled, dtype=ENTRY_DTYPE, count=int(header["section_count"][0]), offset=64)
    change(table)
    header["table_digest"] = np.void(digest(table.tobytes()))
    return bytes(spoiled)


def refusal(path: Path, file: bytes | bytearray) -> str:
    path.write_bytes(file)
    with pytest.raises(InputError) as caught:
        read_bundle(path)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


def test_layout_sizes_are_the_formats() -> None:
    assert (HEADER_DTYPE.itemsize, ENTRY_DTYPE.itemsize, len(MAGIC)) == (64, 64, 8)
    assert HEADER_DTYPE.fields is not None and HEADER_DTYPE.fields["table_digest"][1] == 32
    assert ENTRY_DTYPE.fields is not None and ENTRY_DTYPE.fields["digest"][1] == 32


def test_python_reads_what_python_wrote(parts: dict[str, Any], bundle_path: Path) -> None:
    bundle = read_bundle(bundle_path)
    assert bundle.manifest == parts["manifest"]
    assert bundle.config.tobytes() == parts["config"].tobytes()
    assert bundle.tool.digest == parts["tool"].digest
    assert bundle.tool.name == "three balls"
    assert bundle.golden_motion is not None and bundle.golden_record is not None
    assert bundle.golden_motion.digest == parts["golden_motion"].digest
    assert bundle.golden_motion.name == "slide"
    assert bundle.golden_record.tobytes() == parts["golden_record"].tobytes()
    for level, original in zip(bundle.levels, parts["levels"], strict=True):
        arrays = original.arrays()
        assert level.triangles == original.triangles
        assert level.bytes == original.bytes
        assert level.vertices.tobytes() == arrays["vertices"]
        assert level.faces.tobytes() == arrays["faces"]
        assert level.acceleration is not None
        for name, array in level.acceleration.items():
            assert array.tobytes() == arrays[name], name
        assert not level.vertices.flags.owndata and not level.vertices.flags.writeable  # a view into the file


def test_equal_parts_give_equal_bytes(parts: dict[str, Any], bundle_path: Path, tmp_path: Path) -> None:
    write_bundle(tmp_path / "again.hlod", **parts)
    assert (tmp_path / "again.hlod").read_bytes() == bundle_path.read_bytes()


def test_sections_are_aligned_and_the_rest_is_zero(bundle_path: Path) -> None:
    file, covered = bundle_path.read_bytes(), np.zeros(bundle_path.stat().st_size, dtype=bool)
    sections = read_bundle(bundle_path).sections
    covered[: 64 + 64 * len(sections)] = True
    for section in sections:
        assert section.offset % 64 == 0
        covered[section.offset : section.offset + section.length] = True
    assert not np.frombuffer(file, dtype=np.uint8)[~covered].any()


def test_station_reads_what_python_wrote(parts: dict[str, Any], bundle_path: Path) -> None:
    result = run_station("inspect", bundle_path, "--json")
    assert result.returncode == 0, result.stderr
    said = json.loads(result.stdout)
    bundle = read_bundle(bundle_path)
    assert said["manifest"] == parts["manifest"]
    assert [level["triangles"] for level in said["levels"]] == [72, 18]
    assert [level["bytes"] for level in said["levels"]] == [level.bytes for level in bundle.levels]
    assert [level["balls"] for level in said["levels"]] == [3, 1]
    assert not any(level["rebuilt"] for level in said["levels"])
    assert said["golden_ticks"] == 800
    assert said["config"]["speeds_mm_s"] == [20.0]
    assert said["config"]["stiffness_n_mm"] == 1.0
    ours = [(s.type, s.level, s.offset, s.length, s.digest.hex()) for s in bundle.sections]
    theirs = [(s["type"], s["level"], s["offset"], s["length"], s["blake2b_256"]) for s in said["sections"]]
    assert ours == theirs
    text = run_station("inspect", bundle_path)
    assert text.returncode == 0
    assert "level 1: 18 triangles" in text.stdout


def test_a_level_read_back_renders_the_same(parts: dict[str, Any], bundle_path: Path) -> None:
    from hapticlod import _runtime

    bundle = read_bundle(bundle_path)
    levels = [_runtime.Level(level.vertices, level.faces, level.cell_mm) for level in bundle.levels]
    assert bundle.golden_motion is not None
    rows = rendered(levels, bundle.config, bundle.tool, bundle.golden_motion)
    for field in ("force_n", "scp_mm", "level", "tests"):
        assert (rows[field] == parts["golden_record"][field]).all(), field
    assert rows["contact"].sum() > 100
    assert len(set(rows["level"])) == 2


def test_every_cut_is_refused(bundle_path: Path) -> None:
    file = bundle_path.read_bytes()
    for length in [*range(1, 200), *range(200, len(file), 211)]:
        with pytest.raises(InputError):  # what every way of reading does first; thousands of cuts need no disk
            read_sections(np.frombuffer(file, dtype=np.uint8)[:length], "memory")
    assert "is empty" in refusal(bundle_path, b"")
    assert "cut short" in refusal(bundle_path, file[:63])
    assert "header promises" in refusal(bundle_path, file[:-1])
    assert run_station("inspect", bundle_path).returncode == 2


def test_every_flipped_byte_of_header_table_and_indices_is_refused(parts: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "small.hlod"
    write_bundle(path, **{**parts, "golden_motion": None, "golden_record": None})
    file = np.fromfile(path, dtype=np.uint8)
    sections = read_sections(file, "memory")
    places = list(range(64 + 64 * len(sections)))
    for section in sections:
        if section.type in LEVEL_SECTIONS and section.level == 1:
            step = 17 if section.type == SectionType.BLOCKS else 1
            places += range(section.offset, section.offset + section.length, step)
    for place in places:
        file[place] ^= 0x10
        with pytest.raises(InputError):
            read_sections(file, "memory")
        file[place] ^= 0x10
    assert len(read_sections(file, "memory")) == len(sections)


def test_wrong_magic_and_future_version_are_named(bundle_path: Path) -> None:
    file = bundle_path.read_bytes()
    assert "not a HapticLOD bundle" in refusal(bundle_path, b"PK\x03\x04" + file[4:])
    future = bytearray(file)
    future[8] = 9
    assert "bundle format 9, this program reads format 1" in refusal(bundle_path, future)
    result = run_station("inspect", bundle_path)
    assert result.returncode == 2
    assert "bundle format 9, this program reads format 1" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_lengths_are_not_trusted(bundle_path: Path) -> None:
    file = bundle_path.read_bytes()

    def four_gigabytes(table: np.ndarray) -> None:
        table["length"][4] = 4 << 30

    def wrap_around(table: np.ndarray) -> None:
        table["length"][4] = (1 << 64) - 1

    def overlap(table: np.ndarray) -> None:
        table["offset"][4] -= 64

    def twice(table: np.ndarray) -> None:
        table["type"][2] = SectionType.CONFIG

    for change, reason in (
        (four_gigabytes, "reaches beyond the file"),
        (wrap_around, "reaches beyond the file"),
        (overlap, "does not start where"),
        (twice, "appears twice"),
    ):
        assert reason in refusal(bundle_path, resealed(file, change))
        result = run_station("inspect", bundle_path)
        assert result.returncode == 2
        assert reason in result.stderr


def test_unknown_sections_and_versions(bundle_path: Path) -> None:
    sections = sections_of(bundle_path)
    bundle_path.write_bytes(container([*sections, (77, 0, b"of the future")]))
    bundle = read_bundle(bundle_path)
    assert (bundle.sections[-1].type, bundle.sections[-1].known) == (77, False)
    assert run_station("inspect", bundle_path).returncode == 0

    bundle_path.write_bytes(container(sections, section_version={(SectionType.BRICKS, 0): 2}))
    assert read_bundle(bundle_path).levels[0].acceleration is None
    assert read_bundle(bundle_path).levels[1].acceleration is not None
    said = json.loads(run_station("inspect", bundle_path, "--json").stdout)
    assert [level["rebuilt"] for level in said["levels"]] == [True, False]

    newer = container(sections, section_version={(SectionType.CONFIG, 0): 2})
    assert "CONFIG: is needed and has version 2" in refusal(bundle_path, newer)
    assert "CONFIG: is needed and has version 2" in run_station("inspect", bundle_path).stderr

    def required(table: np.ndarray) -> None:
        table["flags"][-1] = 0

    unknown = resealed(bytes(container([*sections, (77, 0, b"x")])), required)
    assert "section type 77: is needed" in refusal(bundle_path, unknown)


def test_both_readers_judge_sealed_wrong_content_alike(parts: dict[str, Any], bundle_path: Path) -> None:
    """Digests are right, one byte of the content is not: nobody's accident, but somebody's attempt."""
    write_bundle(bundle_path, **{**parts, "golden_motion": None, "golden_record": None})
    sections = sections_of(bundle_path)
    rng = np.random.default_rng(3)
    flips = [
        (kind, level, int(rng.integers(len(data))), int(rng.integers(1, 256))) for kind, level, data in sections * 3
    ]
    # Every word of the two records that steer everything: its sign, exponent or top bits.
    for kind, length in ((SectionType.CONFIG, 440), (SectionType.HASH, 104)):
        flips += [(kind, 0, place, 0xFF) for place in range(3, length, 4)]
    verdicts = []
    for kind, level, place, bits in flips:

        def flip(content: bytearray, place: int = place, bits: int = bits) -> None:
            content[place] ^= bits

        bundle_path.write_bytes(container(changed(sections, kind, level, flip)))
        try:
            read_bundle(bundle_path)
            taken = True
        except InputError:
            taken = False
        result = run_station("inspect", bundle_path)
        assert result.returncode == (0 if taken else 2), (SectionType(kind).name, place, bits, result.stderr)
        verdicts.append(taken)
    assert 10 < sum(verdicts) < len(verdicts) - 10


@pytest.mark.parametrize("field", ["max_force_n", "engage_s"])
def test_numbers_that_the_tick_would_take_for_0_are_refused(
    parts: dict[str, Any], bundle_path: Path, field: str
) -> None:
    """A force limit of 1e-310 N was none: found by make fuzz."""
    config = parts["config"].copy()
    config[field] = 1e-310
    write_bundle(bundle_path, **{**parts, "config": config})
    with pytest.raises(InputError, match=f"{field} is so small"):
        read_bundle(bundle_path)
    assert f"{field} is so small" in run_station("inspect", bundle_path).stderr


def test_a_bundle_without_a_force_limit_is_refused(parts: dict[str, Any], bundle_path: Path) -> None:
    """For the core 0 is no limit, and what the C ABI and a device may only lower would have stayed none."""
    config = parts["config"].copy()
    config["max_force_n"] = 0.0
    write_bundle(bundle_path, **{**parts, "config": config})
    with pytest.raises(InputError, match="max_force_n = 0 would be no limit"):
        read_bundle(bundle_path)
    assert "max_force_n = 0 would be no limit" in run_station("inspect", bundle_path).stderr


@pytest.mark.parametrize("field", ["centres_mm", "radii_mm"])
def test_a_ball_beyond_any_tool_is_refused(parts: dict[str, Any], bundle_path: Path, field: str) -> None:
    """Differences of such places are infinite, and the tree of balls is ordered by them."""
    far = getattr(parts["tool"], field).copy()
    far[0] = 1e308
    write_bundle(bundle_path, **{**parts, "tool": replace(parts["tool"], **{field: far})})
    with pytest.raises(InputError, match="ball 0 reaches beyond"):
        read_bundle(bundle_path)
    assert "ball 0 reaches beyond" in run_station("inspect", bundle_path).stderr


def test_brick_hash_is_the_runtimes(parts: dict[str, Any]) -> None:
    arrays = parts["levels"][0].arrays()
    bricks = np.frombuffer(arrays["bricks"], dtype=[("at", "<i4", 3), ("first", "<u4"), ("mask", "<u8")])
    table = np.frombuffer(arrays["table"], dtype="<u4")
    assert (bricks["at"] < 0).any()  # negative coordinates wrap as in C++
    home = brick_hash(*bricks["at"].T) & np.uint32(len(table) - 1)
    at_home = table[home] == np.arange(1, len(bricks) + 1)
    assert at_home.mean() > 0.5


def test_parts_that_do_not_fit_are_not_written(parts: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "wrong.hlod"
    swapped = {**parts, "levels": parts["levels"][::-1]}
    with pytest.raises(ValueError, match="level 0 has 18 triangles, its config says 72"):
        write_bundle(path, **swapped)
    with pytest.raises(ValueError, match="golden motion and its record"):
        write_bundle(path, **{**parts, "golden_record": None})
    with pytest.raises(ValueError, match="does not fit 800 ticks"):
        write_bundle(path, **{**parts, "golden_record": parts["golden_record"][:-1]})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_bundle(path, **{**parts, "manifest": {"felt_error_jnd": float("nan")}})
    with pytest.raises(TypeError, match="object"):
        write_bundle(path, **{**parts, "manifest": {"what": object()}})
    nested: list[Any] = []
    for _ in range(64):
        nested = [nested]
    with pytest.raises(ValueError, match="nested deeper"):
        write_bundle(path, **{**parts, "manifest": {"nested": nested}})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="cannot be written"):
        write_bundle(tmp_path / "no" / "folder.hlod", **parts)


def test_manifest_takes_numpy_and_paths(parts: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "plate.hlod"
    manifest = {"rms_mm": np.float64(0.5), "counts": np.arange(3), "source": Path("a/b.stl"), "felt": np.float32(1.5)}
    write_bundle(path, **{**parts, "manifest": manifest})
    assert read_bundle(path).manifest == {"rms_mm": 0.5, "counts": [0, 1, 2], "source": "a/b.stl", "felt": 1.5}


def test_manifest_depth_is_judged_alike(bundle_path: Path) -> None:
    for inner, fine in ((63, True), (64, False)):
        text = b'{"a":' + b"[" * inner + b"]" * inner + b"}"
        sections = [(k, at, text if k == SectionType.MANIFEST else data) for k, at, data in sections_of(bundle_path)]
        file = container(sections)
        if fine:
            bundle_path.write_bytes(file)
            read_bundle(bundle_path)
            assert run_station("inspect", bundle_path).returncode == 0
        else:
            assert "JSON object" in refusal(bundle_path, file)
            assert "JSON object" in run_station("inspect", bundle_path).stderr


def test_a_bundle_may_go_without_golden_sections(parts: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "bare.hlod"
    write_bundle(path, **{**parts, "golden_motion": None, "golden_record": None, "key": TEST_KEY})
    bundle = read_bundle(path)
    assert bundle.golden_motion is None and bundle.golden_record is None
    result = run_station("run", path, "--device", "sim", "--seconds", "0.1")
    assert result.returncode == 2
    assert "holds no golden motion; give a motion with --motion" in result.stderr


@pytest.mark.parametrize("name", ["missing.hlod", "."])
def test_missing_files_and_folders_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        read_bundle(tmp_path / name)
    assert str(tmp_path) in str(caught.value)
