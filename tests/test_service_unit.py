"""The station's systemd unit, by systemd's own tools: no fault, and little that a compromised program could reach."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tuning.deploy.package import HERE

MOST_EXPOSURE = 11
"""Of `systemd-analyze security`, in tenths: 10 with systemd 252. Real-time scheduling and hidraw are what is left."""


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit as it is installed, for a program that is there."""
    (tmp_path / "current").mkdir()
    program = tmp_path / "current" / "hapticlod-station"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    path = tmp_path / "hapticlod-station.service"
    path.write_text((HERE / "hapticlod-station.service").read_text().replace("@ROOT@", str(tmp_path)))
    return path


def analyze(*words: object) -> subprocess.CompletedProcess[str]:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("no systemd-analyze here: install systemd")
    return subprocess.run([program, *(str(word) for word in words)], capture_output=True, text=True, check=False)


def test_systemd_finds_no_fault(unit: Path) -> None:
    done = analyze("verify", unit)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    unit.write_text(unit.read_text().replace("LimitRTPRIO=90", "LimitRTPRIO=much"))
    assert "Failed to parse" in analyze("verify", unit).stderr  # it would have said so


def test_what_it_could_reach_is_little(unit: Path) -> None:
    words = ("security", "--offline=yes", "--no-pager")
    done = analyze(*words, f"--threshold={MOST_EXPOSURE}", unit)
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze cannot look at a file: systemd 251 can")
    assert done.returncode == 0, done.stdout
    unit.write_text(unit.read_text().replace("PrivateNetwork=yes\n", "").replace("ProtectSystem=strict\n", ""))
    assert analyze(*words, f"--threshold={MOST_EXPOSURE}", unit).returncode != 0


def test_what_it_writes_is_where_it_may_write(unit: Path) -> None:
    """ProtectSystem=strict leaves it these two folders, and the program puts its files under hapticlod there."""
    text = unit.read_text()
    for variable, folder in (("XDG_STATE_HOME=%S", "StateDirectory"), ("XDG_CACHE_HOME=%C", "CacheDirectory")):
        assert variable in text and f"{folder}=hapticlod\n" in text
