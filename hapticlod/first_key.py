"""A user's own key, made when it is first needed: what is tuned on a machine runs on that machine without a word."""

from __future__ import annotations

import getpass
import re
import socket

from hapticlod.errors import InputError
from hapticlod.signature import Key, new_key, own_key, own_key_path, save_key
from hapticlod.trust import TrustedKey, add_trusted_key, own_trust_file


def user_at_machine() -> str:
    """user@machine, in the letters that the name of a key may have."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user that the system has no name for
        user = "user"
    return re.sub(r"[^\w.@+-]", "-", f"{user}@{socket.gethostname()}", flags=re.ASCII)[:64]


def make_own_key(name: str) -> Key:
    """Make a key, keep it as this user's own, and let this machine's station trust it.

    Raises:
        InputError: there is one already, or the configuration folder cannot be written.
    """
    key = new_key(name)
    save_key(own_key_path(), key)
    add_trusted_key(own_trust_file(), TrustedKey(key.public, key.name))
    return key


def own_or_first_key() -> tuple[Key | None, str]:
    """This user's key, made now where there is none, and what to tell the user about it (empty: nothing).

    Raises:
        InputError: there is a key that cannot be used.
    """
    if (key := own_key()) is not None:
        return key, ""
    try:
        key = make_own_key(user_at_machine())
    except InputError as error:
        # Two first tunings at once: the other one's key will do.
        if own_key_path().exists():
            return own_key(), ""
        return None, f"the bundle will not be signed: {error}"
    return key, f"made your key {own_key_path()}: it signs your bundles, and this machine's station trusts it"
