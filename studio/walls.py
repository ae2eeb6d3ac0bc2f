"""Walls of rooms with openings in them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from studio.shapes import Mesh, grid_mesh, join, quad


def wall_sheet(span, heights, holes, to_room: Callable) -> Mesh:
    """Wall over `span` along it and `heights` [m], without `holes` (along from, to, up from, to).

    to_room  (along, up) -> point in the room; a falling `span` turns the wall's face round
    """
    low, high = min(span), max(span)
    bottom, top = heights
    holes = [(*np.clip((a, b), low, high), *np.clip((c, d), bottom, top)) for a, b, c, d in holes]
    u = np.unique([low, high, *(h for hole in holes for h in hole[:2])])[:: 1 if span[0] < span[1] else -1]
    v = np.unique([bottom, top, *(h for hole in holes for h in hole[2:])])
    mesh = grid_mesh(np.array([[to_room(a, b) for b in v] for a in u]))
    centre = mesh.vertices[mesh.faces].mean(1)
    along = centre @ np.abs(np.sign(np.array(to_room(1.0, 0.0)) - to_room(0.0, 0.0)))
    inside = np.zeros(len(centre), bool)
    for a, b, c, d in holes:
        inside |= (along > a) & (along < b) & (centre[:, 1] > c) & (centre[:, 1] < d)
    return Mesh(mesh.vertices, mesh.faces[~inside])


def reveal(low, high, depth: float, to_wall: Callable, flip: bool = False) -> Mesh:
    """The four inner faces of an opening from `low` to `high` (along, up), `depth` [m] deep.

    to_wall  (along, up, depth) -> point in the room; `flip` turns the faces round where that is left-handed
    """
    (u0, v0), (u1, v1) = low, high
    loop = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
    meshes = []
    for (a, b), (c, d) in zip(loop, loop[1:] + loop[:1], strict=True):
        p, q, r = (np.array(to_wall(*t)) for t in ((a, b, 0), (c, d, 0), (a, b, depth)))
        meshes.append(quad(p, q - p, r - p) if not flip else quad(p, r - p, q - p))
    return join(*meshes)


def within(mesh: Mesh, low, high) -> Mesh:
    """The mesh clamped to a room from `low` to `high`, without faces that lie wholly in or behind a wall."""
    low, high = np.array(low), np.array(high)
    v = mesh.vertices[mesh.faces]
    out = ((v <= low + 1e-9).all(1) | (v >= high - 1e-9).all(1)).any(1)
    return Mesh(mesh.vertices.clip(low, high), mesh.faces[~out])
