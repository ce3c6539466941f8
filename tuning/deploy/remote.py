"""A station at the other end of the system's ssh: what is run there is tuning/deploy/station.sh, and nothing else."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from hapticlod.errors import InputError
from tuning.deploy.package import HERE, Package

UNREACHED = 255
"""ssh's own status: no connection, or a broken one."""
_SLACK_KB = 1024


@dataclass(frozen=True)
class Remote:
    """A station.

    Attributes:
        host: user@host, or an alias of the ssh configuration.
        port: None for ssh's own.
        ssh_config: a configuration file for ssh (`ssh -F`); None for the user's.
        root: folder on the station that holds the releases.
        service: systemd service to restart; empty for none.
    """

    host: str
    port: int | None
    ssh_config: Path | None
    root: str
    service: str

    @classmethod
    def parse(cls, text: str, ssh_config: Path | None, root: str, service: str) -> Remote:
        """`user@host`, `host`, `user@host:port` or `user@[address]:port`. Raises InputError."""
        match = re.fullmatch(r"((?:[\w.-]+@)?(?:\[[0-9A-Fa-f:.%\w]+\]|[\w.-]+))(?::(\d{1,5}))?", text, re.ASCII)
        if match is None or text.startswith("-") or "@-" in text:  # ssh would take a leading dash for an option
            raise InputError(text, "is no station", "name it as user@host or user@host:port")
        port = int(match[2]) if match[2] else None
        if port is not None and not 1 <= port <= 65535:
            raise InputError(text, f"port {port} does not exist", "give a port from 1 to 65535")
        if not re.fullmatch(r"/[\w./-]+", root, re.ASCII) or "/.." in root:
            raise InputError("--root", f"{root!r} is no folder for releases", "give an absolute path without blanks")
        if service and not re.fullmatch(r"[\w.@-]+", service, re.ASCII):
            raise InputError("--service", f"{service!r} is no name of a service", "name it as systemctl does")
        return cls(match[1].replace("[", "").replace("]", ""), port, ssh_config, root, service)

    def script(self, job: str, *words: str, say: Callable[[str], None]) -> None:
        """Run a job of station.sh: check, rollback, status.

        Raises:
            InputError: the station cannot be reached, or the job failed there.
        """
        command = shlex.join(["sh", "-s", "--", job, *self._where(), *words])
        with (HERE / "station.sh").open("rb") as script:
            self._run(command, script, say)

    def install(self, package: Package, *words: str, say: Callable[[str], None]) -> None:
        """Send a package and install it; the station is as before where anything fails.

        Raises:
            InputError: see `script`; also when the connection broke on the way.
        """
        root = shlex.quote(self.root)
        install = shlex.join(["install", *self._where(), *words])
        command = (
            f"umask 022; mkdir -p {root} && d=$(mktemp -d {root}/incoming.XXXXXX) || exit 1; "
            "trap 'rm -rf \"$d\"' EXIT; "
            'tar -x -C "$d" -f - || { echo "FAULT package: did not arrive whole; deploy again" >&2; exit 1; }; '
            f'cd "$d"/hapticlod-* && sh ./install.sh {install}'
        )
        with package.path.open("rb") as tar:
            self._run(f"sh -c {shlex.quote(command)}", tar, say)

    def needed_kb(self, package: Package) -> str:
        """Free space that installing takes: the package as it arrives, its copy, and the one that was sent."""
        return str(2 * package.bytes // 1024 + _SLACK_KB)

    def _where(self) -> list[str]:
        return ["--root", self.root, *(["--service", self.service] if self.service else [])]

    def _run(self, command: str, stdin: IO[bytes], say: Callable[[str], None]) -> None:
        program = shutil.which("ssh")
        if program is None:
            raise InputError("ssh", "is not installed here", "install openssh-client")
        options = ["-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=5"]
        if self.ssh_config is not None:
            options += ["-F", str(self.ssh_config)]
        if self.port is not None:
            options += ["-p", str(self.port)]
        done = subprocess.run(
            [program, *options, "--", self.host, command], stdin=stdin, capture_output=True, text=True, errors="replace"
        )
        for line in done.stdout.splitlines():
            say(line)
        if done.returncode:
            raise self._fault(done.returncode, done.stderr.splitlines())

    def _fault(self, status: int, errors: Sequence[str]) -> InputError:
        told = [line.removeprefix("FAULT ") for line in errors if line.startswith("FAULT ")]
        if told:
            where, _, rest = told[0].partition(": ")
            what, _, remedy = rest.rpartition("; ")
            return InputError(f"{self.host}, {where}", what or rest, remedy if what else "look there")
        last = next((line for line in reversed(errors) if line.strip()), f"status {status}")
        if status == UNREACHED:
            return InputError(
                self.host,
                f"cannot be reached, or the connection broke ({last})",
                f"try `ssh {self.host}`; nothing is half done",
            )
        return InputError(self.host, f"failed with status {status} ({last})", "look there")
