"""Hands that are made by several processes are those that one makes."""

import sys

import pytest

from hapticlod.dentition import make_dentition
from hapticlod.motion import Motion
from hapticlod.motion.surface import ScanLike
from hapticlod.shipped import shipped_config
from hapticlod.station import Station, load_station
from hapticlod.tool import Tool, point
from tuning import make_hands as module
from tuning.make_hands import Hand, make_hands

HANDS = [Hand("transfer", 2.0, 7), Hand("probe", 1.0, 8), Hand("trace", 3.0, 9), Hand("scan", 1.5, 10)]


@pytest.mark.parametrize(("program", "left"), [(sys.executable, 1), ("/bin/false", 4), ("/nowhere/python", 4)])
def test_processes_make_the_same_hands(program: str, left: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a process fails, or cannot be started: then it costs time."""
    station, scan = load_station(shipped_config("stations/desktop_1khz.toml")), make_dentition(triangles=3000, seed=0)
    alone = make_hands(scan, station, point(), HANDS, 4)  # too little to do for more than one
    monkeypatch.setattr(module, "FEWEST_S", 2.0)
    monkeypatch.setattr(sys, "executable", program)
    here: list[Hand] = []
    make = module._made  # pyright: ignore[reportPrivateUsage] - who makes what is to be seen

    def made(scan: ScanLike, station: Station, tool: Tool, hand: Hand) -> Motion:
        here.append(hand)
        return make(scan, station, tool, hand)

    monkeypatch.setattr(module, "_made", made)
    together = make_hands(scan, station, point(), HANDS, 3)
    assert len(here) == left
    assert [motion.name for motion in together] == ["transfer-7", "probe-8", "trace-9", "scan-10"]
    assert [motion.digest for motion in together] == [motion.digest for motion in alone]
    assert [motion.provenance for motion in together] == [motion.provenance for motion in alone]
