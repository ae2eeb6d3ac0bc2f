"""Cages of solids of revolution: a triangulated section, turned about y, in prisms of three tets each."""

from __future__ import annotations

import numpy as np

from assets.asset import Cage
from core.tetmesh import boundary_surface, positively_oriented


def revolved_cage(section, triangles, segments: int) -> Cage:
    """The cage of the section (P, 2) of (radius, y) with `triangles` (K, 3), in `segments` steps about y.

    Points on the axis (radius 0) become one vertex each. The polygon circumscribes the circle of each radius.
    """
    section = np.asarray(section, float)
    a = 2 * np.pi * np.arange(segments) / segments
    r, y = section[:, 0] / np.cos(np.pi / segments), section[:, 1]
    points = np.stack([np.outer(np.cos(a), r), np.broadcast_to(y, (segments, len(r))), -np.outer(np.sin(a), r)], -1)
    number = np.arange(segments * len(section)).reshape(segments, -1)
    number = np.where(r == 0, np.arange(len(section)), number)
    tets = []
    for s in range(segments):
        here, there = number[s], number[(s + 1) % segments]
        for triangle in triangles:
            tets += split_prism([int(i) for i in (*here[list(triangle)], *there[list(triangle)])])
    tets = np.array([t for t in tets if len(set(t)) == 4])  # on the axis prisms degenerate
    used, tets = np.unique(tets, return_inverse=True)
    vertices = points.reshape(-1, 3)[used]
    tets = positively_oriented(vertices, tets.reshape(-1, 4)).astype(np.int32)
    return Cage(vertices.astype(np.float32), tets, boundary_surface(tets))


def split_prism(prism: list[int]) -> list[tuple[int, int, int, int]]:
    """Three tets of a prism (bottom triangle 0 1 2, top 3 4 5), with diagonals from the lowest index of each side.

    Neighbouring prisms split so always conform (Dompierre et al. 1999).
    """
    low = prism.index(min(prism))
    if low >= 3:  # turned upside down, its lowest vertex is in the bottom triangle
        prism, low = [prism[3], prism[5], prism[4], prism[0], prism[2], prism[1]], {3: 0, 5: 1, 4: 2}[low]
    p = [prism[(low + i) % 3] for i in range(3)] + [prism[3 + (low + i) % 3] for i in range(3)]
    if min(p[1], p[5]) < min(p[2], p[4]):
        return [(p[0], p[1], p[2], p[5]), (p[0], p[1], p[5], p[4]), (p[0], p[4], p[5], p[3])]
    return [(p[0], p[1], p[2], p[4]), (p[0], p[4], p[2], p[5]), (p[0], p[4], p[5], p[3])]
