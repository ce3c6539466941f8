"""Deployment against a real sshd: what arrives, what is taken back, and that nothing changes where anything fails."""

import hashlib
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from loopback_station import LoopbackStation, stand_in, start_station
from plate_bundle import TEST_KEY, plate_parts, run_station

import tuning.cli
from hapticlod.bundle import sign_bundle, write_bundle
from hapticlod.errors import InputError
from hapticlod.signature import new_key
from tuning.deploy.package import write_package
from tuning.deploy.remote import Remote


@pytest.fixture(scope="module")
def sshd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LoopbackStation]:
    yield from start_station(tmp_path_factory.mktemp("loopback"))


@pytest.fixture
def station(sshd: LoopbackStation) -> Iterator[LoopbackStation]:
    """The station as delivered: it trusts the tests' key, nothing is installed, every stand-in works."""
    sshd.root.mkdir()
    trusted = sshd.root / "trusted_keys"
    trusted.write_text(TEST_KEY.public_line + "\n")
    trusted.chmod(0o644)
    yield sshd
    subprocess.run(["rm", "-rf", sshd.root], check=True)
    for name in ("service", "full", "filling", "unfit", "broken", "systemctl.log"):
        (sshd.folder / name).unlink(missing_ok=True)


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two releases' bundles."""
    folder, parts = tmp_path_factory.mktemp("bundles"), plate_parts(ticks=60)
    for number in (0, 1):
        write_bundle(folder / f"{number}.hlod", **{**parts, "manifest": {"number": number}})
    return [folder / "0.hlod", folder / "1.hlod"]


def deploy(station: LoopbackStation, *words: object, config: Path | None = None) -> int:
    names = [str(word) for word in words]
    options = ["--root", station.root, "--ssh-config", config or station.ssh_config, "--health-s", "0"]
    if "--status" not in names and "--rollback" not in names:
        options += ["--station", station.program]
    return tuning.cli.run(["deploy", *names, *(str(option) for option in options)])


def refused(station: LoopbackStation, capsys: pytest.CaptureFixture[str], *words: object, **how: Any) -> str:
    """Deploy what must be refused: one line, and the station as before. Returns the line."""
    before = station.state()
    assert deploy(station, *words, **how) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert station.state() == before
    return lines[0]


def current(station: LoopbackStation) -> Path:
    return (station.root / "current").resolve()


def test_install_upgrade_and_rollback(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert deploy(station, bundles[0], "station", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "would install" in said and "would do: nothing is current" in said
    assert list(station.state()) == ["trusted_keys"]

    assert deploy(station, bundles[0], "station") == 0
    said = capsys.readouterr().out
    assert "all checked, signed by tests, trusted" in said and "qualify: passed" in said
    first = current(station)
    assert (first / "bundle.hlod").read_bytes() == bundles[0].read_bytes()
    assert run_station("inspect", first / "bundle.hlod").returncode == 0
    assert (first / "devices/native.toml").is_file()  # what DEVICE=native means on a station
    assert deploy(station, "station", "--status") == 0
    assert "previous: none" in capsys.readouterr().out
    before = station.state()
    assert deploy(station, bundles[0], "station") == 0  # again: nothing changes
    assert "was current already" in capsys.readouterr().out
    assert station.state() == before

    assert deploy(station, bundles[1], f"station:{station.port}") == 0
    second = current(station)
    assert second != first and (second / "bundle.hlod").read_bytes() == bundles[1].read_bytes()
    assert deploy(station, "station", "--status") == 0
    said = capsys.readouterr().out
    assert f"current: {second.name}" in said and f"previous: {first.name}" in said and "signed by tests" in said
    assert deploy(station, "station", "--rollback") == 0
    assert current(station) == first
    assert deploy(station, "station", "--rollback") == 0  # and forth
    assert current(station) == second
    assert not list(station.root.glob("incoming.*"))


def test_the_service_is_restarted_and_a_release_that_does_not_come_up_is_taken_back(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert "haptics: is no service of this station" in refused(
        station, capsys, bundles[0], "station", "--service", "haptics"
    )
    station.flag("service")
    assert deploy(station, bundles[0], "station", "--service", "haptics") == 0
    capsys.readouterr()
    log = station.folder / "systemctl.log"
    assert "restart haptics" in log.read_text() and "is-active --quiet haptics" in log.read_text()
    first = current(station).name
    second = write_package(bundles[1], tmp_path / "p.tar", station=station.program).release
    station.flag("broken", f"releases/{second}")
    log.unlink()
    line = refused(station, capsys, bundles[1], "station", "--service", "haptics")
    assert f"does not come up with {second}, which was taken back" in line
    assert current(station).name == first
    assert log.read_text().count("restart haptics") == 2  # with the new one, then with the old one

    # A script that was killed after its switch and before it had seen the service alive: doing it again settles it.
    (station.folder / "broken").unlink()
    assert deploy(station, bundles[1], "station", "--service", "haptics") == 0
    (station.root / "releases" / second / "healthy").unlink()
    (station.root / "previous").unlink()
    station.flag("broken", f"releases/{second}")
    assert deploy(station, bundles[1], "station", "--service", "haptics") == 2
    assert current(station).name == first
    assert not (station.root / "releases" / second).exists()


def test_a_machine_that_does_not_qualify_stays_as_it_is(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert deploy(station, bundles[0], "station") == 0
    capsys.readouterr()
    station.flag("unfit")
    assert "qualify: this machine does not pass (p99.9 is 2.5 ms)" in refused(station, capsys, bundles[1], "station")


def test_a_connection_that_breaks_changes_nothing(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    package = write_package(bundles[0], tmp_path / "p.tar", station=station.program)
    remote = Remote("station", None, station.cut_after(package.bytes // 2), str(station.root), "")
    before = station.state()
    with pytest.raises(InputError, match="cannot be reached, or the connection broke"):
        remote.install(package, say=lambda line: None)
    for _ in range(100):  # the other end notices by itself
        if not list(station.root.glob("incoming.*")):
            break
        subprocess.run(["sleep", "0.05"], check=True)
    assert station.state() == before
    assert deploy(station, bundles[0], "station") == 0  # and again, with a connection that holds


def test_keys_hosts_space_and_rights(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    stranger = tmp_path / "stranger.hlod"
    sign_bundle(bundles[0], stranger, new_key("mallory"))
    assert "signed by a key that is not trusted here" in refused(station, capsys, stranger, "station")
    station.flag("full")
    assert "no space, 10 kB are free" in refused(station, capsys, bundles[0], "station")
    wrong = tmp_path / "wrong_config"
    wrong.write_text(station.ssh_config.read_text().replace(f"{station.folder}/user\n", f"{station.folder}/stranger\n"))
    assert "Permission denied" in refused(station, capsys, bundles[0], "station", config=wrong)
    gone = tmp_path / "gone_config"
    gone.write_text(station.ssh_config.read_text().replace(f"Port {station.port}", "Port 1"))
    assert "cannot be reached" in refused(station, capsys, bundles[0], "station", config=gone)
    other = tmp_path / "other_host"
    other.write_text(station.ssh_config.read_text().replace(f"{station.folder}/known", "/dev/null"))
    assert "Host key verification failed" in refused(station, capsys, bundles[0], "station", config=other)
    options = ["--ssh-config", str(station.ssh_config), "--station", str(station.program)]
    assert tuning.cli.run(["deploy", str(bundles[0]), "station", "--root", "/proc/hapticlod", *options]) == 2
    assert "/proc" in capsys.readouterr().err  # nobody may write there


@pytest.mark.parametrize(("program", "said"), [("tar", "did not arrive whole"), ("cp", "is there space?")])
def test_a_disk_that_fills_up_on_the_way_changes_nothing(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str], program: str, said: str
) -> None:
    station.flag("filling", program)
    assert said in refused(station, capsys, bundles[0], "station")
    assert not list(station.root.glob("incoming.*"))


def test_trust_that_has_expired_on_the_station(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    (station.root / "trusted_keys").write_text(f"{TEST_KEY.public_line} until=2001-01-01\n")
    assert "whose trust has expired" in refused(station, capsys, bundles[0], "station")


def test_unsigned_bundles_need_the_flag_and_trust_can_be_sent(
    station: LoopbackStation, bundles: list[Path], capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    bare = tmp_path / "bare.hlod"
    write_bundle(bare, **{**plate_parts(ticks=60), "key": None})
    assert "is not signed; sign it" in refused(station, capsys, bare, "station")
    assert deploy(station, bare, "station", "--accept-unsigned") == 0
    assert (current(station) / "release.env").read_text() == "OPTIONS_OF_RELEASE=--accept-unsigned\n"
    monkeypatch.setenv("HAPTICLOD_CONFIG", str(tmp_path / "config"))
    assert tuning.cli.run(["key", "new", "--name", "me"]) == 0
    assert tuning.cli.run(["key", "sign", str(bare)]) == 0
    capsys.readouterr()
    assert "not trusted here" in refused(station, capsys, bare, "station")
    assert deploy(station, bare, "station", "--trust") == 0
    assert (station.root / "trusted_keys").read_text().splitlines()[1].endswith(" me")
    assert (current(station) / "release.env").read_text() == "OPTIONS_OF_RELEASE=\n"


def install(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    command = ["sh", str(folder / "install.sh"), *(str(word) for word in words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture
def package(bundles: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A package on a stick, unpacked."""
    program = str(stand_in(tmp_path))
    assert tuning.cli.run(["pack", str(bundles[0]), "-o", str(tmp_path / "station.tar"), "--station", program]) == 0
    assert "install.sh" in capsys.readouterr().out
    with tarfile.open(tmp_path / "station.tar") as tar:
        tar.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.glob("hapticlod-[0-9]*")
    return folder


def test_a_package_installs_without_a_network(package: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    key = tmp_path / "tests.pub"
    key.write_text(TEST_KEY.public_line + "\n")
    refusal = install(package, "install", "--root", root)
    assert refusal.returncode == 1 and not (root / "current").exists()
    # The trust of the user who installs does not count, the station's does.
    assert "not trusted here" in refusal.stderr and len(refusal.stderr.splitlines()) == 1
    done = install(package, "--root", root, "--trust", key)
    assert done.returncode == 0, done.stderr
    assert f"current: {package.name.removeprefix('hapticlod-')}" in install(package, "status", "--root", root).stdout
    assert "has no release to go back to" in install(package, "rollback", "--root", root).stderr
    assert install(package, "--root", root, "--colour", "red").stderr.startswith("FAULT --colour: is no option")


def test_a_stick_brings_its_key_along(
    bundles: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`pack --trust`, and the command that the stick's README tells."""
    monkeypatch.setenv("HAPTICLOD_CONFIG", str(tmp_path / "config"))
    assert tuning.cli.run(["key", "new", "--name", "me"]) == 0
    bundle, tar, program = tmp_path / "mine.hlod", tmp_path / "station.tar", stand_in(tmp_path)
    bundle.write_bytes(bundles[0].read_bytes())
    assert tuning.cli.run(["key", "sign", str(bundle)]) == 0
    assert tuning.cli.run(["pack", str(bundle), "-o", str(tar), "--station", str(program), "--trust"]) == 0
    said = capsys.readouterr().out
    monkeypatch.delenv("HAPTICLOD_CONFIG")  # the station's user knows nobody
    (tmp_path / "stick").mkdir()
    with tarfile.open(tar) as files:
        files.extractall(tmp_path / "stick", filter="data")
    (folder,) = (tmp_path / "stick").iterdir()
    (command,) = [line.split("&& ")[1] for line in (folder / "README").read_text().splitlines() if "tar xf" in line]
    assert command.split()[-2:] == ["--trust", f"{folder.name}/trust.pub"] and command in said
    root = tmp_path / "root"
    trusted = root / "trusted_keys"
    trusted.parent.mkdir()
    trusted.write_text(TEST_KEY.public_line + "\n")

    def typed() -> subprocess.CompletedProcess[str]:
        words = [*command.split(), "--root", str(root)]
        return subprocess.run(words, cwd=folder.parent, capture_output=True, text=True, check=False)

    refusal = install(folder, "--root", root)  # without the word the key on the stick counts for nothing
    assert refusal.returncode == 1 and "not trusted here" in refusal.stderr
    assert trusted.read_text() == TEST_KEY.public_line + "\n"
    done = typed()
    assert done.returncode == 0, done.stderr
    assert "signed by me, trusted" in done.stdout
    assert trusted.read_text() == TEST_KEY.public_line + "\n" + (folder / "trust.pub").read_text()
    assert trusted.stat().st_mode & 0o777 == 0o644
    assert "was current already" in typed().stdout
    assert len(trusted.read_text().splitlines()) == 2  # not once more

    before = trusted.read_text()
    (folder / "trust.pub").write_text(new_key("mallory").public_line + "\n")
    altered = typed()
    assert altered.returncode == 1 and "was altered or damaged (trust.pub" in altered.stderr
    assert trusted.read_text() == before


def test_altered_packages_are_refused(package: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (root / "trusted_keys").write_text(TEST_KEY.public_line + "\n")
    bundle = package / "bundle.hlod"
    content = bytearray(bundle.read_bytes())
    content[-2000] ^= 1
    bundle.write_bytes(content)
    done = install(package, "--root", root)
    assert done.returncode == 1 and "FAULT package: was altered or damaged (bundle.hlod" in done.stderr
    sums = (package / "SHA256SUMS").read_text().splitlines()
    sums[1] = f"{hashlib.sha256(content).hexdigest()}  bundle.hlod"
    assert "bundle.hlod" in (package / "SHA256SUMS").read_text().splitlines()[1]
    (package / "SHA256SUMS").write_text("\n".join(sums) + "\n")  # as one would who means it
    done = install(package, "--root", root)
    assert done.returncode == 1 and "is damaged (its digest differs)" in done.stderr
    assert sorted(path.name for path in root.iterdir()) == [".lock", "releases", "trusted_keys"]


def test_a_program_of_another_machine_is_named(bundles: list[Path], tmp_path: Path) -> None:
    alien = tmp_path / "alien"
    alien.write_bytes(b"\x7fELF\x02\x01\x01" + bytes(57))
    write_package(bundles[0], tmp_path / "p.tar", station=alien)
    with tarfile.open(tmp_path / "p.tar") as tar:
        tar.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.glob("hapticlod-*")
    done = install(folder, "--root", tmp_path / "root")
    assert done.returncode == 1 and "hapticlod-station: does not run on this machine" in done.stderr


def test_equal_packages_have_equal_bytes(bundles: list[Path], tmp_path: Path) -> None:
    for name in ("a.tar", "b.tar"):
        write_package(bundles[0], tmp_path / name)
    assert (tmp_path / "a.tar").read_bytes() == (tmp_path / "b.tar").read_bytes()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["x.hlod"], "takes BUNDLE user@host, not 1 names"),
        (["x.hlod", "host", "--status"], "takes user@host, not 2 names"),
        (["host", "--status", "--rollback"], "--rollback: goes without --status"),
        (["x.hlod", "me@host:99999"], "port 99999 does not exist"),
        (["x.hlod", "-oProxyCommand=touch"], "-o"),
        (["x.hlod", "me@-oProxyCommand"], "is no station"),
        (["x.hlod", "host;reboot"], "is no station"),
        (["x.hlod", "host", "--root", "/a b"], "--root: '/a b' is no folder"),
        (["x.hlod", "host", "--service", "a;b"], "--service: 'a;b' is no name"),
        (["missing.hlod", "host"], "missing.hlod: does not exist"),
    ],
)
def test_bad_words(words: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert tuning.cli.run(["deploy", *words]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and reason in lines[0]
