"""The page: self-contained, complete, safe with any name; its mesh read back by an independent reader."""

import base64
import contextlib
import errno
import json
import os
import re
import sqlite3
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from compare_cases import cells, write_globe
from contact_shapes import sphere

import tuning.cli
from hapticlod.bundle import write_bundle
from hapticlod.closest import SurfaceIndex
from hapticlod.ladder import Ladder, build_ladder
from hapticlod.motion import synthesise
from hapticlod.replay import Record, replay_levels, runtime_levels
from hapticlod.scan import scan_from_arrays
from hapticlod.scheme import Scheme
from hapticlod.station import load_station
from hapticlod.tool import ball
from tuning.compare.batch import run_batch
from tuning.compare.ledger import Ledger
from tuning.compare.task import perform

pytest.importorskip("matplotlib", reason="hapticlod[report] is not installed")

STATION = Path(__file__).parents[1] / "configs" / "stations" / "desktop_1khz.toml"
NAME = 'jaw <script>alert(1)</script> & "co"'
LEVELS = [{"share": 1.0}, {"share": 0.2}, {"share": 0.02}]


class Page(HTMLParser):
    """What a reader of the page needs to know: tags with their attributes, and texts of scripts by id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.scripts: dict[str, str] = {}
        self.words = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list) -> None:
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data: str) -> None:
        tag, attributes = self.tags[-1] if self.tags else ("", {})
        if tag == "script" and self.cdata_elem == "script":
            name = attributes.get("id", "program")
            self.scripts[name] = self.scripts.get(name, "") + data
        else:
            self.words += data

    def every(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    vertices, faces = sphere(10.0, 4)
    return build_ladder(scan_from_arrays(vertices.astype(np.float64), faces, "globe"), rungs=5, coarsest_ratio=60.0)


@pytest.fixture(scope="module")
def record(ladder: Ladder, folder: Path) -> Record:
    """Of the golden motion of the bundle that is written beside it."""
    tool, station = ball(0.5), load_station(STATION)
    asked = {"name": "s", "speeds_mm_s": (20.0, 50.0), "filter_hz": 20.0, "hysteresis": 0.1, "blend_ms": 10.0}
    config = Scheme.model_validate({**asked, "l_offsets": 4.0, "levels": LEVELS}).on(ladder, tool)
    levels, origin = runtime_levels(config, ladder), ladder.scan.centre_mm
    motion = synthesise(ladder.scan, "scan", seconds=2.0, loop_hz=1000.0, seed=1, tool=tool)
    made = replay_levels(levels, config, origin, motion, tool, station, 1)
    metrics = {"loop_cost_p999_us": 50.0, "felt_error_jnd": 0.5, "discontinuity_per_s": 0.1, "switches_per_s": 2.0,
               "memory_mb": 1.0}  # fmt: skip
    manifest = {
        "scan": {"name": NAME, "triangles": ladder.scan.triangles, "digest": ladder.scan.digest},
        "station": station.model_dump(mode="json"), "predicted": {**metrics, "felt_error_jnd": 0.6},
        "measured": metrics, "baselines": {"finest_only": {**metrics, "feasible": False}}, "feasible": True,
        "explanation": "Three levels.", "machine": {"processor": "abacus", "kernels": "beads"},
        "clock": {"runs": 2.0, "load_average_before": 3.25, "load_others_cores": 0.75, "load_stolen_cores": None},
        "golden_load": {"average_before": 1.5, "interruptions": 12.0},
    }  # fmt: skip
    write_bundle(
        folder / "globe.hlod", levels=levels, config=config.to_runtime(station, tool, origin), tool=tool,
        manifest=manifest, golden_motion=motion, golden_record=made.rows,
    )  # fmt: skip
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def page(folder: Path, record: Record) -> Page:
    front = {"points": [{"budget_us": b, "predicted": {"felt_error_jnd": 100.0 / b}} for b in (50.0, 100.0, 200.0)]}
    quality = {"metrics": {"felt_error_jnd": {"spearman": 0.98, "ceiling": 0.99}, "memory_mb": {"spearman": None}}}
    (folder / "front.json").write_text(json.dumps(front))
    (folder / "quality.json").write_text(json.dumps(quality))
    extras = ["--front", str(folder / "front.json"), "--quality", str(folder / "quality.json")]
    assert tuning.cli.run(["report", str(folder / "globe.hlod"), "-o", str(folder / "page.html"), *extras]) == 0
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    return Page(text)


def test_nothing_is_fetched(page: Page) -> None:
    sources = [value for _, attributes in page.tags for key, value in attributes.items() if key in ("src", "href")]
    assert sources and all(value.startswith("data:image/svg+xml;base64,") for value in sources)
    assert not page.every("link") and not page.every("iframe")
    (policy,) = [meta["content"] for meta in page.every("meta") if "http-equiv" in meta]
    assert policy.startswith("default-src 'none'")
    assert "http" not in page.scripts["program"] and "import" not in page.scripts["program"]


def test_every_part_is_there_and_every_figure_is_told_in_words(page: Page) -> None:
    for heading in ("Summary", "Configuration", "Predicted and measured", "The golden motion", "What a budget buys",
                    "How far the model can be trusted", "The scan in 3-D", "Provenance"):  # fmt: skip
        assert heading in page.words
    assert "Three levels." in page.words and "finest only" in page.words
    pictures = page.every("img")
    assert len(pictures) == 6
    for picture in pictures:
        drawn = base64.b64decode(picture["src"].split(",")[1]).decode()
        title = picture["alt"].split(". ")[0]
        assert title in drawn and len(picture["alt"]) > len(title) + 20
    assert all(canvas["aria-label"] for canvas in page.every("canvas"))


def test_the_load_while_it_was_timed_is_told(page: Page) -> None:
    assert "processor abacus, kernels beads" in page.words
    verified = "load while it was verified, mean of 2 runs"
    assert f"{verified}load average 3.25 before, 0.75 cores busy with other programs" in page.words.replace("\n", "")
    assert "load average 1.50 before, 12 interruptions" in page.words


def test_names_are_shown_and_not_run(page: Page) -> None:
    assert NAME in page.words
    assert not any("alert(1)" in text for text in page.scripts.values())


def unpacked(page: Page) -> tuple[dict, np.ndarray, np.ndarray, list[np.ndarray]]:
    """The mesh as the page's program must read it: what it is about, vertices in mm, corners, fields."""
    about = json.loads(page.scripts["mesh-about"])
    data = np.frombuffer(zlib.decompress(base64.b64decode(page.scripts["mesh-data"])), dtype=np.uint8).astype(np.int64)
    n, m = about["vertices"], 3 * about["triangles"]
    place = (data[: 3 * n] + 256 * data[3 * n : 6 * n]).reshape(3, n).T / 65535.0 * about["size_mm"]
    z = sum(data[6 * n + k * m : 6 * n + (k + 1) * m] << (8 * k) for k in range(4))
    corners = np.cumsum(np.where(z % 2 == 0, z // 2, -(z + 1) // 2))
    rest = data[6 * n + 4 * m :]
    assert len(rest) == n * len(about["fields"])
    return about, place, corners.reshape(-1, 3), list(rest.reshape(-1, n))


def test_the_mesh_reads_back(page: Page, ladder: Ladder, record: Record) -> None:
    about, vertices, faces, fields = unpacked(page)
    mesh = ladder.rungs[0]
    np.testing.assert_array_equal(faces, mesh.faces)
    np.testing.assert_allclose(vertices + mesh.vertices.min(axis=0), mesh.vertices, atol=20.0 / 65535)
    names = [field["title"] for field in about["fields"]]
    assert names[0].startswith("where each level was used") and len(names) == 3
    for k, field in ((1, 1), (2, 2)):
        coarse = ladder.at(record.level_triangles[k])
        far = SurfaceIndex(coarse.vertices, coarse.faces).nearest(mesh.vertices).distance_mm
        most = float(about["fields"][field]["most"].split()[0])
        np.testing.assert_allclose(fields[field] / 255.0 * most, np.minimum(far, most), atol=0.004 * most + 2e-4)
    touched = record.scp[record.contact]
    for vertex in np.random.default_rng(0).integers(len(mesh.vertices), size=200):
        away = np.linalg.norm(touched - mesh.vertices[vertex], axis=1)
        reach = 0.01 * np.linalg.norm(np.ptp(mesh.vertices, axis=0)) + 0.5
        if abs(away.min() - reach) > 1e-3:
            expected = 1 + record.level[record.contact][np.argmin(away)] if away.min() < reach else 0
            assert fields[0][vertex] == expected
    assert len(set(fields[0])) >= 3  # untouched, and two levels at least


def test_a_comparison(folder: Path) -> None:
    write_globe(folder / "a.stl")
    (folder / "broken.stl").write_bytes(b"junk")

    class Here:
        def outcomes(self, tasks: list, *, alone: bool) -> list:
            return [(task, perform(task)) for task in tasks]

    with Ledger(folder / "two.db") as ledger:
        run_batch(cells(folder, "a.stl", "broken.stl"), ledger, Here())
    assert tuning.cli.run(["report", str(folder / "two.db"), "-o", str(folder / "two.html")]) == 0
    made = Page((folder / "two.html").read_text(encoding="utf-8"))
    assert "2 of 4 cells are measured" in made.words and "velocity-ours" in made.words
    assert "broken.stl: 2 cells" in made.words and "Code version" in made.words
    assert len(made.every("img")) == 4 and all(picture["alt"] for picture in made.every("img"))
    rows = re.findall(r"a\.stl", made.words)
    assert len(rows) >= 2


def test_a_scan_of_its_own_for_the_view(folder: Path, page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    write_globe(folder / "other.stl", 5.0)
    words = ["report", str(folder / "globe.hlod"), "-o", str(folder / "x.html"), "--scan", str(folder / "other.stl")]
    assert tuning.cli.run(words) == 2
    assert "is not the scan that globe.hlod was made of" in capsys.readouterr().err
    assert not (folder / "x.html").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["absent.hlod", "-o", "x.html"], "absent.hlod"),
        (["notes.txt", "-o", "x.html"], "notes.txt"),
        (["globe.hlod", "-o", "nowhere/x.html"], "nowhere"),
        (["globe.hlod", "-o", "globe.hlod"], "is also an input"),
        (["globe.hlod", "-o", "x.html", "--front", "notes.txt"], "is no JSON"),
        (["globe.hlod", "-o", "x.html", "--quality", "front.json"], "has no 'metrics'"),
        (["empty.db", "-o", "x.html"], "holds no cell yet"),
        (["newer.db", "-o", "x.html"], "newer HapticLOD (ledger version 99"),
    ],
)
def test_bad_input(
    words: list[str], expected: str, folder: Path, page: Page, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    Path("notes.txt").write_text("mine " * 100)
    for name, version in (("empty.db", 1), ("newer.db", 99)):
        Path(name).unlink(missing_ok=True)
        Ledger(Path(name)).close()
        with contextlib.closing(sqlite3.connect(name)) as base:
            base.execute(f"PRAGMA user_version = {version}")
    assert tuning.cli.run(["report", *words]) == 2
    shown = capsys.readouterr()
    assert expected in shown.err and len(shown.err.splitlines()) == 1 and shown.out == ""
    assert not Path("x.html").exists()


def test_a_full_disk_leaves_the_old_page(
    folder: Path, page: Page, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def no_room(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (folder / "kept.html").write_text("the old page")
    before = {path.name for path in folder.iterdir()}
    monkeypatch.setattr(os, "fsync", no_room)
    assert tuning.cli.run(["report", str(folder / "globe.hlod"), "-o", str(folder / "kept.html")]) == 2
    assert "kept.html: cannot be written (No space left on device)" in capsys.readouterr().err
    assert (folder / "kept.html").read_text() == "the old page"
    assert {path.name for path in folder.iterdir()} == before
