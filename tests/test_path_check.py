"""The soak's judge objects to what is wrong and to nothing else, on ways whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from contact_shapes import plane, plate, sphere

from benchmarks.path_check import Crossings, Judge


def judge(mesh: tuple[np.ndarray, np.ndarray], radius_mm: float) -> Judge:
    return Judge(mesh[0].astype(np.float64), mesh[1], radius_mm, 1e-3)


def verdict(mesh: tuple[np.ndarray, np.ndarray], radius_mm: float, *way: tuple[float, float, float]) -> list[int]:
    scp = np.array(way, dtype=np.float64)
    return judge(mesh, radius_mm).through(scp, np.arange(1, len(scp))).tolist()


def test_a_way_through_a_sheet_is_found_and_one_round_its_border_is_not() -> None:
    sheet = plane(10.0, 20)
    assert verdict(sheet, 0.01, (0.1, 0.2, 1), (0.3, 0.1, 0.5), (0.3, 0.1, -0.5), (0.3, 0.1, -1)) == [2]
    assert verdict(sheet, 0.01, (9.9, 0, 0.5), (10.5, 0, 0.5), (10.5, 0, -0.5), (9.9, 0, -0.5)) == []


def test_a_way_in_and_out_again_is_none_through() -> None:
    ball = sphere(10.0, 3)
    assert verdict(ball, 0.01, (-12, 0.1, 0.2), (12, 0.1, 0.2)) == []  # a chord over the whole
    assert verdict(ball, 0.01, (-12, 0.1, 0.2), (0, 0.1, 0.2), (12, 0.1, 0.2)) == [1, 2]
    assert verdict(plate(0.3), 0.01, (0.11, 0.07, 0.4), (0.11, 0.07, -0.15), (0.11, 0.07, -0.6)) == [1, 2]


def test_a_ball_passes_no_sheet_by_short_steps_but_by_long_ones() -> None:
    sheet = plane(10.0, 20)
    assert verdict(sheet, 0.5, (0.1, 0.2, 0.5), (0.1, 0.2, -0.5)) == [1]
    assert verdict(sheet, 0.5, (0.1, 0.2, 0.5), (0.4, 0.2, 0.5)) == []
    assert judge(sheet, 0.5).least_clearance_mm(np.array([[0.1, 0.2, 0.6], [0.3, 0.1, 0.4]])) == pytest.approx(-0.1)


def test_crossings_equal_brute_force_on_triangles_of_many_sizes() -> None:
    rng = np.random.default_rng(3)
    corners = rng.normal(0.0, 5.0, (300, 1, 3)) + rng.normal(0.0, 1.0, (300, 3, 3)) * 10.0 ** rng.uniform(
        -2, 1, (300, 1, 1)
    )
    start, end = rng.normal(0.0, 6.0, (2, 200, 3))
    found = Crossings(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3)).count(start, end)
    expected = np.zeros(200, dtype=int)
    for a, b, c in corners:  # both ends on different sides of the plane, and the segment round every edge the same way
        normal = np.cross(b - a, c - a)
        sides = ((start - a) @ normal > 0) != ((end - a) @ normal > 0)
        turns = [
            np.einsum("ij,ij->i", np.cross(u - start, v - start), end - start) > 0 for u, v in ((a, b), (b, c), (c, a))
        ]
        expected += sides & ((turns[0] == turns[1]) & (turns[1] == turns[2]))
    assert found.sum() > 50 and np.array_equal(found, expected)
