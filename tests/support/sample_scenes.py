"""Rooms and gardens of Gaussians made from code, with what is solid in them known exactly: for the tests of stages."""

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.rotation import turns_to
from tests.support.distance_shapes import box

TABLE = ((-0.7, 0.70, -0.4), (0.7, 0.74, 0.4))  # low and high corner [m]
JUG = ((0.3, 0.74, 0.1), (0.4, 0.94, 0.2))
SHELF = ((-0.9, 1.27, -1.98), (0.1, 1.30, -1.70))
CHEST = ((1.5, 0.0, -1.9), (2.2, 0.45, -1.3))
ROOM = ((-2.5, 0.0, -2.0), (2.5, 2.6, 2.0))
GARDEN_TABLE = ((-0.8, 0.68, -0.5), (0.6, 0.72, 0.3))
GARDEN_RADIUS = 4.0  # [m]
# y down and leaning, as structure from motion leaves it
LEANING = np.array([[1.0, 0, 0], [0, -np.cos(0.13), -np.sin(0.13)], [0, np.sin(0.13), -np.cos(0.13)]])


def sheet(rng, origin, u, v, step: float, noise: float) -> Gaussians:
    """Flat Gaussians, about one in each step x step [m], on the parallelogram origin + a u + b v, off it by `noise`."""
    u, v = np.asarray(u, float), np.asarray(v, float)
    n = np.cross(u, v)
    n /= np.linalg.norm(n)
    cells = [max(1, round(np.linalg.norm(e) / step)) for e in (u, v)]
    a, b = ((g.ravel() + rng.uniform(0, 1, g.size)) / c for g, c in zip(np.indices(cells), cells, strict=True))
    points = np.asarray(origin, float) + a[:, None] * u + b[:, None] * v
    return flat(rng, points, np.broadcast_to(n, points.shape), step, noise)


def flat(rng, points, normals, step: float, noise: float) -> Gaussians:
    """Discs at points (N, 3), their axes within a few degrees of the normals (N, 3)."""
    k = len(points)
    quats = turns_to(normals + rng.normal(0, 0.08, (k, 3)), rng.uniform(0, np.pi, k))
    scales = step * np.stack([rng.uniform(0.4, 0.9, k), rng.uniform(0.4, 0.9, k), rng.uniform(0.03, 0.2, k)], 1)
    logits = np.where(rng.random(k) < 0.8, rng.normal(3.0, 1.0, k), rng.normal(0.0, 1.0, k))
    colours = 0.3 * np.sin(3 * points)[:, None]
    return Gaussians.of(points + noise * rng.normal(size=(k, 1)) * normals, quats, np.log(scales), logits, colours)


def brick(rng, low, high, step: float, noise: float, faces: str = "xXyYzZ") -> Gaussians:
    """The faces of a box: lower case the low side of an axis."""
    low, size = np.asarray(low, float), np.subtract(high, low)
    parts = []
    for face in faces:
        axis = "xyz".index(face.lower())
        u, v = (np.eye(3)[k] * size[k] for k in range(3) if k != axis)
        parts.append(sheet(rng, low + np.eye(3)[axis] * size * face.isupper(), u, v, step, noise))
    return concatenate(parts)


def floaters(rng, count: int, low, high) -> Gaussians:
    """Floaters that training leaves in mid-air: faint blobs, some of them opaque."""
    return Gaussians.of(
        rng.uniform(low, high, (count, 3)),
        rng.normal(size=(count, 4)),
        np.log(rng.uniform(0.01, 0.06, (count, 3))),
        rng.normal(-2.0, 2.0, count),
        rng.normal(0, 0.5, (count, 1, 3)),
    )


def tagged(g: Gaussians, object_id: int) -> Gaussians:
    return Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, np.full(len(g), object_id, np.uint16))


def legs(rng, top, step: float, noise: float) -> Gaussians:
    return concatenate([brick(rng, *box, step, noise, "xXzZ") for box in leg_boxes(top)])


def leg_boxes(top) -> list:
    """Low and high corners of a table's legs."""
    (x0, y0, z0), (x1, _, z1) = top
    corners = [(x, z) for x in (x0 + 0.04, x1 - 0.1) for z in (z0 + 0.04, z1 - 0.1)]
    return [((x, 0, z), (x + 0.06, y0, z + 0.06)) for x, z in corners]


def room(seed: int = 0, *, noise: float = 0.004, ceiling: bool = True) -> Gaussians:
    """A closed room seen from inside, with a table, a shelf on the wall, a chest, and a jug (object 7) on the table."""
    rng = np.random.default_rng(seed)
    return concatenate([
        brick(rng, *ROOM, 0.035, noise, "xXyYzZ" if ceiling else "xXyzZ"),
        brick(rng, *TABLE, 0.015, noise),
        legs(rng, TABLE, 0.02, noise),
        brick(rng, *SHELF, 0.015, noise, "xXyYZ"),
        brick(rng, *CHEST, 0.03, noise, "xXYzZ"),
        jug(rng, noise),
        floaters(rng, 400, *ROOM),
    ])  # fmt: skip


def jug(rng, noise: float) -> Gaussians:
    """Object 7."""
    return tagged(brick(rng, *JUG, 0.012, noise / 2, "xXYzZ"), 7)


def table_and_jug(seed: int = 2) -> Gaussians:
    """A little of a room."""
    rng = np.random.default_rng(seed)
    return concatenate([
        sheet(rng, (-1.3, 0, 1.1), (2.6, 0, 0), (0, 0, -2.2), 0.03, 0.003),
        brick(rng, *TABLE, 0.015, 0.003),
        legs(rng, TABLE, 0.02, 0.003),
        jug(rng, 0.003),
    ])  # fmt: skip


def garden(seed: int = 1, *, noise: float = 0.008) -> Gaussians:
    """Open ground with a table and a post on it: no walls, no ceiling, a far backdrop, floaters all over."""
    rng = np.random.default_rng(seed)
    r, a = GARDEN_RADIUS * np.sqrt(rng.random(40_000)), rng.uniform(0, 2 * np.pi, 40_000)
    ground = np.stack([r * np.cos(a), np.zeros_like(r), r * np.sin(a)], 1)
    d = rng.normal(size=(3000, 3))
    d[:, 1] = np.abs(d[:, 1])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return concatenate([
        flat(rng, ground, np.broadcast_to([0.0, 1.0, 0.0], ground.shape), 0.04, noise),
        brick(rng, *GARDEN_TABLE, 0.015, noise / 2),
        legs(rng, GARDEN_TABLE, 0.02, noise / 2),
        brick(rng, (1.6, 0, 1.6), (1.75, 1.8, 1.75), 0.03, noise, "xXYzZ"),
        flat(rng, 30 * d, -d, 1.5, 0.3),
        floaters(rng, 800, (-4, 0, -4), (4, 3, 4)),
    ])  # fmt: skip


def box_distance(points, corners) -> np.ndarray:
    """Signed distance [m] of points (N, 3) to a box (low, high)."""
    low, high = np.asarray(corners, float)
    return box(points - (low + high) / 2, (high - low) / 2)


def room_distance(points) -> np.ndarray:
    """Signed distance [m] of points to what is solid in the room, its walls and all beyond them included."""
    solids = (TABLE, SHELF, CHEST, JUG, *leg_boxes(TABLE))
    return np.min([-box_distance(points, ROOM), *(box_distance(points, b) for b in solids)], axis=0)


def garden_distance(points) -> np.ndarray:
    """The same of the garden, without its post."""
    solids = (GARDEN_TABLE, *leg_boxes(GARDEN_TABLE))
    return np.min([points[:, 1], *(box_distance(points, b) for b in solids)], axis=0)
