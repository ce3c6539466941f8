"""`hapticlod deploy` and `hapticlod pack`: a bundle and the station program onto another machine."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from hapticlod.errors import InputError
from tuning.commands.outputs import check_writable
from tuning.deploy.package import ROOT, Package, write_package
from tuning.deploy.remote import Remote


def deploy_command(
    *names: str,
    root: str = ROOT,
    service: str = "",
    add_service: Annotated[bool, Parameter(negative=())] = False,
    station: Path | None = None,
    trust: Annotated[bool, Parameter(negative=())] = False,
    accept_unsigned: Annotated[bool, Parameter(negative=())] = False,
    dry_run: Annotated[bool, Parameter(negative=())] = False,
    rollback: Annotated[bool, Parameter(negative=())] = False,
    status: Annotated[bool, Parameter(negative=())] = False,
    ssh_config: Path | None = None,
    health_s: float = 3.0,
) -> None:
    """Install a bundle on a station over ssh: hapticlod deploy BUNDLE user@host[:port].

    The station checks digests, signature and, by its golden motion, itself; only then `current` changes, in one step.
    What does not come up is taken back. Doing it again changes nothing.

    Parameters
    ----------
    names
        BUNDLE and user@host[:port]; with --rollback or --status the station alone.
    root
        Folder on the station.
    service
        systemd service there to restart and watch. Default: none.
    add_service
        Install the service and the udev rules there (as root, or with sudo without a password).
    station
        The hapticlod-station program to install. Default: the one beside this Python. The static one (make
        station-static) needs no library there, but knows no HID device.
    trust
        Let the station trust your own key from now on.
    accept_unsigned
        Install a bundle that the station does not trust, to be run with --accept-unsigned.
    dry_run
        Only say what would be done, and whether it could be.
    rollback
        Go back to the release before.
    status
        Say which release runs.
    ssh_config
        Configuration file for ssh. Default: yours.
    health_s
        How long the service must stay up, s.
    """
    if rollback and status:
        raise InputError("--rollback", "goes without --status", "give one of the two")
    wanted = 1 if rollback or status else 2
    if len(names) != wanted:
        usage = "user@host" if wanted == 1 else "BUNDLE user@host"
        raise InputError("hapticlod deploy", f"takes {usage}, not {len(names)} names", "see hapticlod deploy --help")
    if add_service and not service:
        service = "hapticlod-station"
    remote = Remote.parse(names[-1], ssh_config, root, service)
    out = Console(highlight=False, soft_wrap=True)

    def say(line: str) -> None:
        out.print(f"{remote.host}: {line}", markup=False)

    if status or rollback:
        health = ["--health-seconds", f"{health_s:g}"] if rollback else []
        remote.script("status" if status else "rollback", *health, say=say)
        return
    with tempfile.TemporaryDirectory(prefix="hapticlod-") as folder:
        package = _packed(Path(names[0]), Path(folder) / "station.tar", station, trust, accept_unsigned)
        out.print(f"{names[0]}: release {package.release}, {package.bytes / 1e6:.1f} MB to send", markup=False)
        new = ["--add-service"] if add_service else []
        remote.script("check", "--need", remote.needed_kb(package), *new, say=say)
        if dry_run:
            say(f"would install {package.release} and make it current")
            return
        words = [*new, "--health-seconds", f"{health_s:g}"]
        words += ["--trust", "trust.pub"] if trust else []
        words += ["--accept-unsigned"] if accept_unsigned else []
        remote.install(package, *words, say=say)


def pack_command(
    bundle: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    station: Path | None = None,
    trust: Annotated[bool, Parameter(negative=())] = False,
    accept_unsigned: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Write one file that installs a bundle on a station without a network: tar xf it there, run its install.sh.

    Parameters
    ----------
    bundle
        The bundle (.hlod).
    output
        The package to write (.tar).
    station
        The hapticlod-station program to put in, as for `hapticlod deploy`.
    trust
        Add your public key, for install.sh --trust.
    accept_unsigned
        Pack a bundle that is not signed; install.sh needs --accept-unsigned then.
    """
    check_writable(output, [path for path in (bundle, station) if path is not None])
    package = _packed(bundle, output, station, trust, accept_unsigned)
    out = Console(highlight=False, soft_wrap=True)
    out.print(f"{output}: release {package.release}, {package.bytes / 1e6:.1f} MB", markup=False)
    out.print(f"on the station: tar xf {output.name} && {package.install}", markup=False)


def _packed(bundle: Path, path: Path, station: Path | None, trust: bool, accept_unsigned: bool) -> Package:
    from hapticlod.signature import load_key, own_key_path
    from hapticlod.trust import TrustedKey

    key = None
    if trust:
        own = load_key(own_key_path())
        key = TrustedKey(own.public, own.name)
    package = write_package(bundle, path, station=station, trust=key)
    if not package.signed and not accept_unsigned:
        path.unlink()
        raise InputError(str(bundle), "is not signed", "sign it with `hapticlod key sign`, or add --accept-unsigned")
    return package
