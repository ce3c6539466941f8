"""Small meshes and hand paths for the contact tests. Vertices float32 (what a level stores), mm."""

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]


def grid(points: np.ndarray) -> np.ndarray:
    """(m, 3) faces over a (rows, columns, 3) lattice, fronts along row x column."""
    rows, columns = points.shape[:2]
    k = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def height_field(height, half_mm: float = 10.0, cells: int = 40) -> Mesh:
    """z = height(x, y) over a square."""
    axis = np.linspace(-half_mm, half_mm, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1)
    return points.reshape(-1, 3).astype(np.float32), grid(points)


def plane(half_mm: float = 10.0, cells: int = 40) -> Mesh:
    """z = 0."""
    return height_field(lambda x, y: 0.0 * x, half_mm, cells)


def groove(half_mm: float = 10.0, cells: int = 40) -> Mesh:
    """z = |x|: walls at 90 degrees."""
    return height_field(lambda x, y: np.abs(x), half_mm, cells)


def sphere(radius_mm: float = 10.0, subdivisions: int = 4) -> Mesh:
    """Icosphere; 20 * 4^subdivisions triangles."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return np.asarray(ball.vertices, dtype=np.float32), np.asarray(ball.faces)


def plate(thickness_mm: float = 0.3, half_mm: float = 10.0, cells: int = 30) -> Mesh:
    """Closed thin plate; its upper side at z = 0."""
    top_v, top_f = plane(half_mm, cells)
    bottom_v = top_v - np.array([0, 0, thickness_mm], dtype=np.float32)
    n = len(top_v)
    side = cells + 1
    k = np.arange(n).reshape(side, side)
    rim = np.concatenate([k[:-1, 0], k[-1, :-1], k[:0:-1, -1], k[0, :0:-1]])
    following = np.roll(rim, -1)
    walls = np.concatenate([np.stack([rim, rim + n, following], 1), np.stack([following, rim + n, following + n], 1)])
    return np.concatenate([top_v, bottom_v]), np.concatenate([top_f, top_f[:, ::-1] + n, walls])


def cracked_plane(gap_mm: float, half_mm: float = 5.0, tiles: int = 10) -> Mesh:
    """z = 0 in unwelded square tiles with a gap around each."""
    pitch = 2.0 * half_mm / tiles
    corner = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64) * (pitch - gap_mm)
    origin = np.stack(np.meshgrid(np.arange(tiles), np.arange(tiles), [0], indexing="ij"), -1).reshape(-1, 3) * pitch
    points = (origin[:, None] + corner - [half_mm, half_mm, 0]).reshape(-1, 3)
    first = 4 * np.arange(tiles * tiles)[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return points.astype(np.float32), faces


def wander(anchors: np.ndarray, speed_mm_s: float, ticks: int, loop_hz: float = 1000.0) -> np.ndarray:
    """(ticks, 3) HIP path through anchors in minimum-jerk strokes whose mean speed is speed_mm_s."""
    path = [anchors[:1]]
    total = 1
    for k in range(10**6):
        a, b = anchors[k % len(anchors)], anchors[(k + 1) % len(anchors)]
        n = max(int(np.linalg.norm(b - a) / speed_mm_s * loop_hz), 2)
        s = np.arange(1, n + 1)[:, None] / n
        path.append(a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        total += n
        if total >= ticks:
            break
    return np.concatenate(path)[:ticks]
