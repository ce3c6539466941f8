"""An independent answer to "where is the contact?": float64, exhaustive over triangles, nothing shared with the core.

The definition it implements (docs/contact.md): the tool's reference point keeps the distance
kept = max(radius, crack) + skin from every triangle, for each of its balls. One step: planes of everything
touched, the point nearest to the HIP behind none of them, a straight sweep to it that stops at the first touch.
Touches are roots of the exact offset surfaces (face planes, edge cylinders, corner spheres); the nearest point is
found by trying every set of up to three planes. Steps repeat until nothing moves.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

SKIN_OF_EXTENT = 4e-6


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(m, 3) cross products; np.cross spends more on small arrays than all else here."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    u, v, w = b[:, 0], b[:, 1], b[:, 2]
    product = np.empty((len(a), 3))
    product[:, 0], product[:, 1], product[:, 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return product


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...) dot products of the last axes."""
    return np.einsum("...j,...j->...", a, b)


def length(a: np.ndarray) -> np.ndarray:
    """(...) lengths of the last axis."""
    return np.sqrt(dot(a, a))


def edges_of(triangles: np.ndarray) -> np.ndarray:
    """(m, 3, 3): from each corner to the next one."""
    return triangles[:, [1, 2, 0]] - triangles


def closest_points(triangles: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(m, 3) closest point of each triangle (m, 3, 3) to p (3,) or (m, 3)."""
    a, edge = triangles[:, 0], edges_of(triangles)
    back = -edge[:, 2]  # from the first corner to the last
    normal = cross(edge[:, 0], back)
    area2 = dot(normal, normal)
    safe = np.where(area2 > 0.0, area2, 1.0)
    ap = p - a
    u = dot(cross(ap, back), normal) / safe
    v = dot(cross(edge[:, 0], ap), normal) / safe
    inside = (area2 > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    best = p - normal * (dot(ap, normal) / safe)[:, None]
    out = np.flatnonzero(~inside)
    if len(out):
        start, edge = triangles[out], edge[out]
        away = (p if p.ndim == 1 else p[out][:, None]) - start
        length2 = dot(edge, edge)
        t = dot(away, edge) / np.where(length2 > 0.0, length2, 1.0)
        rest = away - edge * np.clip(t, 0.0, 1.0)[..., None]  # (o, 3, 3): from each edge's nearest point to p
        nearest = np.argmin(dot(rest, rest), axis=1)
        best[out] = (p if p.ndim == 1 else p[out]) - rest[np.arange(len(out)), nearest]
    return best


def distances(triangles: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(m,) distance of each triangle to p."""
    return length(p - closest_points(triangles, p))


def _first_root(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Entering root of a t^2 + 2 b t + c, inf where there is none."""
    disc = b * b - a * c
    ok = (a > 0.0) & (b < 0.0) & (disc >= 0.0)
    # c / (-b + sqrt) is the smaller root without cancellation.
    return np.where(ok, c / np.where(ok, -b + np.sqrt(np.maximum(disc, 0.0)), 1.0), np.inf)


def touch_times(
    triangles: np.ndarray, keep: np.ndarray, here: np.ndarray, x: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """(m,) first t >= 0 at which x + t step comes within keep (m,) of each triangle; inf where it never does.

    `here`: (m, 3) the triangles' closest points to x.
    """
    edge = edges_of(triangles)
    first, back = triangles[:, 0], -edge[:, 2]
    normal = cross(edge[:, 0], back)
    area2 = dot(normal, normal)
    flat = area2 > 0.0
    safe = np.where(flat, area2, 1.0)
    unit = normal / np.sqrt(safe)[:, None]
    height = dot(x - first, unit)
    fall = unit @ step
    times = np.full(len(triangles), np.inf)
    for sign in (1.0, -1.0):
        approaching = flat & (sign * fall < 0.0)
        t = np.where(approaching, (sign * keep - height) / np.where(approaching, fall, 1.0), np.inf)
        t = np.where(t >= 0.0, t, np.inf)
        foot = x + np.where(np.isfinite(t), t, 0.0)[:, None] * step - unit * (sign * keep)[:, None] - first
        u = dot(cross(foot, back), normal) / safe
        v = dot(cross(edge[:, 0], foot), normal) / safe
        times = np.minimum(times, np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0), t, np.inf))
    # Corners are balls, edges cylinders between them.
    m, keep2 = x - triangles, (keep * keep)[:, None]
    t = _first_root(np.full(m.shape[:2], step @ step), m @ step, dot(m, m) - keep2)
    times = np.minimum(times, np.where(t >= 0.0, t, np.inf).min(axis=1))
    length2 = dot(edge, edge)
    safe = np.where(length2 > 0.0, length2, 1.0)
    along_m, along_step = dot(m, edge) / safe, (edge @ step) / safe
    across_m, across_step = m - along_m[..., None] * edge, step - along_step[..., None] * edge
    t = _first_root(dot(across_step, across_step), dot(across_m, across_step), dot(across_m, across_m) - keep2)
    s = along_m + np.where(np.isfinite(t), t, 0.0) * along_step
    held = (length2 > 0.0) & (t >= 0.0) & (s >= 0.0) & (s <= 1.0)
    times = np.minimum(times, np.where(held, t, np.inf).min(axis=1))
    # Already nearer than keep: distance to a convex set is convex, so it blocks at once or never.
    d = length(x - here)
    slope = (x - here) @ step
    return np.where(d <= keep, np.where(slope < 0.0, 0.0, np.inf), times)


def nearest_point(normals: np.ndarray, offsets: np.ndarray, target: np.ndarray, tolerance: float) -> tuple:
    """Point nearest to target with normals y >= offsets - tolerance, over every set of up to three active planes.

    Returns (point, indices of the active planes); (None, ()) where the planes contradict each other.
    """
    if (normals @ target >= offsets - tolerance).all():
        return target, ()
    best, active, least = None, (), np.inf
    for size in (1, 2, 3):
        if size > len(normals):
            break
        sets = np.array(list(combinations(range(len(normals)), size)))
        n = normals[sets]  # (s, size, 3)
        gram = n @ n.transpose(0, 2, 1)
        usable = np.linalg.det(gram) > 1e-13
        sets, n, gram = sets[usable], n[usable], gram[usable]
        if not len(sets):
            continue
        lift = np.linalg.solve(gram, (offsets[sets] - n @ target)[..., None])[..., 0]
        y = target + np.einsum("sk,skj->sj", lift, n)
        feasible = (y @ normals.T >= offsets - tolerance).all(axis=1)
        far = np.where(feasible, length(y - target), np.inf)
        i = int(np.argmin(far))
        if far[i] < least - 1e-15:
            best, active, least = y[i], tuple(int(k) for k in sets[i]), far[i]
    return best, active


@dataclass
class Answer:
    """One tick: the SCP, the reference point it belongs to, whether it settled, how many constraints hold it."""

    scp_mm: np.ndarray
    reference_mm: np.ndarray
    settled: bool
    constraints: int
    iterations: int


class Oracle:
    """A rigid union of balls against a mesh. vertices (n, 3) mm, faces (m, 3), balls (P, 4) x y z r."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, balls: np.ndarray, crack_mm: float = 0.0) -> None:
        points = np.asarray(vertices, dtype=np.float64)
        self.triangles = points[np.asarray(faces)]
        used = self.triangles.reshape(-1, 3)
        self.skin = SKIN_OF_EXTENT * float(np.linalg.norm(used.max(0) - used.min(0)))
        self.offsets = np.asarray(balls, dtype=np.float64)[:, :3]
        self.radii = np.asarray(balls, dtype=np.float64)[:, 3]
        self.kept = np.maximum(self.radii, crack_mm) + self.skin
        self.middle = self.triangles.mean(axis=1)
        self.size = length(self.triangles - self.middle[:, None]).max(axis=1)

    def items(self, centre: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every (triangle - ball offset) that the reference point could touch within reach of centre, by a bound."""
        triangles, kept, radii = [], [], []
        for offset, keep, radius in zip(self.offsets, self.kept, self.radii, strict=True):
            gap = length(self.middle - offset - centre) - self.size
            near = np.flatnonzero(gap <= reach + keep)
            triangles.append(self.triangles[near] - offset)
            kept.append(np.full(len(near), keep))
            radii.append(np.full(len(near), radius))
        return np.concatenate(triangles), np.concatenate(kept), np.concatenate(radii)

    def clearance(self, x: np.ndarray, reach: float = 1.0) -> float:
        """Least distance of a ball's surface to the mesh with the reference at x (negative: penetration)."""
        triangles, _, radii = self.items(x, reach)
        return float((distances(triangles, x) - radii).min()) if len(triangles) else np.inf

    def planes(self, items: tuple[np.ndarray, np.ndarray, np.ndarray], c: np.ndarray, x: np.ndarray) -> tuple:
        """Normals, offsets and slacks of what is touched at x, nearest first, without what they already separate.

        `c`: (m, 3) the closest points to x.
        """
        triangles, kept, radii = items
        d = length(x - c)
        touched = np.flatnonzero((d - kept <= self.skin) & (d > 0.0))
        normals: list[np.ndarray] = []
        offsets: list[float] = []
        slacks: list[float] = []
        for i in touched[np.argsort((d - kept)[touched], kind="stable")]:
            if normals:
                top = (triangles[i] @ np.array(normals).T).max(axis=0) + kept[i]
                if (top <= np.array(offsets) + 0.25 * self.skin).any():
                    continue
            n = (x - c[i]) / d[i]
            normals.append(n)
            offsets.append(float(n @ c[i] + kept[i]))
            slacks.append(float(kept[i] - radii[i]))
        return np.array(normals).reshape(-1, 3), np.array(offsets), np.array(slacks)

    def start_from(self, scp: np.ndarray, hip: np.ndarray) -> np.ndarray:
        """The reference point that belongs to an SCP on the surface: pushed off it, away from the HIP."""
        pull = scp - hip
        depth = float(np.linalg.norm(pull))
        x = scp + pull * (self.skin / depth) if depth > 0.0 else scp
        for _ in range(50):
            triangles, kept, _ = self.items(x, float(self.kept.max()))
            if not len(triangles):
                break
            c = closest_points(triangles, x)
            d = length(x - c)
            i = int(np.argmin(d - kept))
            if d[i] - kept[i] >= -1e-3 * self.skin or d[i] == 0.0:
                break
            x = c[i] + (x - c[i]) * (kept[i] / d[i])
        return x

    def solve(self, x: np.ndarray, hip: np.ndarray, most: int = 400) -> Answer:
        """Moves the reference point from x toward the HIP until it settles."""
        # Every step shortens |x - hip|: what lies outside this ball is never touched.
        items = self.items(hip, float(np.linalg.norm(x - hip)) + 4.0 * self.skin)
        triangles, kept, _ = items
        settled = False
        k = 0
        normals, offsets, slacks = walls = (np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        last_step = np.zeros(3)
        for k in range(most):
            here = closest_points(triangles, x)
            normals, offsets, slacks = self.planes(items, here, x)
            y, active = nearest_point(normals, offsets, hip, 1e-5 * self.skin)
            if y is None:
                break
            if k > 30 and (y - x) @ last_step < 0.0:
                # To and fro over a crease too shallow for both walls to be touched at once: both hold.
                both = [np.concatenate(pair) for pair in zip((normals, offsets, slacks), walls, strict=True)]
                turned, held = nearest_point(both[0], both[1], hip, 1e-5 * self.skin)
                if turned is not None and np.linalg.norm(turned - x) > 2e-3 * self.skin:
                    (normals, offsets, slacks), y, active = both, turned, held
            step = y - x
            walls, last_step = (normals[list(active)], offsets[list(active)], slacks[list(active)]), step
            if np.linalg.norm(step) <= 2e-3 * self.skin:
                settled = True
                break
            t = float(min(touch_times(triangles, kept - 0.1 * self.skin, here, x, step).min(initial=1.0), 1.0))
            x = x + t * step
            if t == 1.0 and not len(normals):
                settled = True
                break
        scp, active = nearest_point(normals, offsets - slacks, hip, 1e-5 * self.skin)
        if scp is not None and len(active):
            # No further than a cube's corner needs: between steep planes the way back is long and no nearer.
            most, way = 1.75 * slacks[list(active)].max() + self.skin, float(np.linalg.norm(scp - x))
            scp = x + (scp - x) * min(1.0, most / way) if way > 0.0 else scp
        return Answer(x if scp is None else scp, x, settled and scp is not None, len(active), k + 1)

    def unheld(self, scp: np.ndarray, hip: np.ndarray) -> float:
        """Share (0 to 1) of the pull toward the HIP that no touched triangle holds: 0 at a local minimum of distance.

        First-order conditions of "nearest reachable point": scp - hip is a nonnegative sum of contact normals.
        """
        from scipy.optimize import nnls

        pull = scp - hip
        depth = float(np.linalg.norm(pull))
        if depth <= self.skin:
            return 0.0
        seen_from = scp + pull * (self.skin / depth)
        triangles, _, radii = self.items(seen_from, 3.0 * self.skin)
        c = closest_points(triangles, seen_from) if len(triangles) else np.zeros((0, 3))
        d = length(seen_from - c)
        held = (d - radii < 3.0 * self.skin) & (d > 0.0)
        if not held.any():
            return 1.0
        _, rest = nnls(((seen_from - c)[held] / d[held, None]).T, pull / depth)
        return float(rest)
