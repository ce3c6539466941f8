"""Hands that are made by several processes are those that one makes."""

import pickle
import sys

import pytest

from hapticlod.dentition import make_dentition
from hapticlod.motion import Motion
from hapticlod.motion.surface import ScanLike
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import Tool, point
from tuning import make_hands as module
from tuning.make_hands import Hand, Making, make_hands

STATION, SCAN = load_station(shipped_config("stations/desktop_1khz.toml")), make_dentition(triangles=3000, seed=0)
HANDS = [Hand("transfer", 2.0, 7), Hand("probe", 1.0, 8), Hand("trace", 3.0, 9), Hand("scan", 1.5, 10)]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> list[Hand]:
    """The hands that this process makes, from now on."""
    made_here: list[Hand] = []
    make = module._made  # pyright: ignore[reportPrivateUsage] - who makes what is to be seen

    def made(scan: ScanLike, station: Station, tool: Tool, hand: Hand) -> Motion:
        made_here.append(hand)
        return make(scan, station, tool, hand)

    monkeypatch.setattr(module, "_made", made)
    return made_here


def _wait(making: Making) -> None:
    for process in making._running:  # pyright: ignore[reportPrivateUsage] - as if we had something else to do
        process.wait(60.0)


@pytest.mark.parametrize(
    ("program", "busy", "left"),
    [(sys.executable, True, 0), (sys.executable, False, None), ("/bin/false", True, 4), ("/nowhere/python", False, 4)],
)
def test_processes_make_the_same_hands(
    program: str, busy: bool, left: int | None, here: list[Hand], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a process fails, or cannot be started: then it costs time."""
    alone = make_hands(SCAN, STATION, point(), HANDS, 4)  # too little to do for more than one
    assert here == HANDS
    here.clear()
    monkeypatch.setattr(module, "FEWEST_S", 2.0)
    monkeypatch.setattr(sys, "executable", program)
    with Making(SCAN, STATION, point(), HANDS, 3) as making:
        if busy:
            _wait(making)
        together = making.finish()
    if left is not None:
        assert len(here) == left
    assert [motion.name for motion in together] == ["transfer-7", "probe-8", "trace-9", "scan-10"]
    assert [motion.digest for motion in together] == [motion.digest for motion in alone]
    assert [motion.provenance for motion in together] == [motion.provenance for motion in alone]


def test_what_a_process_took_and_did_not_make_is_made_here(here: list[Hand], monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where what it left is half of a motion."""
    monkeypatch.setattr(module, "FEWEST_S", 2.0)
    monkeypatch.setattr(sys, "executable", "/bin/true")
    with Making(SCAN, STATION, point(), HANDS, 2) as making:
        _wait(making)
        folder = making._folder  # pyright: ignore[reportPrivateUsage] - what a process would do there
        (folder / "2.task").rename(folder / "2.taken")
        (folder / "3.task").rename(folder / "3.taken")
        (folder / "3.made").write_bytes(pickle.dumps(HANDS)[:40])
        made = making.finish()
    assert [motion.name for motion in made] == ["transfer-7", "probe-8", "trace-9", "scan-10"]
    assert sorted(here, key=HANDS.index) == HANDS


def test_who_gives_up_leaves_no_process_and_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FEWEST_S", 2.0)
    with pytest.raises(KeyboardInterrupt), Making(SCAN, STATION, point(), HANDS, 3) as making:
        folder, running = making._folder, making._running  # pyright: ignore[reportPrivateUsage]
        assert len(running) == 2 and folder.is_dir()
        raise KeyboardInterrupt
    assert all(process.returncode is not None for process in running) and not folder.exists()
