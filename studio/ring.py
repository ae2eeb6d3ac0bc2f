"""The elastic ring: a striped rubber torus in the x-z plane, with its cage."""

from __future__ import annotations

import numpy as np

from assets.asset import Asset, Cage, Embedded
from studio.dining_room.layout import RING_MAJOR, RING_TUBE
from studio.finish import albedo, gaussians, sharpened, tone
from studio.shapes import Part, surface
from studio.solids import grid_of, torus
from studio.surface_sampling import Cover, cover, join_covers
from studio.textures import plain
from studio.view_dependence import AROUND, directions, view_dependent

SEGMENTS, SIDES = 30, 8  # of the cage: prisms about as long as they are wide
MATERIAL = {"young": 3e4, "poisson": 0.4, "density": 1100.0, "friction": 0.6}
TINTS = {  # rubber, stripe
    "ring_red": ("e0301e", "f4d9c4"),
    "ring_blue": ("1567c8", "d4e6f2"),
    "ring_yellow": ("f4b21a", "fbf0d2"),
}
COLLARS = 6  # light stripes round the tube
COLLAR = 0.009  # [m] their width along the ring


def ring(name: str, rng: np.random.Generator) -> Asset:
    """The asset `ring_red`, `ring_blue` or `ring_yellow`."""
    from prepare.cage.embedding_hosts_reference import embed

    parts = torus_parts(name)
    c = join_covers([cover(part, i, rng) for i, part in enumerate(parts)])
    sh = _rubber_sheen(c, parts, rng)
    g = gaussians(c, sh, np.ones(len(c)))
    cage = torus_cage()
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    reach = RING_MAJOR + RING_TUBE + 0.0105
    sdf = grid_of([torus(RING_MAJOR, RING_TUBE)], (-reach, -0.0255, -reach), (reach, 0.0255, reach), 0.003)
    embedded = Embedded(embedded.host, _rounded_weights(embedded.weights))
    return Asset(g, cage, embedded, sdf, MATERIAL, {"made_by": "vrgs build", "name": name})


def torus_parts(name: str, sides: int = 28) -> list[Part]:
    """The surface of the ring: arcs of rubber with narrow light collars between them, each with clean edges."""
    b = 2 * np.pi * np.arange(sides) / sides
    r = RING_MAJOR + RING_TUBE * np.cos(b)
    y = RING_TUBE * np.sin(b)
    half = 0.5 * COLLAR / RING_MAJOR
    arc = 2 * np.pi / COLLARS
    parts = []
    for k in range(COLLARS):
        spans = ((k * arc - half, k * arc + half, 4, 1), (k * arc + half, (k + 1) * arc - half, 16, 0))
        for start, end, steps, which in spans:
            a = np.linspace(start, end, steps)
            points = np.stack([np.outer(np.cos(a), r), np.broadcast_to(y, (steps, sides)), -np.outer(np.sin(a), r)], -1)
            colour = plain(TINTS[name][which], 0.02, 0.03, seed=k)
            parts.append(Part(f"{name} {k}", surface(points, close_v=True), colour, 0.0034, fixed=True))
    return parts


def torus_cage() -> Cage:
    """Sweep of a polygon with a centre: prisms of three tets each, cut so that neighbours agree.

    The polygon is drawn round the tube, so that the Gaussians lie inside. Every quadrilateral is cut from
    its lowest vertex index, the rule that always gives three tets (Dompierre et al. 1999).
    """
    a = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    b = 2 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    rim = 1.02 * RING_TUBE / np.cos(np.pi / SIDES)
    r = np.concatenate([[RING_MAJOR], RING_MAJOR + rim * np.cos(b)]) / np.cos(np.pi / SEGMENTS)
    y = np.concatenate([[0.0], rim * np.sin(b)])
    vertices = np.stack(
        [np.outer(np.cos(a), r), np.broadcast_to(y, (SEGMENTS, SIDES + 1)), -np.outer(np.sin(a), r)], -1
    ).reshape(-1, 3)
    stride, tets, surface_ = SIDES + 1, [], []
    for s in range(SEGMENTS):
        here, there = s * stride, (s + 1) % SEGMENTS * stride
        for k in range(SIDES):
            one, two = 1 + k, 1 + (k + 1) % SIDES
            prism = [here, here + one, here + two, there, there + one, there + two]
            tets += _cut(prism)
            quad = [here + one, there + one, there + two, here + two]
            low = quad.index(min(quad))
            p, q, t, u = quad[low:] + quad[:low]
            surface_ += [(p, q, t), (p, t, u)]
    x = vertices[np.array(tets)]
    flip = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    tets = np.array(tets, np.int32)
    tets[flip] = tets[flip][:, [0, 1, 3, 2]]
    return Cage(vertices.astype(np.float32), tets, np.array(surface_, np.int32))


def _cut(prism: list[int]) -> list[tuple[int, int, int, int]]:
    """Three tets of a prism (bottom triangle 0 1 2, top 3 4 5), diagonals from the lowest index of each side."""
    low = prism.index(min(prism))
    if low >= 3:  # turn the prism upside down so that its lowest vertex is vertex 0
        prism, low = [prism[3], prism[5], prism[4], prism[0], prism[2], prism[1]], {3: 0, 5: 1, 4: 2}[low]
    p = [prism[(low + i) % 3] for i in range(3)] + [prism[3 + (low + i) % 3] for i in range(3)]
    if min(p[1], p[5]) < min(p[2], p[4]):
        return [(p[0], p[1], p[2], p[5]), (p[0], p[1], p[5], p[4]), (p[0], p[4], p[5], p[3])]
    return [(p[0], p[1], p[2], p[4]), (p[0], p[4], p[2], p[5]), (p[0], p[4], p[5], p[3])]


def _rubber_sheen(c: Cover, parts: list[Part], rng: np.random.Generator) -> np.ndarray:
    """Spherical harmonics of the ring: shading that suits any pose, as the ring turns in its flight.

    Above and below are lit alike, the hole is darker; the rim of the silhouette shines as matt rubber does.
    """
    base = albedo(c, parts, rng)
    outward = c.points * (1, 0, 1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    lit = 0.58 + 0.45 * np.abs(c.normals[:, 1]) + 0.17 * (c.normals * outward).sum(1)
    base = sharpened(c, tone(1.12 * base * lit[:, None]))

    views, _ = directions((0.0, 0.0, 0.0))
    all_round = views[:AROUND], np.ones(AROUND)  # the ring turns, so no side of it counts more

    def look(cosine):
        rim = (1 - cosine) ** 3
        gleam = np.exp(-(((1 - cosine) / 0.10) ** 2))
        return base[:, None] * (0.94 + 0.10 * cosine - 0.10 * rim)[..., None] + (0.13 * rim + 0.10 * gleam)[..., None]

    return view_dependent(c.normals, look, 2, all_round)


def _rounded_weights(weights: np.ndarray) -> np.ndarray:
    """Weights in steps of 1/8192 whose rows still sum to 1: less than a micrometre, half the file."""
    rounded = np.round(weights * 8192.0) / 8192.0
    rounded[..., 3] = 1 - rounded[..., :3].sum(-1)
    return rounded.astype(np.float32)
