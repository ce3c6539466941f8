"""Ed25519 signatures of bundles, and the keys that make them. docs/bundle.md says what is signed and what trust means.

A key file is one line of text: `ed25519-secret BASE64 name` (for its owner alone), `ed25519 BASE64 name` (public).
"""

from __future__ import annotations

import base64
import binascii
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from nacl.exceptions import BadSignatureError
from nacl.signing import SigningKey, VerifyKey

from hapticlod.errors import InputError
from hapticlod.files import write_atomic

SIGNATURE_BYTES: Final = 96
"""Section SIGNATURE: public key (32), signature (64)."""
PUBLIC, SECRET = "ed25519", "ed25519-secret"
_NEW_KEY = "make one with `hapticlod key new`"


@dataclass(frozen=True)
class Key:
    """Somebody's key pair.

    Attributes:
        name: whose it is, one word; it is not part of what is signed.
        secret: 32 bytes.
    """

    name: str
    secret: bytes = field(repr=False)

    @property
    def public(self) -> bytes:
        """(32 bytes)."""
        return bytes(SigningKey(self.secret).verify_key)

    @property
    def public_line(self) -> str:
        """What others put into their files of trusted keys."""
        return f"{PUBLIC} {to_text(self.public)} {self.name}"

    def signature(self, header_and_table: bytes) -> bytes:
        """Content of section SIGNATURE for these bytes (96)."""
        return self.public + SigningKey(self.secret).sign(header_and_table).signature


def signature_fault(content: bytes, header_and_table: bytes) -> str:
    """Why a section SIGNATURE does not vouch for these bytes; empty where it does."""
    if len(content) != SIGNATURE_BYTES:
        return f"has {len(content)} bytes, expected {SIGNATURE_BYTES}"
    try:
        VerifyKey(content[:32]).verify(header_and_table, content[32:])
    except BadSignatureError:
        return "does not verify: the bundle was altered"
    return ""


def new_key(name: str) -> Key:
    """A key from the system's random numbers."""
    return Key(name, bytes(SigningKey.generate()))


def to_text(public: bytes) -> str:
    """A key as 44 characters of base64."""
    return base64.b64encode(public).decode()


def from_text(text: str) -> bytes | None:
    """The 32 bytes of a key in base64; None where it is none."""
    try:
        key = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        return None
    return key if len(key) == 32 and to_text(key) == text else None


def config_folder() -> Path:
    """Where this user's keys are: $HAPTICLOD_CONFIG, else $XDG_CONFIG_HOME/hapticlod, else ~/.config/hapticlod."""
    if chosen := os.environ.get("HAPTICLOD_CONFIG"):
        return Path(chosen)
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "hapticlod"


def own_key_path() -> Path:
    """The key that `hapticlod tune` signs with."""
    return config_folder() / "signing.key"


def save_key(path: Path, key: Key) -> Path:
    """Write a key pair: `path`, readable by its owner alone, and the public half beside it, whose path is returned.

    Raises:
        InputError: there is a key already, or the folder cannot be written.
    """
    public = path.with_suffix(".pub")
    if path.exists() or public.exists():
        raise InputError(str(path), "is there already", "move it away first: what it signed stays valid")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise InputError(str(path), f"cannot be written ({error.strerror})", "choose another folder") from error
    with os.fdopen(descriptor, "w") as file:
        file.write(f"{SECRET} {to_text(key.secret)} {key.name}\n")
        file.flush()
        os.fsync(file.fileno())
    write_atomic(public, key.public_line + "\n")
    return public


def load_key(path: Path) -> Key:
    """Read a secret key.

    Raises:
        InputError: it is missing, is no secret key, or others may read it.
    """
    try:
        mode = path.stat().st_mode
        words = path.read_text("utf-8", errors="replace").split()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", _NEW_KEY) from error
    if mode & 0o077:
        raise InputError(str(path), "can be read by others", f"chmod 600 {path}, and think about a new key")
    if words[:1] == [PUBLIC]:
        raise InputError(str(path), "is a public key", "signing needs the secret one beside it, without .pub")
    secret = from_text(words[1]) if len(words) == 3 and words[0] == SECRET else None
    if secret is None:
        raise InputError(str(path), "is no secret key", _NEW_KEY)
    return Key(words[2], secret)


def own_key() -> Key | None:
    """This user's signing key, where there is one.

    Raises:
        InputError: there is one that cannot be used.
    """
    return load_key(own_key_path()) if own_key_path().exists() else None
