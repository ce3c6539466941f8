"""Contacts carried across levels of real and generated surfaces: two-sided mapping keeps them, the blend softens."""

from dataclasses import dataclass
from pathlib import Path

import contact_shapes as shapes
import numpy as np
import pytest
from contact_core import Core, point_or_ball

from hapticlod.ladder import build_ladder
from hapticlod.layout import MAPPED_HIT, MAPPED_MISS, MAPPING_PAPER, MAPPING_TWO_SIDED
from hapticlod.scan import load_scan, scan_from_arrays

CONTACT_LOST = 1 << 5


@dataclass
class Body:
    """Three levels about the scan's centre, the largest distance between them, and where and which way to press."""

    levels: list[shapes.Mesh]
    offset_mm: float
    points_mm: np.ndarray
    normals: np.ndarray


def body(scan, coarsest_ratio: float, margin_mm: float) -> Body:
    """Three rungs of a scan; pressed at faces whose middle is at least margin_mm from the bounding box's sides."""
    ladder = build_ladder(scan, rungs=3, coarsest_ratio=coarsest_ratio)
    levels = [((r.vertices - scan.centre_mm).astype(np.float32), r.faces) for r in ladder.rungs]
    corners = levels[0][0].astype(np.float64)[levels[0][1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    middle = corners.mean(axis=1)
    span = np.abs(corners).reshape(-1, 3).max(axis=0)
    inner = (np.abs(middle) <= span - margin_mm).sum(axis=1) >= 2
    return Body(levels, max(r.hausdorff_mm for r in ladder.rungs), middle[inner], normal[inner])


@pytest.fixture(scope="module")
def crop(data_dir: Path) -> Body:
    return body(load_scan(data_dir / "dirty" / "00_clean_crop_8k.ply"), 20.0, 1.5)


@pytest.fixture(scope="module")
def globe() -> Body:
    vertices, faces = shapes.sphere(10.0, 4)
    return body(scan_from_arrays(vertices.astype(np.float64), faces, "globe"), 20.0, -1.0)


def tool(name: str) -> np.ndarray:
    if name == "burr":
        rng = np.random.default_rng(1)
        return np.column_stack([rng.normal(size=(20, 3)) * 0.3, rng.uniform(0.05, 0.3, 20)])
    return point_or_ball(float(name))


def strokes(where: Body, balls: np.ndarray, ticks: int, seed: int) -> np.ndarray:
    """(ticks, 3) short strokes within the surface, slow and fast in turns, each begun afresh.

    A tick too far away to be a movement (kErrHipJump) stands between two strokes: a contact lost stays no one's.
    """
    rng = np.random.default_rng(seed)
    length = 60
    path = []
    for _ in range(ticks // length):
        i = rng.integers(len(where.points_mm))
        n = where.normals[i]
        reach = float((balls[:, :3] @ -n + balls[:, 3]).max())  # of the tool, toward the surface
        side = np.cross(n, rng.normal(size=3))
        side /= np.linalg.norm(side)
        along = np.cumsum(np.where((np.arange(length) // 6) % 2, 0.03, 0.003))
        depth = np.minimum(0.1 * np.arange(length) - 1.0, 0.3)
        path.append(np.full((1, 3), 1e3))
        path.append(where.points_mm[i] + n * (reach - depth)[:, None] + side * (along - 0.5)[:, None])
    return np.concatenate(path)


def switched(where: Body, name: str, mapping: int, blend_s: float = 0.0, ticks: int = 12_000) -> tuple:
    """Records, and which ticks switched in contact."""
    balls = tool(name)
    speeds = np.full(8, 1e9)
    speeds[:2] = [12.0, 24.0]
    margin = 1.5 * where.offset_mm + 0.05
    core = Core(
        where.levels, balls, 0.6, mapping=mapping, blend_s=blend_s, speeds_mm_s=speeds, hysteresis=0.05,
        l_in_mm=margin, l_out_mm=margin, closest_bound_mm=margin, filter_hz=120.0,
    )  # fmt: skip
    hip = strokes(where, balls, ticks, seed=3)
    rows = core.replay(hip)
    changed = np.zeros(len(rows), dtype=bool)
    changed[1:] = (np.diff(rows["level"].astype(int)) != 0) & (rows["contact"][:-1] == 1)
    jump = np.linalg.norm(np.diff(hip, axis=0, prepend=hip[:1]), axis=1) > 0.2
    changed &= ~jump & ~np.roll(jump, 1)
    return rows, changed


@pytest.mark.parametrize(
    ("shape", "name"),
    [
        ("globe", "0"),
        ("globe", "0.5"),
        ("globe", "burr"),
        ("crop", "0"),
        ("crop", "0.5"),
        ("crop", "burr"),
    ],
)
def test_two_sided_mapping_keeps_every_contact(shape: str, name: str, request: pytest.FixtureRequest) -> None:
    where = request.getfixturevalue(shape)
    rows, changed = switched(where, name, MAPPING_TWO_SIDED)
    assert changed.sum() > 3000
    assert (rows["mapping"][changed] == MAPPED_HIT).mean() > 0.9
    lost = changed & ((rows["mapping"] == MAPPED_MISS) | ((rows["errors"] & CONTACT_LOST) != 0))
    assert lost.sum() == 0


@pytest.mark.parametrize("shape", ["crop", "globe"])
def test_the_papers_mapping_misses(shape: str, request: pytest.FixtureRequest) -> None:
    """One-sided: where the new surface lies behind the old one the segment ends in the air."""
    rows, changed = switched(request.getfixturevalue(shape), "0", MAPPING_PAPER)
    missed = rows["mapping"][changed] == MAPPED_MISS
    assert changed.sum() > 300
    assert 0.3 < missed.mean() < 0.95
    # On a miss the SCP is kept, in front of the new surface: it drops onto it, and the contact is hardly ever gone.
    assert (rows["contact"][changed] == 0).mean() < 0.02


@pytest.mark.parametrize("name", ["0", "0.5", "burr"])
@pytest.mark.parametrize("shape", ["crop", "globe"])
def test_blend_takes_the_jump_away(shape: str, name: str, request: pytest.FixtureRequest) -> None:
    """Force step in the tick of a switch in contact, k = 1 N/mm: docs/contact.md has the numbers of this test."""
    where = request.getfixturevalue(shape)
    jumps = {}
    for blend_s in (0.0, 0.04):
        rows, changed = switched(where, name, MAPPING_TWO_SIDED, blend_s)
        step = np.linalg.norm(np.diff(rows["force_n"], axis=0, prepend=rows["force_n"][:1]), axis=1)
        jumps[blend_s] = 1e3 * step[changed & (rows["contact"] == 1)]
    bare, soft = jumps[0.0], jumps[0.04]
    figures = ", ".join(
        f"{label} {of(bare):.1f} -> {of(soft):.1f} mN (ratio {of(bare) / of(soft):.1f})"
        for label, of in [
            ("mean", np.mean),
            ("median", np.median),
            ("p90", lambda x: np.quantile(x, 0.9)),
            ("p99", lambda x: np.quantile(x, 0.99)),
        ]
    )
    said = f"{shape}, tool {name}: without -> with the blend, n = {len(bare)}, {len(soft)}: {figures}"
    assert len(bare) > 3000, said
    assert np.median(bare) > 5.0 * np.median(soft), said
    assert np.mean(bare) > 4.0 * np.mean(soft), said
    assert np.quantile(bare, 0.99) > 2.0 * np.quantile(soft, 0.99), said
