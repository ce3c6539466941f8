"""One ball on one plane is solved by short ways (runtime/core/sole_plane.cpp, glide.cpp): they must say what the
general way says.

A tool of two balls in the same place is the same tool, and more than one ball always goes the general way.
"""

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

SAME_MM = 1e-3  # 1 um, the tolerance of the contact definition


def hills(height_mm: float) -> shapes.Mesh:
    """A noisy height field: faces, creases and ridges."""
    rng = np.random.default_rng(7)
    return shapes.height_field(lambda x, y: height_mm * rng.normal(size=np.shape(x)), half_mm=6.0, cells=40)


MESHES = {
    "sphere": shapes.sphere(10.0, 5),
    "plane": shapes.plane(cells=60),
    "fine noise": hills(0.002),
    "rough noise": hills(0.1),
    "cracked plane": shapes.cracked_plane(0.05),
    "plate": shapes.plate(),
}


@pytest.mark.parametrize("radius_mm", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("speed_mm_s", [30.0, 300.0])
@pytest.mark.parametrize("name", MESHES)
def test_one_ball_is_two_balls_in_one_place(name: str, speed_mm_s: float, radius_mm: float) -> None:
    mesh = MESHES[name]
    rng = np.random.default_rng(11)
    top = 10.0 if name == "sphere" else 0.0
    across = rng.uniform(-3.0, 3.0, (40, 2))
    level = np.sqrt(np.maximum(top**2 - (across**2).sum(axis=1), 0.0)) if name == "sphere" else 0.0
    depth = rng.uniform(-0.6, 0.2, 40)
    anchors = np.column_stack([across, level + depth + radius_mm])
    anchors[0, 2] += 3.0
    hip = shapes.wander(anchors, speed_mm_s, 1500 if speed_mm_s < 100.0 else 600)
    ball = point_or_ball(radius_mm)
    crack_mm = 0.06 if name == "cracked plane" else 0.0
    short = Core([mesh], ball, crack_mm=crack_mm).replay(hip)
    general = Core([mesh], np.repeat(ball, 2, axis=0), crack_mm=crack_mm).replay(hip)
    touching = (short["contact"] == 1) & (general["contact"] == 1)
    assert touching.sum() > 100
    apart_mm = np.linalg.norm(short["scp_mm"] - general["scp_mm"], axis=1)
    same = (apart_mm < SAME_MM) & (short["contact"] == general["contact"])
    # Two minima that are equally near may be told apart by the last bit; a step later the two are together again.
    assert np.mean(~same) < 2e-3, f"{np.sum(~same)} of {len(hip)} ticks differ by up to {apart_mm.max()} mm"
    assert short["errors"].max() == general["errors"].max()
    if name in ("plane", "plate"):  # and the short way was the one that was taken
        assert short["tests"][touching].mean() < 0.5 * general["tests"][touching].mean()
    if name in ("plane", "sphere") and radius_mm == 0.0:  # nor was anything listed for it
        assert short["balls"][touching].mean() < 0.1 * general["balls"][touching].mean()
