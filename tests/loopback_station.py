"""A station for the deployment tests: a real sshd on loopback with keys and a port of its own, and a throw-away root.

`systemctl`, `df`, `tar`, `cp` and the station program's `qualify` are stand-ins that do what files beside them say.
"""

import getpass
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from plate_bundle import station_program

_SYSTEMCTL = """#!/bin/sh
cd "{folder}" && echo "$*" >>systemctl.log
case $1 in
    cat) [ -e service ] ;;
    is-active) [ ! -e broken ] || [ "$(cat broken)" != "$(readlink "{root}/current")" ] ;;
esac
"""
_DF = """#!/bin/sh
[ -e "{folder}/full" ] || exec /usr/bin/env PATH=/usr/bin:/bin df "$@"
printf 'Filesystem 1024-blocks Used Available Capacity Mounted\\nx 100 90 10 90%% /\\n'
"""
# A disk that fills up while it writes: no file of more than 32 kB.
_FILLING = """#!/bin/sh
[ "$(cat "{folder}/filling" 2>/dev/null)" != {{name}} ] || ulimit -f 64
exec /usr/bin/env PATH=/usr/bin:/bin {{name}} "$@"
"""
_STATION = """#!/bin/sh
case $1 in
    doctor) echo well ;;
    qualify) echo "p99.9 is 2.5 ms"; [ ! -e "{folder}/unfit" ] ;;
    *) exec "{program}" "$@" ;;
esac
"""
_CUT = """import os, socket, sys, threading
server = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
def back():
    while data := server.recv(65536):
        os.write(1, data)
threading.Thread(target=back, daemon=True).start()
left = int(sys.argv[2])
while left > 0 and (data := os.read(0, min(left, 65536))):
    server.sendall(data)
    left -= len(data)
os._exit(1)
"""


@dataclass(frozen=True)
class LoopbackStation:
    """`folder` holds keys and stand-ins, `root` is what deployments change."""

    folder: Path
    root: Path
    port: int
    ssh_config: Path
    program: Path

    def flag(self, name: str, text: str = "") -> None:
        """Make a stand-in misbehave: `full`, `unfit`, `filling` with the program that meets it, `broken` with the
        release it stands for; `service` exists."""
        (self.folder / name).write_text(text)

    def state(self) -> dict[str, str]:
        """Everything under the root: files by content, links by target. Neither locks nor times."""
        found = {}
        for path in sorted(self.root.rglob("*")):
            name = str(path.relative_to(self.root))
            if path.is_symlink():
                found[name] = f"-> {os.readlink(path)}"
            elif path.is_file() and name != ".lock":
                found[name] = str(hash(path.read_bytes()))
        return found

    def cut_after(self, count: int) -> Path:
        """An ssh configuration whose connections break after so many bytes."""
        (self.folder / "cut.py").write_text(_CUT)
        config = self.folder / "cut_config"
        proxy = f"ProxyCommand {sys.executable} {self.folder / 'cut.py'} {self.port} {count}"
        config.write_text(self.ssh_config.read_text().replace("  Port", f"  {proxy}\n  Port"))
        return config


def stand_in(folder: Path) -> Path:
    """The station program, but whether the machine qualifies hangs on the file `unfit`, not on how busy it is."""
    program = folder / "hapticlod-station"
    program.write_text(_STATION.format(folder=folder, program=station_program()))
    program.chmod(0o755)
    return program


def start_station(folder: Path) -> Iterator[LoopbackStation]:
    """Run sshd as long as the test lasts; skips where there is none."""
    sshd = shutil.which("sshd", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")
    if sshd is None or shutil.which("ssh") is None or shutil.which("ssh-keygen") is None:
        pytest.skip("no sshd here: install openssh-server")
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)  # sshd refuses to run as root without
    for name in ("host", "user", "stranger"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    (folder / "authorized").write_text((folder / "user.pub").read_text())
    (folder / "bin").mkdir()
    root = folder / "station"
    program = stand_in(folder)
    stand_ins = {folder / "bin/systemctl": _SYSTEMCTL, folder / "bin/df": _DF}
    stand_ins |= {folder / f"bin/{name}": _FILLING.replace("{{name}}", name) for name in ("tar", "cp")}
    for path, text in stand_ins.items():
        path.write_text(text.format(folder=folder, root=root))
        path.chmod(0o755)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (folder / "sshd_config").write_text(
        f"ListenAddress 127.0.0.1\nPort {port}\nHostKey {folder}/host\nAuthorizedKeysFile {folder}/authorized\n"
        "KexAlgorithms curve25519-sha256\nStrictModes no\nUsePAM no\nPasswordAuthentication no\n"
        "KbdInteractiveAuthentication no\nPidFile none\n"
        f"SetEnv PATH={folder}/bin:/usr/sbin:/usr/bin:/bin\n"
    )
    (folder / "known").write_text(f"[127.0.0.1]:{port} {(folder / 'host.pub').read_text()}")
    config = folder / "ssh_config"
    config.write_text(
        f"Host station\n  HostName 127.0.0.1\n  Port {port}\n  User {getpass.getuser()}\n  IdentityFile {folder}/user\n"
        f"  IdentitiesOnly yes\n  IdentityAgent none\n  UserKnownHostsFile {folder}/known\n"
        "  GlobalKnownHostsFile /dev/null\n  StrictHostKeyChecking yes\n"
    )
    with (folder / "sshd.log").open("w") as log:
        server = subprocess.Popen([sshd, "-D", "-e", "-f", folder / "sshd_config"], stderr=log)
        try:
            _wait_for(port, server, folder / "sshd.log")
            yield LoopbackStation(folder, root, port, config, program)
        finally:
            server.terminate()
            server.wait(timeout=10)


def _wait_for(port: int, server: subprocess.Popen[bytes], log: Path) -> None:
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        if server.poll() is not None:
            pytest.skip(f"sshd does not start here: {' '.join(log.read_text().split())}")
        time.sleep(0.05)
    pytest.fail("sshd does not listen")
