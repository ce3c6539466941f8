"""Signatures and trust: who signed a bundle, whom a station believes, and what is refused without a flag."""

import json
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plate_bundle import TEST_KEY, plate_parts, run_station

import tuning.cli
from hapticlod.bundle import read_bundle, sign_bundle, write_bundle
from hapticlod.bundle.format import SectionType
from hapticlod.bundle.structure import read_sections
from hapticlod.bundle.write import container
from hapticlod.errors import InputError
from hapticlod.first_key import own_or_first_key
from hapticlod.signature import Key, load_key, new_key, own_key, own_key_path, save_key
from hapticlod.trust import TrustedKey, add_trusted_key, judge_trust, parse_trusted_keys, read_trusted_keys

RUN = ("--device", "sim", "--seconds", "0.05", "--virtual-time", "--json")


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    return plate_parts(ticks=60)


@pytest.fixture
def bundle_path(parts: dict[str, Any], tmp_path: Path) -> Path:
    path = tmp_path / "plate.hlod"
    write_bundle(path, **parts)
    return path


def line_of(path: Path, *words: object) -> str:
    """What the station says when it refuses to run a bundle."""
    result = run_station("run", path, *RUN, *words)
    assert result.returncode == 2 and result.stdout == "" and len(result.stderr.splitlines()) == 1
    return result.stderr


def test_rfc_8032_vector() -> None:
    """TEST 2 of RFC 8032, section 7.1."""
    key = Key("rfc", bytes.fromhex("4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb"))
    assert key.public.hex() == "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c"
    assert key.signature(b"\x72")[32:].hex() == (
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da"
        "085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00"
    )
    assert "secret" not in repr(key) and key.secret.hex() not in repr(key)


def test_both_readers_know_the_signer(bundle_path: Path) -> None:
    bundle = read_bundle(bundle_path)
    assert bundle.signer == TEST_KEY.public
    assert bundle.sections[-1].type == SectionType.SIGNATURE and bundle.sections[-1].length == 96
    said = json.loads(run_station("inspect", bundle_path, "--json").stdout)
    assert f"ed25519 {said['signer']} tests" == TEST_KEY.public_line
    ran = json.loads(run_station("run", bundle_path, *RUN).stdout)
    assert ran["signature"] == "signed by tests, trusted" and ran["trusted"] is True


def test_signing_later_gives_the_same_file(parts: dict[str, Any], bundle_path: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.hlod"
    write_bundle(bare, **{**parts, "key": None})
    assert read_bundle(bare).signer is None
    sign_bundle(bare, tmp_path / "signed.hlod", TEST_KEY)
    assert (tmp_path / "signed.hlod").read_bytes() == bundle_path.read_bytes()
    other = new_key("other")
    sign_bundle(bundle_path, bundle_path, other)  # a second signature takes the first one's place
    assert read_bundle(bundle_path).signer == other.public


def test_unsigned_and_untrusted_bundles_need_the_flag_and_are_marked(bundle_path: Path, tmp_path: Path) -> None:
    stranger, bare = tmp_path / "stranger.hlod", tmp_path / "bare.hlod"
    sign_bundle(bundle_path, stranger, new_key("mallory"))
    sections = [s for s in read_bundle(bundle_path).sections if s.type != SectionType.SIGNATURE]
    file = bundle_path.read_bytes()
    bare.write_bytes(container([(s.type, s.level, file[s.offset : s.offset + s.length]) for s in sections]))
    for path, reason in ((bare, "is not signed; sign it"), (stranger, "is signed by a key that is not trusted here")):
        assert reason in line_of(path)
        result = run_station("run", path, *RUN, "--accept-unsigned")
        assert result.returncode == 0
        assert "run because of --accept-unsigned" in result.stderr
        said = json.loads(result.stdout)
        assert said["trusted"] is False and "trusted" not in said["signature"].split()[-1:]
    text = run_station("run", bare, *RUN[:-1], "--accept-unsigned").stdout
    assert "bundle not signed" in text


def test_trust_has_an_end(bundle_path: Path, tmp_path: Path) -> None:
    today = datetime.now(UTC).date()
    trusted = tmp_path / "keys"
    for days, fine in ((-1, False), (1, True)):
        add_trusted_key(trusted, TrustedKey(TEST_KEY.public, "tests", today + timedelta(days=days)))
        assert len(read_trusted_keys(trusted)) == 1  # the entry was replaced
        assert judge_trust(TEST_KEY.public, read_trusted_keys(trusted))[0] is fine
        if fine:
            assert run_station("run", bundle_path, *RUN, "--trusted-keys", trusted).returncode == 0
        else:
            assert "whose trust has expired" in line_of(bundle_path, "--trusted-keys", trusted)


def test_every_flipped_byte_of_a_signed_bundle_is_refused_by_the_signature(bundle_path: Path) -> None:
    """Digests made right again, as whoever alters a bundle would: header and table no longer match the signature."""
    file = np.fromfile(bundle_path, dtype=np.uint8)
    sections = read_sections(file, "memory")
    for place in [*range(8, 64 + 64 * len(sections), 37), *range(len(file) - 96, len(file))]:
        spoiled = file.copy()
        spoiled[place] ^= 0x01
        bundle_path.write_bytes(spoiled.tobytes())
        with pytest.raises(InputError):
            read_bundle(bundle_path)
        if place % 7 == 0:
            assert run_station("inspect", bundle_path).returncode == 2
    # One vertex moved by a hair, everything resealed, the old signature kept.
    contents = [(s.type, s.level, bytearray(file[s.offset : s.offset + s.length].tobytes())) for s in sections]
    next(data for kind, _, data in contents if kind == SectionType.MANIFEST)[-3] ^= 1
    bundle_path.write_bytes(container(contents))
    with pytest.raises(InputError, match="SIGNATURE: does not verify: the bundle was altered"):
        read_bundle(bundle_path)
    for words in ((), ("--accept-unsigned",)):  # no flag lets a wrong signature through
        assert "does not verify" in line_of(bundle_path, *words)


def test_a_signature_of_the_future_counts_as_none(parts: dict[str, Any], bundle_path: Path) -> None:
    file, sections = bundle_path.read_bytes(), read_bundle(bundle_path).sections
    contents = [(s.type, s.level, file[s.offset : s.offset + s.length]) for s in sections]
    bundle_path.write_bytes(container(contents, section_version={(SectionType.SIGNATURE, 0): 2}))
    assert read_bundle(bundle_path).signer is None
    assert "is not signed" in line_of(bundle_path)
    contents[-1] = (SectionType.SIGNATURE, 0, b"short")
    bundle_path.write_bytes(container(contents))
    with pytest.raises(InputError, match="has 5 bytes, expected 96"):
        read_bundle(bundle_path)
    assert "has 5 bytes, expected 96" in line_of(bundle_path)


GOOD = "A6EHv/POEL4dcN0Y50vAmWfk1jCbpQ1fHdyGZBJVMbg="


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("ed25519\n", ":1: has no key of 32 bytes in base64"),
        ("# ours\n\nrsa AAAA me\n", ":3: is no line of a trusted key"),
        (f"ed25519 {GOOD}\n", ":1: has no name"),
        (f"ed25519 {GOOD} until=2027-01-01\n", ":1: has no name"),
        (f"ed25519 {GOOD[:-2]} me\n", ":1: has no key"),
        (f"ed25519 {GOOD[:-4]}MQ== me\n", ":1: has no key"),  # 31 bytes
        (f"ed25519 {GOOD[:-2]}h= me\n", ":1: has no key"),  # bits beyond the last byte
        (f"ed25519 {GOOD}x me\n", ":1: has no key"),
        (f"ed25519 {GOOD} me until=2027-02-30\n", ":1: has something else"),
        (f"ed25519 {GOOD} me until=2027-2-3\n", ":1: has something else"),
        (f"ed25519 {GOOD} me forever\n", ":1: has something else"),
        (f"ed25519 {GOOD} me until=2027-01-01 more\n", ":1: has words too many"),
        (f"ed25519-secret {GOOD} me\n", ":1: is a secret key"),
    ],
)
def test_both_readers_of_trusted_keys_refuse_alike(
    bundle_path: Path, tmp_path: Path, content: str, reason: str
) -> None:
    path = tmp_path / "keys"
    path.write_text(content)
    path.chmod(0o644)
    with pytest.raises(InputError) as caught:
        read_trusted_keys(path)
    assert reason in str(caught.value)
    assert reason in line_of(bundle_path, "--trusted-keys", path)


def test_a_trust_file_that_others_can_write_is_refused(bundle_path: Path, tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(TEST_KEY.public_line + "\r\n")  # a Windows line end is no fault
    path.chmod(0o644)
    assert parse_trusted_keys(path.read_text(), "x")[0].public == TEST_KEY.public
    assert run_station("run", bundle_path, *RUN, "--trusted-keys", path).returncode == 0
    path.chmod(0o664)
    with pytest.raises(InputError, match="can be written by others"):
        read_trusted_keys(path)
    assert "can be written by others" in line_of(bundle_path, "--trusted-keys", path)
    assert "cannot be opened" in line_of(bundle_path, "--trusted-keys", tmp_path / "missing")
    path.chmod(0o644)
    path.write_text("")
    assert "not trusted here" in line_of(bundle_path, "--trusted-keys", path)


class TestFirstKey:
    """What the first tuning makes, so that what was tuned here runs here."""

    def test_it_is_made_once_and_trusted(
        self, bundle_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("HAPTICLOD_CONFIG", str(tmp_path / "config"))
        key, said = own_or_first_key()
        assert key is not None and str(own_key_path()) in said
        assert own_or_first_key() == (key, "")
        sign_bundle(bundle_path, bundle_path, key)
        assert run_station("run", bundle_path, *RUN).returncode == 0

    def test_without_a_place_for_it_bundles_are_not_signed(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (tmp_path / "file").write_text("no folder")
        monkeypatch.setenv("HAPTICLOD_CONFIG", str(tmp_path / "file" / "config"))
        key, said = own_or_first_key()
        assert key is None and said.startswith("the bundle will not be signed")


class TestCommands:
    """`hapticlod key`."""

    @pytest.fixture(autouse=True)
    def folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.setenv("HAPTICLOD_CONFIG", str(tmp_path / "config"))
        return tmp_path / "config"

    @staticmethod
    def say(capsys: pytest.CaptureFixture[str], *words: object, status: int = 0) -> str:
        assert tuning.cli.run(["key", *(str(word) for word in words)]) == status
        shown = capsys.readouterr()
        assert "Traceback" not in shown.err
        return shown.out if status == 0 else shown.err

    def test_a_new_user_signs_and_runs(
        self, bundle_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert "not trusted here" in line_of(bundle_path)  # this user's folder is empty
        assert "no key of your own" in self.say(capsys, "show")
        assert "hapticlod key new" in self.say(capsys, "sign", bundle_path, status=2)
        line = self.say(capsys, "new", "--name", "me").splitlines()[-1]
        assert self.say(capsys, "show").splitlines()[0] == line
        assert (folder / "signing.key").stat().st_mode & 0o777 == 0o600
        assert "is there already" in self.say(capsys, "new", status=2)
        key = own_key()
        assert key is not None and key.public_line == line
        assert "signed by me" in self.say(capsys, "sign", bundle_path)
        assert read_bundle(bundle_path).signer == key.public
        assert run_station("run", bundle_path, *RUN).returncode == 0

    def test_trust_somebody_else(self, bundle_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        save_key(tmp_path / "other.key", new_key("other"))
        self.say(capsys, "sign", bundle_path, "--key", tmp_path / "other.key")
        assert "not trusted" in line_of(bundle_path)
        self.say(capsys, "trust", tmp_path / "other.pub", "--until", "2001-01-01")
        assert "whose trust has expired" in line_of(bundle_path)
        assert "(expired)" in self.say(capsys, "show")
        line = self.say(capsys, "show", tmp_path / "other.pub").strip()
        self.say(capsys, "trust", line)
        assert run_station("run", bundle_path, *RUN).returncode == 0

    @pytest.mark.parametrize(
        ("words", "reason"),
        [
            (["new", "--name", "two words"], "--name: 'two words' is no name"),
            (["new", "-o", "/nonexistent/folder/x.key"], "cannot be written"),
            (["trust", "missing.pub"], "missing.pub: cannot be read"),
            (["trust", "ed25519 short me"], "KEY:1: has no key of 32 bytes"),
            (["trust", f"ed25519 {GOOD} me", "--until", "soon"], "--until: has something else"),
            (["sign", "missing.hlod"], "signing.key: cannot be read"),
            (["show", "missing.key"], "missing.key: cannot be read"),
        ],
    )
    def test_bad_input(self, words: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
        if os.geteuid() == 0 and "/nonexistent/folder/x.key" in words:
            words = ["new", "-o", "/dev/null/x.key"]  # root may write anywhere else
        assert reason in self.say(capsys, *words, status=2)

    def test_secret_keys_are_kept(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        save_key(tmp_path / "a.key", new_key("a"))
        (tmp_path / "a.key").chmod(0o640)
        with pytest.raises(InputError, match="can be read by others"):
            load_key(tmp_path / "a.key")
        (tmp_path / "b.key").write_text((tmp_path / "a.pub").read_text())
        (tmp_path / "b.key").chmod(0o600)
        with pytest.raises(InputError, match="is a public key"):
            load_key(tmp_path / "b.key")
        assert "is a secret key" in self.say(capsys, "trust", tmp_path / "a.key", status=2)
