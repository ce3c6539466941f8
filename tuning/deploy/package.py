"""The package: one tar file with all that a station needs. The same file goes over ssh or onto a USB stick."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import hapticlod
from hapticlod.bundle import read_bundle
from hapticlod.errors import InputError
from hapticlod.shipped import shipped_config
from hapticlod.trust import TrustedKey

HERE: Final = Path(__file__).resolve().parent
ROOT: Final = "/opt/hapticlod"
_README = """HapticLOD release {release}

As a user that may write {root} (root may):

    tar xf THIS_FILE.tar && {install}

`sh install.sh status` and `sh install.sh rollback` look at it and take it back; the head of install.sh has the options.
"""


@dataclass(frozen=True)
class Package:
    """A package that was written.

    Attributes:
        path: the tar file.
        release: its name on the station: the version, and a digest of what it holds.
        bytes: size of the tar file.
        signed: whether its bundle is.
        install: the command that installs it where it was unpacked.
    """

    path: Path
    release: str
    bytes: int
    signed: bool
    install: str


def write_package(bundle: Path, path: Path, *, station: Path | None = None, trust: TrustedKey | None = None) -> Package:
    """Check a bundle and write a package with it: bundle, station program, device profiles, install script,
    unit, udev rules, digests.

    Equal contents give equal bytes. `trust` is a key that the station is to trust from then on.

    Raises:
        InputError: the bundle or the program cannot be used, or the file cannot be written.
    """
    held = read_bundle(bundle)
    program = station or station_program()
    files: dict[str, Path | bytes] = {
        "bundle.hlod": bundle,
        "hapticlod-station": program,
        "install.sh": HERE / "station.sh",
        "hapticlod-station.service": HERE / "hapticlod-station.service",
        "70-hapticlod.rules": shipped_config("devices/70-hapticlod.rules"),
    }
    # Without them `DEVICE=native` would name nothing on a station.
    profiles = sorted(shipped_config("devices/70-hapticlod.rules").parent.glob("*.toml"))
    files |= {f"devices/{profile.name}": profile for profile in profiles}
    if trust is not None:
        files["trust.pub"] = f"{trust.line}\n".encode()
    sums = {name: _sha256(content) for name, content in sorted(files.items())}
    together = "".join(f"{digest}  {name}\n" for name, digest in sums.items())
    release = f"{hapticlod.__version__}-{hashlib.sha256(together.encode()).hexdigest()[:12]}"
    install = f"sh hapticlod-{release}/install.sh" + (f" --trust hapticlod-{release}/trust.pub" if trust else "")
    files["README"] = _README.format(release=release, root=ROOT, install=install).encode()
    files["ID"] = f"{release}\n".encode()
    files["SHA256SUMS"] = together.encode()
    _write_tar(path, f"hapticlod-{release}", files)
    return Package(path, release, path.stat().st_size, held.signer is not None, install)


def station_program() -> Path:
    """The `hapticlod-station` to ship: $HAPTICLOD_STATION, else the one beside this Python, else on the PATH.

    Raises:
        InputError: there is none.
    """
    places = [os.environ.get("HAPTICLOD_STATION"), str(Path(sys.executable).parent / "hapticlod-station")]
    for place in (*places, shutil.which("hapticlod-station")):
        if place and Path(place).is_file():
            return Path(place)
    raise InputError("hapticlod-station", "is not here", "build it (make station-static) and name it with --station")


def _sha256(content: Path | bytes) -> str:
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest()
    try:
        with content.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(str(content), f"cannot be read ({error.strerror})", "check the path") from error


def _write_tar(path: Path, folder: str, files: dict[str, Path | bytes]) -> None:
    """Beside, fsynced, renamed."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("xb") as raw:
            with tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as tar:
                for name, content in files.items():
                    entry = tarfile.TarInfo(f"{folder}/{name}")
                    entry.mode = 0o755 if name in ("hapticlod-station", "install.sh") else 0o644
                    if isinstance(content, bytes):
                        entry.size = len(content)
                        tar.addfile(entry, io.BytesIO(content))
                    else:
                        entry.size = content.stat().st_size
                        with content.open("rb") as file:
                            tar.addfile(entry, file)
            raw.flush()
            os.fsync(raw.fileno())
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(str(path), f"cannot be written ({error.strerror})", "choose another place") from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise
