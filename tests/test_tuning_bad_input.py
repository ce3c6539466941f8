"""Motions, ladders and levels that leave nothing to tune: a defined result, or one error that says what is wrong."""

from __future__ import annotations

import contact_shapes as shapes
import jax
import numpy as np
import pytest
from surrogate_cases import made_space

from hapticlod.errors import InputError
from hapticlod.motion import Motion
from hapticlod.scan import Scan, scan_from_arrays
from hapticlod.shipped import shipped_config
from hapticlod.station import load_station
from hapticlod.tool import ball
from tuning.prepare import Prepared, prepare
from tuning.search import Found, heads_of

RADIUS_MM = 10.0
STATION = load_station(shipped_config("stations/desktop_1khz.toml"))


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTICLOD_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def globe(subdivisions: int) -> Scan:
    vertices, faces = shapes.sphere(RADIUS_MM, subdivisions)
    return scan_from_arrays(vertices, faces)


def triangle() -> Scan:
    """Nothing of it can be collapsed."""
    corners = np.array([[-9.0, -9.0, RADIUS_MM], [9.0, -9.0, RADIUS_MM], [0.0, 12.0, RADIUS_MM]])
    return scan_from_arrays(corners, np.array([[0, 1, 2]]))


def held_at(height_mm: float, ticks: int = 200) -> Motion:
    """A ball of 1 mm that stays so high above the globe's top; negative: that deep in it."""
    place = np.tile([0.3, 0.2, RADIUS_MM + 1.0 + height_mm], (ticks, 1))
    return Motion(np.arange(ticks) / STATION.loop_hz, place, None, STATION.loop_hz, "held", {})


def prepared(scan: Scan, motion: Motion) -> Prepared:
    return prepare(scan, STATION, ball(1.0), [motion])


@pytest.mark.parametrize("one_rung", [True, False])
def test_a_hand_that_holds_still_on_the_scan_is_tuned_for(one_rung: bool) -> None:
    """Also on a scan of which there is no coarser rung: nothing is infinite or NaN, and one level can be had."""
    ready = prepared(triangle() if one_rung else globe(2), held_at(-0.5))
    assert (len(ready.data.grid.triangles) == 1) == one_rung
    for path, leaf in jax.tree_util.tree_leaves_with_path(ready.measured):
        assert np.isfinite(np.asarray(leaf, dtype=np.float64)).all(), jax.tree_util.keystr(path)
    assert ready.space.fits(1) and ready.space.fits(2) != one_rung
    low, high = ready.space.log_bounds
    assert np.isfinite(low).all() and np.all(low <= high)
    config = ready.space.config(np.full(ready.space.size, 0.5), 1)
    assert ready.space.config(ready.space.point(config), 1).levels[0].triangles == config.levels[0].triangles


def test_a_hand_that_never_touches_is_refused() -> None:
    with pytest.raises(InputError, match="motions: never touch the scan"):
        prepared(globe(1), held_at(0.7))


def test_a_hand_that_holds_still_far_away_is_refused() -> None:
    with pytest.raises(InputError, match="motion held: does not move"):
        prepared(globe(1), held_at(300.0))


def test_levels_that_come_out_alike_are_one() -> None:
    space = made_space()
    assert len(space.config(np.zeros(space.size), 3).levels) == 1


def test_what_is_not_finite_is_named() -> None:
    broken = {"felt_error_jnd": float("nan"), "discontinuity_per_s": 1.0, "loop_cost_p999_us": float("inf")}
    with pytest.raises(ArithmeticError, match="2 levels: not finite from any start: felt_error_jnd, loop_cost_p999_us"):
        heads_of([Found(np.zeros(3), float("nan"), 0.0, broken)] * 2, 2)
    good = Found(np.ones(3), 1.0, 0.0, {})
    assert heads_of([Found(np.zeros(3), float("nan"), 0.0, broken), good], 2) == [good]


def test_points_about_a_point_keep_order_and_bounds_and_leave_feel_nearly_alone() -> None:
    space = made_space()
    x = space.ordered(np.random.default_rng(1).random(space.size), 3)
    points = np.array(space.around(x, 3, 300, np.random.default_rng(2)))
    rows, limits = space.order_rows(3)
    assert points.min() >= 0.0 and points.max() <= 1.0
    assert (points @ rows.T <= limits + 1e-9).all()
    before, after = space.config(x, 3), [space.config(point, 3) for point in points]
    ratio = np.log([[b.cell_mm / a.cell_mm for a, b in zip(before.levels, c.levels, strict=False)][:1] for c in after])
    sizes = np.log([c.levels[0].triangles / before.levels[0].triangles for c in after])
    assert 0.1 < ratio.std() < 0.4 and 0.03 < sizes.std() < 0.15
    assert np.array_equal(points, space.around(x, 3, 300, np.random.default_rng(2)))
