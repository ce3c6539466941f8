"""What is kept between runs: whole or absent, and enough of it that an interrupted run goes on where it was."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import hapticlod.ladder
import tuning.prepare
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import point
from tuning import kept
from tuning.prepare import prepare


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HAPTICLOD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def ball() -> Scan:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    return scan_from_arrays(mesh.vertices, mesh.faces, "ball")


@pytest.fixture
def station() -> Station:
    return load_station(shipped_config("stations/desktop_1khz.toml"))


def test_entries_come_back_and_damaged_ones_do_not(cache: Path) -> None:
    value = {"a": np.arange(1000.0), "b": (1, "two")}
    kept.store("kind", "key", value)
    found = kept.load("kind", "key")
    assert found is not None and np.array_equal(found["a"], value["a"]) and found["b"] == value["b"]
    assert kept.load("kind", "other") is None and kept.load("other", "key") is None
    (path,) = cache.rglob("*.kept")
    whole = path.read_bytes()
    for damaged in (whole[:-1], whole[:20], b"", whole[:500] + b"x" + whole[501:], whole + b"x"):
        path.write_bytes(damaged)
        assert kept.load("kind", "key") is None


def test_a_large_entry_is_written_without_a_copy(cache: Path) -> None:
    large = np.zeros(2_000_000)  # 16 MB
    tracemalloc.start()
    try:
        kept.store("kind", "large", large)
        assert tracemalloc.get_traced_memory()[1] < 4e6
    finally:
        tracemalloc.stop()
    found = kept.load("kind", "large")
    assert found is not None and np.array_equal(found, large)


class Unwilling:
    def __reduce__(self):
        raise KeyboardInterrupt


def test_an_interrupt_while_writing_leaves_nothing(cache: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        kept.store("kind", "key", [np.zeros(100_000), Unwilling()])
    assert list((cache / "kind").iterdir()) == []


def test_an_interrupted_tuning_goes_on_after_the_last_stage_it_finished(
    ball: Scan, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    def until_motions(seen: list[str]):
        def told(stage: str, part: float) -> None:
            seen.append(stage)
            if "motions" in stage:
                raise KeyboardInterrupt

        return told

    first: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        prepare(ball, station, point(), progress=until_motions(first))
    assert any("ladder" in stage for stage in first)

    def again(*args: object, **kwargs: object) -> None:
        raise AssertionError("the ladder was made again")

    monkeypatch.setattr(tuning.prepare, "ladder_of", again)
    second: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        prepare(ball, station, point(), progress=until_motions(second))
    assert not any("ladder" in stage for stage in second)
    other = scan_from_arrays(ball.vertices * 1.01, ball.faces)
    with pytest.raises(AssertionError, match="made again"):
        prepare(other, station, point())


def test_a_ladder_interrupted_between_rungs_goes_on_there(
    ball: Scan, station: Station, monkeypatch: pytest.MonkeyPatch, cache: Path
) -> None:
    whole = hapticlod.ladder.build_ladder(ball)
    parts: list[float] = []

    def until_the_fifth_rung(stage: str, part: float) -> None:
        parts.append(part)
        if len(parts) == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(ball, station, point(), progress=until_the_fifth_rung)
    assert parts[-1] < 1.0 and not list(cache.glob("ladders/*"))

    def again(*args: object, **kwargs: object) -> None:
        raise AssertionError("the scan was simplified again")

    monkeypatch.setattr(hapticlod.ladder, "collapse", again)
    measured: list[int] = []
    rms = hapticlod.ladder.ScanSurface.deviation

    def counted(self: hapticlod.ladder.ScanSurface, *rung: Any) -> object:
        measured.append(len(rung[1]))
        return rms(self, *rung)

    monkeypatch.setattr(hapticlod.ladder.ScanSurface, "deviation", counted)
    prepared: list[hapticlod.ladder.Ladder] = []
    store = kept.store

    def seen(kind: str, key: str, value: object) -> None:
        if isinstance(value, hapticlod.ladder.Ladder):
            prepared.append(value)
        store(kind, key, value)

    monkeypatch.setattr(kept, "store", seen)
    with pytest.raises(KeyboardInterrupt):
        prepare(ball, station, point(), progress=_until_motions)
    (ladder,) = prepared
    for one, other in zip(ladder.rungs, whole.rungs, strict=True):
        assert np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)
        assert one.deviation == other.deviation
    assert measured == [rung.triangles for rung in whole.rungs[6:]]
    assert list(cache.glob("ladders/*")) and not list(cache.glob("ladder_pieces/*"))


def _until_motions(stage: str, part: float) -> None:
    if "motions" in stage:
        raise KeyboardInterrupt
