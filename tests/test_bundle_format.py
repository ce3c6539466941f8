"""Format 1 as docs/bundle.md states it, held against bytes that are kept: tests/golden/format_1.hlod.

What is read here is read by `struct` and `hashlib`, from the offsets in the document, not by HapticLOD. The file stays
readable for ever: when a format 2 comes, it gets a file of its own beside this one.
"""

import hashlib
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden_bundle import GOLDEN, golden_parts
from plate_bundle import TEST_KEY, run_station

from hapticlod.bundle import read_bundle, write_bundle
from hapticlod.bundle.write import container

FORMAT_1 = GOLDEN / "format_1.hlod"
OPTIONAL_TYPES = {18, 19, 20, 21, 22, 23, 24, 32, 33, 48}


def table(file: bytes) -> list[dict[str, Any]]:
    """The section table by the document's offsets."""
    (count,) = struct.unpack_from("<I", file, 12)
    rows = []
    for at in range(64, 64 + 64 * count, 64):
        kind, version, level, flags, offset, length = struct.unpack_from("<IIIIQQ", file, at)
        content = file[offset : offset + length]
        rows.append({"type": kind, "version": version, "level": level, "flags": flags, "offset": offset,
                     "length": length, "digest": file[at + 32 : at + 64], "content": content})  # fmt: skip
    return rows


def test_header_and_table_are_what_the_document_says() -> None:
    file = FORMAT_1.read_bytes()
    magic, version, count, file_bytes, table_offset = struct.unpack_from("<8sIIQQ", file)
    assert (magic, version, count, file_bytes, table_offset) == (b"\x89HLOD\r\n\x1a", 1, 26, len(file), 64)
    end = 64 + 64 * count
    assert file[32:64] == hashlib.blake2b(file[64:end], digest_size=32).digest()
    for row in table(file):
        assert row["offset"] == (end + 63) // 64 * 64 and not any(file[end : row["offset"]])
        end = row["offset"] + row["length"]
        signature = row["type"] == 48
        expected = bytes(32) if signature else hashlib.blake2b(row["content"], digest_size=32).digest()
        assert row["digest"] == expected
        assert (row["version"], row["flags"]) == (1, 1 if row["type"] in OPTIONAL_TYPES else 0)
    assert end == len(file)
    levels = [(kind, level) for level in (0, 1) for kind in range(16, 26)]
    expected = [(1, 0), (2, 0), (3, 0), *levels, (32, 0), (33, 0), (48, 0)]
    assert [(row["type"], row["level"]) for row in table(file)] == expected


def test_records_are_what_the_document_says() -> None:
    file = FORMAT_1.read_bytes()
    content = {(row["type"], row["level"]): row["content"] for row in table(file)}
    assert json.loads(content[1, 0])["tool"]["name"] == "three balls"
    config = content[2, 0]
    assert len(config) == 440
    assert struct.unpack_from("<6I", config) == (1, 2, 1, 0, 0, 0)  # version, levels, mapping, policy, shading, flags
    assert struct.unpack_from("<3d", config, 24) == (0.0, 0.0, 20.0)  # origin_mm
    assert struct.unpack_from("<3d", config, 48) == (1000.0, 800.0, 1.0)  # loop_hz, budget_us, stiffness_n_mm
    assert struct.unpack_from("<2I", config, 376) == (8, 2)  # triangles
    assert struct.unpack_from("<2I", config, 408) == (3, 1)  # balls
    assert struct.unpack_from("<4d", content[3, 0], 32) == (1.0, 0.0, 0.1, 0.3)  # the second ball
    assert len(content[16, 1]) == 4 * 12 and struct.unpack_from("<2f", content[16, 1]) == (-5.0, -5.0)
    assert struct.unpack("<6I", content[17, 1]) == (0, 1, 3, 0, 3, 2)
    assert struct.unpack("<6I", content[18, 1])[2] == 1  # across the diagonal
    header = struct.unpack_from("<d4I", content[20, 1])
    assert header[0] == 24.0
    assert (len(content[20, 1]), len(content[21, 1])) == (104, 4 * header[1])
    assert (len(content[22, 1]), len(content[23, 1])) == (24 * header[2], 4 * (header[3] + 1))
    assert len(content[24, 1]) == 320 * header[4]
    assert struct.unpack_from("<3f", content[25, 1]) == pytest.approx((0.5, 0.3, 0.2), rel=1e-7)
    assert (len(content[32, 0]), len(content[33, 0])) == (8 * 64, 8 * 144)
    assert struct.unpack_from("<d", content[32, 0], 64) == (0.001,)
    assert struct.unpack_from("<d", content[33, 0], 144) == (0.001,)


def test_the_signature_is_over_header_and_table() -> None:
    nacl = pytest.importorskip("nacl.signing")
    file = FORMAT_1.read_bytes()
    content = table(file)[-1]["content"]
    signed = file[: 64 + 64 * 26]
    assert content[:32] == TEST_KEY.public
    nacl.VerifyKey(content[:32]).verify(signed, content[32:])


def test_the_writer_still_gives_these_bytes(tmp_path: Path) -> None:
    file = FORMAT_1.read_bytes()
    rows = [(row["type"], row["level"], row["content"]) for row in table(file)[:-1]]
    assert container(rows, key=TEST_KEY) == file
    # Durable sections from their sources; acceleration and record may change with the runtime.
    # Vertices and motion come through numpy's sine, which is not the same to the last bit everywhere.
    write_bundle(tmp_path / "now.hlod", **golden_parts())
    now = {(row["type"], row["level"]): row["content"] for row in table((tmp_path / "now.hlod").read_bytes())}
    for kind, level, content in rows:
        if kind in (1, 2, 3, 17, 25):
            assert now[kind, level] == content, (kind, level)
        if kind in (16, 32):
            number = "<f4" if kind == 16 else "<f8"
            np.testing.assert_allclose(np.frombuffer(now[kind, level], number), np.frombuffer(content, number), 1e-6)


def test_both_readers_read_it() -> None:
    bundle, parts = read_bundle(FORMAT_1), golden_parts()
    assert bundle.signer == TEST_KEY.public
    assert bundle.config.tobytes() == parts["config"].tobytes()
    assert bundle.golden_record is not None and np.isfinite(bundle.golden_record["force_n"]).all()
    said = json.loads(run_station("inspect", FORMAT_1, "--json").stdout)
    assert said["manifest"] == bundle.manifest and said["config"]["stiffness_n_mm"] == 1.0
    words = ("--device", "sim", "--seconds", "0.1", "--virtual-time", "--json")
    assert run_station("run", FORMAT_1, *words).returncode == 0
