"""Small parts of a scan: until which rung each is kept. Collapsing edges never removes a closed part entirely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from hapticlod.material import face_areas
from hapticlod.topology import vertex_components

_ROUNDS = 50  # islands that go make the others' turn come sooner: so often they are asked again at most


@dataclass(frozen=True, eq=False)
class Islands:
    """The parts of a mesh, for every vertex of it (n,) and every face (m,).

    The rule: parts go smallest first, each when its box's diagonal is less than the mean edge, which is that of as many
    equilateral triangles over the scan's area. The part with the largest diagonal always stays.

    Attributes:
        of_vertex, of_face: (n,) and (m,) int, the part of each.
        fewest: (p,) float64, the least number of triangles of a rung that a part is in; 0: it stays.
    """

    of_vertex: np.ndarray
    of_face: np.ndarray
    fewest: np.ndarray


@dataclass(frozen=True, eq=False)
class Collapses:
    """A list of collapses in the making: see CollapseList. `final` (n, 3): where every vertex is in the end."""

    parent: np.ndarray
    step: np.ndarray
    death: np.ndarray
    kept: np.ndarray
    place: np.ndarray
    final: np.ndarray


def find_islands(vertices: np.ndarray, faces: np.ndarray, joined: np.ndarray) -> Islands | None:
    """The parts of a mesh, or None where it is in one part.

    Args:
        vertices: (n, 3) float64. faces: (m, 3) int. joined: (j, 3) int, faces that say what belongs together.
    """
    parts, part = vertex_components(joined, len(vertices))
    if parts < 2:
        return None
    of_vertex = np.full(len(vertices), -1)
    of_vertex[joined.ravel()] = np.repeat(part, 3)
    of_face = of_vertex[faces[:, 0]]
    low, high = np.full((parts, 3), np.inf), np.full((parts, 3), -np.inf)
    order = np.argsort(of_face, kind="stable")
    present, start = np.unique(of_face[order], return_index=True)
    corners = vertices[faces[order]]
    low[present] = np.minimum.reduceat(corners.min(axis=1), start)
    high[present] = np.maximum.reduceat(corners.max(axis=1), start)
    extent = np.linalg.norm(np.where(np.isfinite(low), high - low, 0.0), axis=1)
    area = float(face_areas(vertices, faces).sum())
    fewest = 4.0 / np.sqrt(3.0) * area / np.maximum(extent, 1e-12 * extent.max()) ** 2
    fewest[int(extent.argmax())] = 0.0
    return Islands(of_vertex, of_face, fewest)


def drop_islands(islands: Islands, faces: np.ndarray, target: int, collapses: Collapses) -> Collapses:
    """Let every island go when its time has come, smallest first, each by a collapse of its own that moves nothing.

    What it leaves becomes part of the nearest vertex that stays to the end, so that rungs remain nested. Where the
    simplifier ended above `target` triangles, the islands that the rule allows go after its last collapse.

    Args:
        faces: (m, 3) of the mesh. target: triangles of the coarsest rung.
    """
    going = np.argsort(-islands.fewest, kind="stable")
    parent, step, death = collapses.parent.copy(), collapses.step, collapses.death
    last = len(collapses.kept)
    # The simplifier may have left nothing of the largest part: then the largest that it left something of stays.
    in_the_end = np.bincount(islands.of_face[death > last], minlength=len(islands.fewest))
    largest = int(np.where(in_the_end > 0, islands.fewest, np.inf).argmin())
    going = going[(islands.fewest[going] > target) & (going != largest)]
    fewest = islands.fewest[going]
    # Each goes after so many collapses: the first number that leaves fewer triangles than it needs.
    after = np.full(len(islands.fewest), last + 1)
    for _ in range(_ROUNDS):
        left = len(death) - np.cumsum(
            np.bincount(np.minimum(death, after[islands.of_face]), minlength=last + 2)[: last + 1]
        )
        due = np.maximum.accumulate(np.searchsorted(-left, -fewest, side="right"))
        if np.array_equal(due, after[going]):
            break
        after[going] = np.minimum(due, after[going])
    # Those that never come due leave in the end, as long as there are too many triangles.
    still = in_the_end[going] * (after[going] > last)
    too_many = int(left[-1]) - target
    go = (after[going] <= last) | ((still > 0) & (np.cumsum(still) - still < too_many))
    going = going[go]
    if len(going) == 0:
        return collapses
    after[:] = last + 1  # of those that stay: later than anything
    due = np.minimum(due[go], last)
    after[going] = due
    number = due + 1 + np.arange(len(going))  # of each island's own collapse, among all
    never = last + len(going) + 1
    renumbered = np.append(np.arange(last + 1) + np.searchsorted(due, np.arange(last + 1), side="left"), never)
    leaves = np.full(len(islands.fewest), never)
    leaves[going] = number
    step, death = renumbered[step], np.minimum(renumbered[death], leaves[islands.of_face])
    stays = np.unique(_roots(parent, step, never)[faces[death == never]])
    tree = KDTree(collapses.final[stays], balanced_tree=False, compact_nodes=False)
    when = np.where(islands.of_vertex >= 0, leaves[islands.of_vertex], never)
    gone = np.flatnonzero(step > when)
    parent[gone] = stays[tree.query(collapses.final[gone], workers=-1)[1]]
    step[gone] = when[gone]
    keeper = np.zeros(len(islands.fewest), dtype=np.int64)
    keeper[islands.of_face] = faces[:, 0]  # of its own: by then nobody's
    kept = np.insert(collapses.kept, due, keeper[going])
    place = np.insert(collapses.place, due, collapses.final[keeper[going]], axis=0)
    return Collapses(parent, step, death, kept, place, collapses.final)


def _roots(parent: np.ndarray, step: np.ndarray, never: int) -> np.ndarray:
    """The vertex (n,) that every vertex is part of in the end."""
    root = np.where(step < never, parent, np.arange(len(parent)))
    while not np.array_equal(root, above := root[root]):
        root = above
    return root
