"""No rung is handed out unchecked: each test breaks one thing on purpose, and fails if the check were not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import hapticlod.ladder
from hapticlod.collapse import CollapseList
from hapticlod.collapse import collapse as true_collapse
from hapticlod.deviation import Deviation, ScanSurface
from hapticlod.ladder import build_ladder
from hapticlod.orientation import signed_volumes
from hapticlod.rung_check import UnsoundRung
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.topology import edge_table


@pytest.fixture(scope="module")
def ball() -> Scan:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    return scan_from_arrays(mesh.vertices, mesh.faces, "ball")


def with_collapses(patch: pytest.MonkeyPatch, change) -> None:
    """Let simplification answer with a list that `change` has spoilt."""
    patch.setattr(hapticlod.ladder, "collapse", lambda *args: change(true_collapse(*args)))


def mirrored_from(step: int):
    """Vertices that collapses from some step on keep lie on the other side of the ball."""

    def change(made: CollapseList) -> CollapseList:
        place = made.position.copy()
        place[step:] *= -1.0
        return replace(made, position=place)

    return change


def test_a_rung_at_infinity_ends_the_ladder(ball: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(made: CollapseList) -> CollapseList:
        place = made.position.copy()
        place[-1] = np.inf
        return replace(made, position=place)

    with_collapses(monkeypatch, change)
    ladder = build_ladder(ball, rungs=5, coarsest_ratio=100)
    assert len(ladder.rungs) == 4
    assert "the next one has a vertex at infinity" in ladder.notes[0]
    assert ladder.at(1).triangles == ladder.rungs[-1].triangles  # nor can it be asked for by its size


def test_a_rung_turned_inside_out_ends_the_ladder(ball: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    with_collapses(monkeypatch, mirrored_from(400))
    ladder = build_ladder(ball, rungs=5, coarsest_ratio=100)
    assert 1 <= len(ladder.rungs) < 5 and "turned inside out" in ladder.notes[0]
    for rung in ladder.rungs:
        assert rung.hausdorff_mm < 2.0
        a, b, c = (rung.vertices[rung.faces[:, k]] for k in range(3))
        assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0).all()


def test_between_sound_rungs_an_unsound_one_is_not_handed_out(ball: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    def change(made: CollapseList) -> CollapseList:
        """One vertex is at infinity for a while."""
        place = made.position.copy()
        again = np.flatnonzero(np.isin(made.kept[200:260], made.kept[260:]))[0] + 200
        place[again] = np.nan
        return replace(made, position=place)

    with_collapses(monkeypatch, change)
    ladder = build_ladder(ball, rungs=2, coarsest_ratio=10)
    assert len(ladder.rungs) == 2
    with pytest.raises(UnsoundRung, match="infinity"):
        for count in range(900, 700, -2):
            ladder.at(count)


def test_a_distance_that_was_measured_too_small_is_raised(ball: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = build_ladder(ball, rungs=2, coarsest_ratio=50).rungs[1].deviation
    monkeypatch.setattr(ScanSurface, "deviation", lambda *args: Deviation(truth.rms_mm, 0.0, 0.0))
    found = build_ladder(ball, rungs=2, coarsest_ratio=50).rungs[1].deviation
    assert 0.8 * truth.hausdorff_mm < found.hausdorff_mm <= 1.01 * truth.hausdorff_mm


@pytest.mark.parametrize("thickness_mm", [0.2, 0.02])
def test_a_thin_plate_keeps_its_sides(thickness_mm: float) -> None:
    """A closed plate, 30 mm wide and bent, simplified until its edges are a hundred times its thickness."""
    axis = np.linspace(-15, 15, 41)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 2.0 * np.sin(x / 5.0) * np.cos(y / 6.0)
    top = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    at = np.arange(len(top)).reshape(41, 41)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    upper = np.concatenate((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    rim = edge_table(upper).boundary
    count = len(top)
    walls = np.concatenate(
        (
            np.column_stack((rim[:, 1], rim[:, 0], rim[:, 0] + count)),
            np.column_stack((rim[:, 1], rim[:, 0] + count, rim[:, 1] + count)),
        )
    )
    vertices = np.concatenate((top, top - [0, 0, thickness_mm]))
    scan = scan_from_arrays(vertices, np.concatenate((upper, upper[:, ::-1] + count, walls)), "plate")
    assert scan.report.closed_components == 1
    ladder = build_ladder(scan, rungs=6, coarsest_ratio=60)
    assert len(ladder.rungs) >= (4 if thickness_mm > 0.1 else 2)
    for rung in ladder.rungs:
        (volume,) = signed_volumes(rung.vertices, rung.faces, np.zeros(rung.triangles, int), 1)
        assert volume > 0.0
        assert rung.area_mm2 > 0.8 * ladder.rungs[0].area_mm2
