"""Small parts of a scan leave the ladder by size, and what stands for them is near."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from hapticlod.ladder import Ladder, build_ladder
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.topology import vertex_components


def bodies(*placed: tuple[float, tuple[float, float, float], int]) -> Scan:
    """Icospheres (radius mm, centre, subdivisions) in one scan."""
    vertices, faces, count = [], [], 0
    for radius, centre, subdivisions in placed:
        ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
        vertices.append(ball.vertices + np.array(centre))
        faces.append(ball.faces + count)
        count += len(ball.vertices)
    return scan_from_arrays(np.concatenate(vertices), np.concatenate(faces), "bodies")


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    """A large ball, one of a quarter of its size, and thirty specks of 80 triangles around them."""
    rng = np.random.default_rng(2)
    places = rng.normal(size=(30, 3))
    places *= 30.0 / np.linalg.norm(places, axis=1, keepdims=True)
    specks = [(0.6, tuple(place), 1) for place in places]
    return build_ladder(bodies((20.0, (0, 0, 0), 4), (5.0, (60.0, 0, 0), 3), *specks), rungs=10)


def parts_by_size(ladder: Ladder, rung: int) -> tuple[int, int, int]:
    """How many large, middle and small parts a rung has, by the diagonal of their boxes."""
    mesh = ladder.rungs[rung]
    count, part = vertex_components(mesh.faces, len(mesh.vertices))
    sizes = [
        float(np.linalg.norm(np.ptp(mesh.vertices[mesh.faces[part == p]].reshape(-1, 3), axis=0))) for p in range(count)
    ]
    return sum(s > 50 for s in sizes), sum(3 < s <= 50 for s in sizes), sum(s <= 3 for s in sizes)


def test_a_part_is_there_while_it_is_larger_than_an_edge(ladder: Ladder) -> None:
    area = ladder.rungs[0].area_mm2
    for number, rung in enumerate(ladder.rungs):
        edge = np.sqrt(4 / np.sqrt(3) * area / rung.triangles)
        large, middle, small = parts_by_size(ladder, number)
        assert large == 1
        if edge < 2.0 or number == 0:  # specks have a diagonal of 2.08 mm
            assert (middle, small) == (1, 30)
        elif 2.6 < edge < 16:  # the other ball has one of 17.3 mm
            assert (middle, small) == (1, 0)
        elif edge > 18:
            assert (middle, small) == (0, 0)
    assert len(ladder.rungs) == 10
    assert any("of 32 parts the coarsest rung has 1" in note for note in ladder.notes)


def test_counts_are_met_although_specks_cannot_collapse(ladder: Ladder) -> None:
    for rung in ladder.rungs[:-1]:
        assert rung.asked - 80 <= rung.triangles <= rung.asked  # a speck goes as a whole
    for asked in (3000, 1000, 300):
        rung = ladder.at(asked)
        assert asked - 80 <= rung.triangles <= asked
        used = np.zeros(len(rung.vertices), dtype=bool)
        used[rung.faces.ravel()] = True
        assert used[rung.vertex_map].all()  # nothing of the scan stands for itself without a face


def test_rungs_stay_nested_and_measured_when_parts_go(ladder: Ladder) -> None:
    for fine, coarse in zip(ladder.rungs, ladder.rungs[1:], strict=False):
        image = np.full(len(fine.vertices), -1)
        image[fine.vertex_map] = coarse.vertex_map
        assert np.array_equal(image[fine.vertex_map], coarse.vertex_map)
    gone = [rung for number, rung in enumerate(ladder.rungs) if parts_by_size(ladder, number)[2] == 0]
    assert gone and all(rung.hausdorff_mm > 5.0 for rung in gone)  # specks were 10 mm off the ball
    assert all(0.5 < rung.area_mm2 / ladder.rungs[0].area_mm2 < 1.01 for rung in ladder.rungs)


def test_a_scan_of_loose_triangles_has_a_ladder() -> None:
    rng = np.random.default_rng(1)
    corners = rng.uniform(-100, 100, (3000, 1, 3)) + rng.uniform(-0.5, 0.5, (3000, 3, 3))
    ladder = build_ladder(scan_from_arrays(corners.reshape(-1, 3), np.arange(9000).reshape(-1, 3)), rungs=4)
    assert [rung.triangles for rung in ladder.rungs] == [3000, 448, 67, 10]


def test_the_largest_part_stays_whatever_is_asked() -> None:
    ladder = build_ladder(bodies((10.0, (0, 0, 0), 2), (1.0, (20.0, 0, 0), 1)), rungs=3, coarsest_ratio=400)
    coarsest = ladder.at(1)
    assert coarsest.triangles >= 4
    assert np.linalg.norm(np.ptp(coarsest.vertices[coarsest.faces].reshape(-1, 3), axis=0)) > 15


def test_a_largest_part_that_collapses_entirely_leaves_the_next_one() -> None:
    """A needle of one triangle, longer than all else, which simplification takes first."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    needle = np.array([[0, 0, 50.0], [0.001, 0, 250.0], [0, 0.5, 150.0]])
    scan = scan_from_arrays(
        np.concatenate((ball.vertices, needle)), np.concatenate((ball.faces, [[162, 163, 164]])), "needle"
    )
    ladder = build_ladder(scan, rungs=4, coarsest_ratio=40)
    for rung in ladder.rungs:
        assert rung.triangles >= 4 and rung.components >= 1
