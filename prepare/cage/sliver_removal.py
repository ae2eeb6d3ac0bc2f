"""Lift the smallest dihedral angles of a cage: its worst tets' vertices look about for better places.

Each vertex tries places around it and takes that where the smallest angle of its tets is largest (Freitag and
Ollivier-Gooch 1997 do so by gradients); those of the surface stay on it. Few tets need it: this is NumPy.
"""

from __future__ import annotations

import numpy as np

from core.tetmesh import TET_FACES

GOAL = 14.0  # [degrees] tets with smaller angles are worked on
ROUNDS = 8
STEPS = (0.02, 0.06, 0.15)  # cells
_grid = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
WAYS = _grid[np.abs(_grid).sum(1) > 0] / np.linalg.norm(_grid[np.abs(_grid).sum(1) > 0], axis=1, keepdims=True)
PLACES = np.concatenate([s * WAYS for s in STEPS])
_I, _J = np.triu_indices(4, 1)


def smallest(corners: np.ndarray) -> np.ndarray:
    """Smallest dihedral angle [degrees] (...) of tets with corners (..., 4, 3); -1 where one is inverted."""
    face = corners[..., TET_FACES, :]
    normal = np.cross(face[..., 1, :] - face[..., 0, :], face[..., 2, :] - face[..., 0, :])
    volume = -np.einsum("...i,...i", corners[..., 0, :] - corners[..., 1, :], normal[..., 0, :])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    cosine = np.einsum("...ki,...ki->...k", normal[..., _I, :], normal[..., _J, :])
    return np.where(volume > 0, np.degrees(np.arccos((-cosine).max(-1).clip(-1, 1))), -1.0)


def polish(x: np.ndarray, tets: np.ndarray, surface, outer: np.ndarray, level: np.ndarray, size: np.ndarray):
    """Positions (V, 3) with the worst tets lifted towards GOAL.

    surface, outer, level  prepare.cage.relaxation.Surface, the vertices that lie on it (M,), and on which level of it (M,)
    size                   width of a cell at each vertex (V,)
    """
    x = x.copy()
    on = np.full(len(x), -1)
    on[outer] = np.arange(len(outer))
    angle = smallest(x[tets])
    if angle.min() >= GOAL:
        return x
    order = np.argsort(tets.ravel(), kind="stable")
    first = np.concatenate([[0], np.bincount(tets.ravel(), minlength=len(x)).cumsum()])
    for _ in range(ROUNDS):
        bad = np.flatnonzero(angle < GOAL)
        if not len(bad):
            break
        moved = False
        for v in dict.fromkeys(tets[bad[np.argsort(angle[bad])]].ravel().tolist()):
            around = order[first[v] : first[v + 1]]
            own, k = around // 4, around % 4
            before = angle[own].min()
            if before >= GOAL:
                continue
            places = x[v] + size[v] * PLACES
            if on[v] >= 0:
                places = surface.back(places, np.full(len(places), level[on[v]]))
            corners = np.repeat(x[tets[own]][None], len(places), 0)
            corners[:, np.arange(len(own)), k] = places[:, None]
            found = smallest(corners)
            best = found.min(1).argmax()
            if found[best].min() > before + 0.01:
                x[v], angle[own] = places[best], found[best]
                moved = True
        if not moved:
            break
    return x
