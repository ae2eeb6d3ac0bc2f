"""Point cloud of the visible surfaces around marked objects, and labels that spread over it from seeds.

Labels spread as a random walker does (Grady 2006): easily over smooth surfaces of one colour, hardly across borders of
colour, and least of all through concave creases, where an object meets its support (Stein et al. 2014).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.camera import Camera
from prepare.progress import Progress, no_progress
from prepare.segment.graph_cut import random_walk

ALPHA_MIN = 0.6  # a pixel of lower opacity has no depth
HIDDEN_RATIO = 0.9  # a point is hidden by one beside it in the picture that is nearer than this fraction of its depth
CELL = 1.6  # spacings of the points in the picture within which one can hide another
GAP = 8.0  # spacings of the points beyond which a pixel has no depth
POINTS_MIN = 12  # visible in a picture; with fewer it has no depth
POINTS = 60_000  # in the cloud, about
SAMPLES_MAX = 1_500_000  # pixels of all views from which it is made
JUMP = 1.06  # ratio of neighbouring depths at a silhouette, where a rendered depth lies between both sides
NORMAL_NEIGHBOURS, NEIGHBOURS = 16, 10
COLOR_STEP = 0.13  # difference of colours in 0..1 that divides the weight of an edge by e
COLOR_MOST = 3.5  # largest such exponent: objects have stripes
OFF_PLANE = 3.0  # exponent for an edge between a supporting plane and a point off it
CONCAVE, CONVEX = 6.0, 1.0  # exponents for a crease of 90 degrees
LEAK = 1e-6  # of a point's weights, to the background: decides where no seed is connected
PLANE_TRIES, PLANE_SHARE, PLANES_MAX = 300, 0.06, 4
PLANE_STEPS = 1.0  # spacings of the cloud: a nearer point lies on the plane


def depths_of_splats(gaussians: Gaussians, cameras: list[Camera], report: Progress = no_progress) -> list[np.ndarray]:
    """Depths along the axis (H, W) float32 of each view, 0 where there is nothing. Taichi must be running."""
    from prepare.blending_weights import BlendingWeights

    drawing, depths = BlendingWeights(gaussians, cameras), []
    for k, camera in enumerate(cameras):
        _, depth, alpha = drawing.picture(camera)
        depths.append(np.where(alpha >= ALPHA_MIN, depth, 0.0).astype(np.float32))
        report("depths", (k + 1) / len(cameras))
    drawing.destroy()
    return depths


def depths_of_points(points: np.ndarray, cameras: list[Camera], report: Progress = no_progress) -> list[np.ndarray]:
    """As `depths_of_splats`, from points (P, 3): the depth of the nearest visible one in the picture."""
    depths = []
    for k, camera in enumerate(cameras):
        x, y, z = camera.projected(points)
        there = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        at, z = np.column_stack([x, y])[there], z[there]
        depths.append(_interpolated(at, z, (camera.height, camera.width)))
        report("depths", (k + 1) / len(cameras))
    return depths


def _interpolated(at: np.ndarray, z: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Depths (H, W) float32 of points at (N, 2) [px], each hidden by nearer ones beside it."""
    if len(at) < POINTS_MIN:
        return np.zeros(shape, np.float32)
    tree = cKDTree(at)
    spacing = np.median(tree.query(at, k=min(4, len(at)))[0][:, -1])
    near = tree.query(at, k=min(8, len(at)), distance_upper_bound=CELL * spacing)[1]
    nearest = np.append(z, np.inf)[near].min(axis=1)
    visible = nearest > HIDDEN_RATIO * z
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    distance, index = cKDTree(at[visible]).query(np.column_stack([x.ravel(), y.ravel()]))
    return np.where(distance < GAP * spacing, z[visible][index], 0.0).reshape(shape).astype(np.float32)


@dataclass(frozen=True)
class SurfaceCloud:
    """Points (P, 3), their colours (P, 3) 0..1 and unit normals (P, 3) towards the cameras, and their spacing."""

    points: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    spacing: float
    tree: cKDTree
    graph: csr_matrix


def silhouettes(depth: np.ndarray) -> np.ndarray:
    """Mask (H, W) bool of pixels beside a jump of depth, or without depth."""
    low = cv2.erode(depth, np.ones((3, 3), np.uint8))
    return (low <= 0) | (cv2.dilate(depth, np.ones((3, 3), np.uint8)) > JUMP * low)


def surface_cloud(
    cameras: list[Camera],
    depths: list[np.ndarray],
    pictures: list[np.ndarray],
    centre: np.ndarray,
    radius: float,
    wanted: int = POINTS,
) -> SurfaceCloud | None:
    """Sample what all views show within a ball by about `wanted` points; None if they show nothing there."""
    stride = max(1, int(np.ceil(np.sqrt(sum(d.size for d in depths) / SAMPLES_MAX))))
    points, colors, ways = [], [], []
    for camera, depth, picture in zip(cameras, depths, pictures, strict=True):
        good = ~silhouettes(depth)
        y, x = np.nonzero(good[::stride, ::stride])
        p = camera.points_at(depth, stride * x, stride * y)
        near = np.linalg.norm(p - centre, axis=1) < radius
        points.append(p[near])
        colors.append(picture[stride * y[near], stride * x[near]] / 255.0)
        ways.append(camera.position - p[near])
    points, colors, ways = (np.concatenate(parts) for parts in (points, colors, ways))
    if len(points) < NORMAL_NEIGHBOURS:
        return None
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    spacing = radius / 60
    wanted = min(wanted, len(points))
    for _ in range(3):  # the number of cells on a surface falls with the square of their size
        cells, index, count = np.unique(
            np.floor((points - centre) / spacing).astype(np.int64), axis=0, return_inverse=True, return_counts=True
        )
        if 0.8 < len(cells) / wanted < 1.25:
            break
        spacing *= np.clip(np.sqrt(len(cells) / wanted), 0.25, 4.0)
    mean = csr_matrix((1.0 / count[index.ravel()], (index.ravel(), np.arange(len(points)))), (len(cells), len(points)))
    points, colors, ways = mean @ points, mean @ colors, mean @ ways
    if len(points) < NORMAL_NEIGHBOURS:
        return None
    tree = cKDTree(points)
    near = tree.query(points, k=NORMAL_NEIGHBOURS)[1]
    offset = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))[1][:, :, 0]
    normals *= np.where((normals * ways).sum(1) < 0, -1.0, 1.0)[:, None]
    graph = _graph(points, colors, normals, near[:, 1 : NEIGHBOURS + 1])
    return SurfaceCloud(points, colors, normals, float(spacing), tree, graph)


def spread(cloud: SurfaceCloud, seeds: np.ndarray, labels: int, behind: np.ndarray) -> np.ndarray:
    """Probability (P, labels) of each label, 0 the background, from seeds (P,) int; -1: no seed.

    behind  (P,) bool, points on planes of the background
    """
    side = diags(np.where(behind, 1.0, -1.0))
    across = 0.5 * (cloud.graph - side @ cloud.graph @ side)  # the edges with one end on a plane
    graph = (cloud.graph - (1.0 - np.exp(-OFF_PLANE)) * across).tocsr()
    return random_walk(graph, seeds, labels, leak=LEAK)


def planes_behind(cloud: SurfaceCloud, marked: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mask (P,) of points on large planes (floor, table, wall) that all marked points (M, 3) lie in front of."""
    found, left = np.zeros(len(cloud.points), bool), np.arange(len(cloud.points))
    step = PLANE_STEPS * cloud.spacing
    for _ in range(PLANES_MAX):
        if len(left) < PLANE_SHARE * len(cloud.points):
            break
        tries = rng.choice(left, min(PLANE_TRIES, len(left)), replace=False)
        sample = rng.choice(left, min(4000, len(left)), replace=False)
        best, most = None, 0.0
        for t in tries:
            n = cloud.normals[t]
            if ((marked - cloud.points[t]) @ n).min() < step:
                continue
            near = np.abs((cloud.points[sample] - cloud.points[t]) @ n) < step
            share = (near & (cloud.normals[sample] @ n > 0.9)).mean()
            if share > most:
                best, most = t, share
        if best is None:
            break
        n = cloud.normals[best]
        on = (np.abs((cloud.points[left] - cloud.points[best]) @ n) < step) & (cloud.normals[left] @ n > 0.8)
        if on.sum() < PLANE_SHARE * len(cloud.points):
            break
        usual = np.median(cloud.colors[left[on]], axis=0)  # what lies flat on it has other colours
        alike = np.linalg.norm(cloud.colors[left[on]] - usual, axis=1) < 1.5 * COLOR_STEP
        found[left[on][alike]] = True
        left = left[~on]
    return found


def _graph(points: np.ndarray, colors: np.ndarray, normals: np.ndarray, near: np.ndarray) -> csr_matrix:
    """Symmetric weights of neighbouring points."""
    one = np.repeat(np.arange(len(points)), near.shape[1])
    two = near.ravel()
    color = ((colors[one] - colors[two]) ** 2).sum(1) / COLOR_STEP**2
    bend = 1.0 - (normals[one] * normals[two]).sum(1)
    way = points[one] - points[two]
    concave = ((normals[one] - normals[two]) * way).sum(1) < 0
    weight = np.exp(-color.clip(None, COLOR_MOST) - np.where(concave, CONCAVE, CONVEX) * bend) + 1e-7
    graph = coo_matrix((weight, (one, two)), (len(points),) * 2).tocsr()
    return graph.maximum(graph.T)
