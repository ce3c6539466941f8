"""Hands with a ball go where the ball can: not into gaps, and out of them on the far side."""

import numpy as np
import pytest
from motion_shapes import Mesh, plate

from hapticlod import _runtime
from hapticlod.config import Level, LodConfig
from hapticlod.motion import synthesise
from hapticlod.motion.roll import roll
from hapticlod.motion.strokes import Mode
from hapticlod.motion.surface import Surface
from hapticlod.motion.walk import start_on
from hapticlod.replay import DEFAULT_STATION, Record, replay_levels
from hapticlod.tool import Tool, ball

_CELL_MM = 0.5


def cup(bore_mm: float, wall_mm: float = 0.4, height_mm: float = 5.0) -> Mesh:
    """A closed thin shell: a cup along z, open at the top, whose bore has the radius `bore_mm`."""
    import trimesh

    outer_mm = bore_mm + wall_mm
    profile = [(0.0, 0.0), (outer_mm, 0.0), (outer_mm, height_mm), (bore_mm, height_mm), (bore_mm, wall_mm)]
    made = trimesh.creation.revolve(np.array([*profile, (0.0, wall_mm)]), sections=48)
    made.merge_vertices()
    return Mesh(np.array(made.vertices), np.array(made.faces))


def replayed(mesh: Mesh, tool: Tool, mode: Mode, seed: int) -> Record:
    """A hand of at most 1 N on 1 N/mm, 4 s long, in the runtime."""
    motion = synthesise(mesh, mode, seconds=4.0, loop_hz=1000.0, seed=seed, tool=tool, max_force_n=1.0)
    level = _runtime.Level(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), _CELL_MM)
    config = LodConfig(levels=(Level(triangles=len(mesh.faces), cell_mm=_CELL_MM, balls=1),))
    return replay_levels([level], config, np.zeros(3), motion, tool, DEFAULT_STATION, 1, cut_short=False)


def test_a_hand_presses_as_its_force_asks_on_a_cup_that_the_ball_does_not_fit_into() -> None:
    """At most 1 mm, tremor and cut corners. In 6 % of the contact it was more, up to 4.4 mm: hands walked down the
    bore, and the contact point stayed at the rim. What is left are edges passed slowly (D58)."""
    mesh, tool = cup(bore_mm=0.8), ball(1.0)
    records = [replayed(mesh, tool, mode, seed) for mode in ("trace", "transfer") for seed in range(2)]
    depth = np.concatenate([np.linalg.norm(r.scp - r.hip, axis=1)[r.contact] for r in records])
    assert np.mean(depth > 1.25) < 0.01
    assert all(record.contact.mean() > 0.4 for record in records)


def test_a_ball_rolls_down_a_bore_that_it_fits_into_and_up_again() -> None:
    mesh, radius_mm = cup(bore_mm=1.5), 0.5
    surface = Surface(mesh)
    start = np.array([0.0, 0.0, 0.4 + radius_mm])
    way = roll(surface, start, np.array([1.0, 0.0, 0.0]), 20.0, 0.05, lambda _: 0.0, radius_mm)
    assert way.walked_mm[-1] == pytest.approx(20.0, abs=0.1)
    assert surface.clearance_mm(way.points_mm).min() > 0.97 * radius_mm
    out = np.linalg.norm(way.points_mm[:, :2], axis=1)
    assert way.points_mm[:, 2].max() > 5.4 and out.max() > 2.2  # up the wall, over the rim, down the outside
    assert np.abs(way.points_mm[:, 1]).max() < 0.3  # straight on all the way


def test_a_ball_turns_round_where_a_wedge_closes() -> None:
    """Two plates of 30 mm that lean towards each other by 20 degrees: a ball of 1 mm fits in up to 5.7 mm."""
    sheet = plate(30.0, 60)
    x, y, _ = sheet.vertices.T
    lean = np.radians(10.0)
    along, up = (x + 15.0) * np.cos(lean), (x + 15.0) * np.sin(lean)
    upper, lower = np.column_stack([along, y, up]), np.column_stack([along, y, -up])
    wedge = Mesh(np.vstack([upper, lower]), np.vstack([sheet.faces[:, ::-1], sheet.faces + len(sheet.vertices)]))
    surface = Surface(wedge)
    reach_mm = 1.0 / np.sin(lean)
    start = np.array([12.0, 0.0, -12.0 * np.tan(lean) + 1.0 / np.cos(lean)])
    way = roll(surface, start, np.array([-1.0, 0.0, 0.0]), 40.0, 0.1, lambda _: 0.0, 1.0)
    assert reach_mm - 0.2 < way.points_mm[:, 0].min() < reach_mm + 0.2
    assert surface.clearance_mm(way.points_mm).min() > 0.97
    assert way.walked_mm[-1] == pytest.approx(40.0, abs=0.2)


def test_a_ball_begins_where_it_fits() -> None:
    """Half of this surface is a slit of 1 mm between two plates."""
    sheet = plate(30.0, 30)
    apart = np.array([0.0, 0.0, 0.5])
    n = len(sheet.vertices)
    faces = np.vstack([sheet.faces[:, ::-1], sheet.faces + n, sheet.faces + 2 * n, sheet.faces + 3 * n])
    places = [sheet.vertices + apart, sheet.vertices - apart, sheet.vertices + 9.0, sheet.vertices + [9.0, 9.0, 20.0]]
    surface, rng = Surface(Mesh(np.vstack(places), faces)), np.random.default_rng(0)
    begun = np.array([start_on(surface, rng, 1.0)[0] for _ in range(20)])
    assert surface.clearance_mm(begun).min() > 0.97


def test_a_ball_that_fits_nowhere_still_makes_a_hand() -> None:
    """A slit of 1 mm between two plates that face each other: there is no place for a ball of 1 mm."""
    sheet = plate(20.0, 20)
    apart = np.array([0.0, 0.0, 0.5])
    faces = np.vstack([sheet.faces[:, ::-1], sheet.faces + len(sheet.vertices)])
    slit = Mesh(np.vstack([sheet.vertices + apart, sheet.vertices - apart]), faces)
    for mode in ("trace", "transfer"):
        motion = synthesise(slit, mode, seconds=2.0, loop_hz=1000.0, seed=0, tool=ball(1.0))
        assert np.isfinite(motion.position_mm).all() and np.abs(motion.position_mm[:, 2]).max() < 4.0
