"""Files of trusted keys: `ed25519 BASE64 name [until=YYYY-MM-DD]`, one key per line. Equal to runtime/io/trust.cpp."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path

from hapticlod.errors import InputError
from hapticlod.files import write_atomic
from hapticlod.signature import PUBLIC, SECRET, config_folder, from_text, to_text

_LINE_REMEDY = f"write: {PUBLIC} KEY name [until=YYYY-MM-DD]; `hapticlod key trust` does"


@dataclass(frozen=True)
class TrustedKey:
    """A public key (32 bytes), whose it is, and the last day (UTC) on which it is trusted; None: without end."""

    public: bytes
    name: str
    until: date | None = None

    @property
    def line(self) -> str:
        """The entry in a file of trusted keys."""
        return f"{PUBLIC} {to_text(self.public)} {self.name}" + (f" until={self.until}" if self.until else "")

    @property
    def expired(self) -> bool:
        """Whether its last day is over."""
        return self.until is not None and datetime.now(UTC).date() > self.until


def own_trust_file() -> Path:
    """This user's file of trusted keys, which the station reads too."""
    return config_folder() / "trusted_keys"


def standard_trust_files() -> list[Path]:
    """What the station reads when it is told nothing else, as far as it exists."""
    return [path for path in (Path("/etc/hapticlod/trusted_keys"), own_trust_file()) if path.exists()]


def parse_trusted_keys(text: str, name: str) -> list[TrustedKey]:
    """The keys of a file called `name`. Raises InputError, which names the line."""
    keys = []
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{name}:{number}"
        if words[0] == SECRET:
            raise InputError(where, "is a secret key", "keep it away from here; name the .pub")
        if words[0] != PUBLIC:
            raise InputError(where, "is no line of a trusted key", _LINE_REMEDY)
        public = from_text(words[1]) if len(words) > 1 else None
        if public is None:
            raise InputError(where, "has no key of 32 bytes in base64", _LINE_REMEDY)
        if len(words) < 3 or words[2].startswith("until="):
            raise InputError(where, "has no name", _LINE_REMEDY)
        until = parse_until(words[3], where) if len(words) > 3 else None
        if len(words) > 4:
            raise InputError(where, "has words too many", _LINE_REMEDY)
        keys.append(TrustedKey(public, words[2], until))
    return keys


def parse_until(word: str, where: str) -> date:
    """`until=2027-01-31` as a date. Raises InputError."""
    if match := re.fullmatch(r"until=(\d{4}-\d{2}-\d{2})", word, re.ASCII):
        try:
            return date.fromisoformat(match[1])
        except ValueError:
            pass
    raise InputError(where, "has something else than until=YYYY-MM-DD", _LINE_REMEDY)


def read_trusted_keys(path: Path) -> list[TrustedKey]:
    """The keys of a file.

    Raises:
        InputError: it cannot be read, others can write it, or a line is wrong.
    """
    try:
        if path.stat().st_mode & 0o022:
            raise InputError(str(path), "can be written by others, who could add keys", "chmod go-w it")
        text = path.read_text("utf-8", errors="replace")
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", "check the path") from error
    return parse_trusted_keys(text, str(path))


def add_trusted_key(path: Path, key: TrustedKey) -> None:
    """Trust a key from now on; an entry that the file has for it is replaced, comments stay.

    Raises:
        InputError: the file cannot be read or written.
    """
    lines = []
    if path.exists():
        read_trusted_keys(path)
        lines = path.read_text("utf-8").splitlines()
    else:
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT, 0o644))
            path.chmod(0o644)
        except OSError as error:
            raise InputError(str(path), f"cannot be written ({error.strerror})", "choose another folder") from error
    kept = [line for line in lines if line.split()[1:2] != [to_text(key.public)]]
    write_atomic(path, "\n".join([*kept, key.line]) + "\n")


def judge_trust(signer: bytes | None, keys: list[TrustedKey]) -> tuple[bool, str]:
    """Whether a bundle signed by this key is trusted, and in words why or why not."""
    if signer is None:
        return False, "not signed"
    entries = [key for key in keys if key.public == signer]
    for key in entries:
        if not key.expired:
            return True, f"signed by {key.name}, trusted"
    if entries:
        return False, f"signed by {entries[-1].name}, whose trust has expired"
    return False, f"signed by a key that is not trusted here ({to_text(signer)})"
