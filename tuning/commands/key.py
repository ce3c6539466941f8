"""`hapticlod key`: the key that signs one's bundles, and whose bundles this machine's station takes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from rich.console import Console

from hapticlod.errors import InputError

if TYPE_CHECKING:
    from hapticlod.trust import TrustedKey

key_app = App(name="key", help="Keys: sign bundles, and say whose bundles to trust.", help_format="plaintext")


@key_app.command(name="new")
def new_command(
    *,
    name: str | None = None,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
) -> None:
    """Make a key. Without --output it becomes your own: `hapticlod tune` signs with it, and this machine trusts it.

    Parameters
    ----------
    name
        Whose key it is, one word. Default: user@machine.
    output
        Where the secret key goes; the public one is written beside it as .pub. Default: your configuration folder.
    """
    from hapticlod.first_key import make_own_key, user_at_machine
    from hapticlod.signature import new_key, own_key_path, save_key
    from hapticlod.trust import own_trust_file

    called = user_at_machine() if name is None else _one_word(name)
    if output is None:
        key = make_own_key(called)
    else:
        save_key(output, key := new_key(called))
    secret = output or own_key_path()
    out = Console(highlight=False, soft_wrap=True)
    out.print(f"{secret}: secret, keep it to yourself", markup=False)
    out.print(f"{secret.with_suffix('.pub')}: public, for `hapticlod key trust` on your stations", markup=False)
    if output is None:
        out.print(f"{own_trust_file()}: this machine trusts it now", markup=False)
    out.print(key.public_line, markup=False)


@key_app.command(name="show")
def show_command(key: Path | None = None, /) -> None:
    """Show your key's public line and whom this machine trusts.

    Parameters
    ----------
    key
        Another key file, secret or public: only its public line is shown.
    """
    from hapticlod.signature import load_key, own_key
    from hapticlod.trust import read_trusted_keys, standard_trust_files

    out = Console(highlight=False, soft_wrap=True)
    if key is not None:
        out.print(_given(str(key)).line if key.suffix == ".pub" else load_key(key).public_line, markup=False)
        return
    own = own_key()
    out.print(own.public_line if own else "no key of your own; make one with `hapticlod key new`", markup=False)
    for path in standard_trust_files():
        for entry in read_trusted_keys(path):
            out.print(f"{path}: {entry.line}{' (expired)' if entry.expired else ''}", markup=False)


@key_app.command(name="trust")
def trust_command(key: str, /, *, until: str | None = None, trusted_keys: Path | None = None) -> None:
    """Let this machine's station run bundles signed with a key.

    Parameters
    ----------
    key
        A public key file (.pub), or its line in quotes.
    until
        Last day (UTC) on which it is trusted, as 2027-01-31. Default: without end.
    trusted_keys
        The file to add it to, as /etc/hapticlod/trusted_keys. Default: your own.
    """
    from hapticlod.trust import TrustedKey, add_trusted_key, own_trust_file, parse_until

    given = _given(key)
    last = given.until if until is None else parse_until(f"until={until}", "--until")
    entry = TrustedKey(given.public, given.name, last)
    path = trusted_keys or own_trust_file()
    add_trusted_key(path, entry)
    Console(highlight=False, soft_wrap=True).print(f"{path}: {entry.line}", markup=False)


@key_app.command(name="sign")
def sign_command(
    bundle: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    key: Path | None = None,
) -> None:
    """Check a bundle and sign it.

    Parameters
    ----------
    bundle
        The bundle (.hlod).
    output
        Where the signed bundle goes. Default: in its place.
    key
        Secret key file. Default: your own.
    """
    from hapticlod.bundle import sign_bundle
    from hapticlod.signature import load_key, own_key_path

    with_key = load_key(key or own_key_path())
    sign_bundle(bundle, output or bundle, with_key)
    Console(highlight=False, soft_wrap=True).print(f"{output or bundle}: signed by {with_key.name}", markup=False)


def _given(key: str) -> TrustedKey:
    """The one key of a public key file or of its line."""
    from hapticlod.signature import PUBLIC
    from hapticlod.trust import parse_trusted_keys

    if key.startswith(f"{PUBLIC} "):
        found, where = parse_trusted_keys(key, "KEY"), "KEY"
    else:
        where = key
        try:
            found = parse_trusted_keys(Path(key).read_text("utf-8", errors="replace"), key)
        except OSError as error:
            raise InputError(key, f"cannot be read ({error.strerror})", "name a .pub file, or give its line") from error
    if len(found) != 1:
        raise InputError(where, f"holds {len(found)} keys", "give one key")
    return found[0]


def _one_word(name: str) -> str:
    if not re.fullmatch(r"[\w.@+-]{1,64}", name) or name.startswith("until="):
        raise InputError("--name", f"{name!r} is no name for a key", "letters, digits and .@+-_ up to 64")
    return name
