"""Python's record layouts against the C++ ones: sizes from the module, offsets from a row written by the core."""

import re
from pathlib import Path

import numpy as np
import pytest

from hapticlod import _runtime, layout

HEADER = Path(__file__).resolve().parent.parent / "runtime" / "core" / "layout.hpp"
C_TYPES = {
    "double": "<f8",
    "float": "<f4",
    "std::uint8_t": "u1",
    "std::int32_t": "<i4",
    "std::uint32_t": "<u4",
    "std::uint64_t": "<u8",
}


def c_fields(struct: str) -> np.dtype:
    """The struct of layout.hpp as a dtype with the compiler's (natural) alignment."""
    text = HEADER.read_text(encoding="utf-8")
    body = re.search(rf"struct (?:alignas\(\d+\) )?{struct} \{{(.*?)\n\}};", text, re.S)
    assert body is not None
    sizes = {"kMaxLevels": layout.MAX_LEVELS}
    fields = []
    for line in body[1].splitlines():
        declaration = re.match(r"\s*([\w:]+) (.+?);", line)
        if declaration is None:
            continue
        for name in declaration[2].split(","):
            found = re.match(r"\s*(\w+)((?:\[\w+\])*)", name)
            assert found is not None
            shape = tuple(sizes[n] if n in sizes else int(n) for n in re.findall(r"\[(\w+)\]", found[2]))
            fields.append((found[1], C_TYPES[declaration[1]], shape))
    return np.dtype(fields, align=True)


@pytest.mark.parametrize(
    ("struct", "dtype", "size"),
    [
        ("ConfigData", layout.CONFIG_DTYPE, _runtime.CONFIG_SIZE),
        ("BallData", layout.BALL_DTYPE, _runtime.BALL_SIZE),
        ("TickRecord", layout.RECORD_DTYPE, _runtime.RECORD_SIZE),
        ("HashHeader", layout.HASH_DTYPE, _runtime.HASH_SIZE),
        ("Brick", layout.BRICK_DTYPE, _runtime.BRICK_SIZE),
        ("TriBlock", layout.BLOCK_DTYPE, _runtime.BLOCK_SIZE),
        ("BlockBound", layout.BOUND_DTYPE, _runtime.BOUND_SIZE),
        ("Material", layout.MATERIAL_DTYPE, _runtime.MATERIAL_SIZE),
    ],
)
def test_fields_and_sizes(struct: str, dtype: np.dtype, size: int) -> None:
    expected = c_fields(struct)
    assert dtype.itemsize == size == expected.itemsize
    assert dtype.names == expected.names
    assert dtype.fields is not None and expected.fields is not None
    assert dict(dtype.fields) == dict(expected.fields)  # type and offset of every field


def test_a_row_of_the_core_reads_as_it_should() -> None:
    config = np.zeros((), dtype=layout.CONFIG_DTYPE)
    config["version"] = config["level_count"] = 1
    config["origin_mm"] = [1.0, 2.0, 3.0]
    config["loop_hz"], config["stiffness_n_mm"], config["balls"] = 1000.0, 2.0, 1
    vertices = np.array([[-5, -5, 0], [5, -5, 0], [0, 5, 0]], dtype=np.float32)
    level = _runtime.Level(vertices, np.array([[0, 1, 2]], dtype=np.uint32), 1.0)
    renderer = _runtime.Renderer([level], config.tobytes(), np.zeros((1, 4)))
    time_s = np.array([0.25, 0.251, 0.252])
    hip = np.array([[1.0, 2.0, 3.5], [1.0, 2.0, 3.25], [1.0, 2.0, 2.5]])
    rows = np.frombuffer(renderer.replay(time_s, hip, None, 1), dtype=layout.RECORD_DTYPE)
    np.testing.assert_array_equal(rows["time_s"], time_s)
    np.testing.assert_allclose(rows["hip_mm"], hip, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows["scp_mm"][2], [1.0, 2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(rows["force_n"][2], [0.0, 0.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(rows["speed_mm_s"], [0.0, 250.0, 750.0], rtol=1e-6)
    assert rows["contact"].tolist() == [0, 0, 1]
    assert rows["constraints"].tolist() == [0, 0, 1]
    assert rows["iterations"].all()
    assert (rows["cost_ns"] > 0.0).all()


def test_error_names_are_the_bits_of_the_header() -> None:
    text = HEADER.read_text(encoding="utf-8")
    bits = re.findall(r"kErr(\w+) = 1u << (\d+)", text)
    names = [re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower() for name, _ in bits]
    assert [int(k) for _, k in bits] == list(range(len(bits)))
    assert tuple(names) == layout.TICK_ERRORS
