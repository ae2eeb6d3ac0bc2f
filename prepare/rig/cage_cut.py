"""Cutting a cage open where it joins what the skeleton does not: a hand and the hip it rests on, the two thighs.

A cage's lattice is coarser than such gaps, and a splat has none where two surfaces touch. Each tet belongs to a joint;
faces between tets of joints that do not meet there are duplicated, and so are their vertices.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from assets.asset import Cage
from core.tetmesh import shared_face_pairs, tet_faces
from prepare.rig.body_segmentation import Joined

MAX_ROUNDS = 20  # of giving disconnected fragments to their neighbours; each removes some


def inner_and_boundary_faces(tets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inner faces: the two tets of each (n, 2) and its vertices (n, 3); and the boundary's triangles, outward."""
    faces = tet_faces(tets)
    pairs = shared_face_pairs(tets)
    alone = np.ones(len(faces), bool)
    alone[pairs] = False
    return pairs // 4, faces[pairs[:, 0]], faces[alone]


def cut(cage: Cage, label: np.ndarray, joined: Joined) -> tuple[Cage, np.ndarray, np.ndarray]:
    """Open the cage between tets that belong to joints which do not meet there.

    label   joint of each tet, (T,)
    joined  joined(a, b, centre): mask of where tets of joints a and b (n,) stay connected at face centres (n, 3)
    Out.    the cage, still connected; the labels, changed for fragments, (T,); the old index of each vertex
    """
    pairs, faces, _ = inner_and_boundary_faces(cage.tets)
    x = cage.vertices.astype(np.float64)
    centre = x[faces].mean(1)
    label = label.copy()
    T = len(cage.tets)
    for _ in range(MAX_ROUNDS):
        a, b = label[pairs[:, 0]], label[pairs[:, 1]]
        kept = (a == b) | joined(a, b, centre)
        count, fragment = connected_components(coo_matrix((np.ones(kept.sum()), pairs[kept].T), shape=(T, T)), False)
        if count == 1:
            break
        # A disconnected fragment takes the label it touches most.
        main = np.argmax(np.bincount(fragment))
        over = pairs[~kept]
        over = np.concatenate([over, over[:, ::-1]])
        over = over[(fragment[over[:, 0]] != main) & (fragment[over[:, 0]] != fragment[over[:, 1]])]
        if not len(over):  # fragments that met in a vertex or an edge only
            break
        width = int(label.max()) + 1
        votes = np.bincount(fragment[over[:, 0]] * width + label[over[:, 1]], minlength=count * width).reshape(
            count, -1
        )
        lost = np.flatnonzero(votes.any(1))
        for p in lost:
            label[fragment == p] = np.argmax(votes[p])
    a, b = label[pairs[:, 0]], label[pairs[:, 1]]
    kept = (a == b) | joined(a, b, centre)
    tets, source = split_vertices(cage.tets, pairs[kept])
    surface = inner_and_boundary_faces(tets)[2]
    return Cage(cage.vertices[source], tets.astype(np.int32), surface.astype(np.int32)), label, source


def split_vertices(tets: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tets (T, 4) that share a vertex only if kept faces connect them, and the old index of each new vertex.

    kept  pairs of tets whose common face stays, (n, 2)
    """
    corner = np.arange(4 * len(tets)).reshape(-1, 4)
    links = []
    for i in range(4):
        for j in range(4):
            same = tets[kept[:, 0], i] == tets[kept[:, 1], j]
            links.append(np.stack([corner[kept[same, 0], i], corner[kept[same, 1], j]], 1))
    links = np.concatenate(links)
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(corner.size,) * 2)
    _, group = connected_components(graph, False)
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(tets.ravel()[first], kind="stable")  # old vertices keep their order
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[group].reshape(-1, 4), tets.ravel()[first[order]]
