"""The shadow of an object on its surroundings, which is removed with the object.

Under light from all directions w_j, occluders take from the light on a surface

    d(x) = sum_j b_j max(0, n . w_j) (1 - V_j(x)),                   V_j: the share of light that passes them,

and the surface shows E(x) = e - d(x). V_j follows from the object's shape, by shadow maps from all w_j; e and b_j >= 0
are fitted to what the supporting surface shows around the object's foot. Colours are then multiplied by E without the
object over E with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.camera import directions_around, look_at, perspective
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.inpaint.hole_views import HoleView, Surroundings, image_positions, sampled, spread_indices
from prepare.inpaint.support_surface import SurfaceTexture, normals_of

DIRECTIONS = 64  # over the half sphere above the surface
FAR = 12.0  # radii of a thing to the eye of its shadow map: nearly parallel light
MAP_SIDE = 96  # [px]
BIAS = 0.05  # radii in front of a surface that do not shade it: it is thick and noisy, too
TEXELS = 2500  # that the light is found from
EVEN = 0.1  # weight of small b_j
NEIGHBOURS = 16  # of a texel, whose differences must show the shadow that was found
ROUNDS = 6  # of least squares, with weights that leave out marks and other things on the surface
DARKEST = 0.2  # of the light that the object leaves: beyond, colours are noise
REACH = 5.0  # radii from the object's middle: where its shadow is taken away


class ShadowMaps:
    """Shadow maps of an object: the share of light from directions (J, 3) that passes it."""

    def __init__(self, drawing: BlendingWeights, thing: Gaussians, directions: np.ndarray):
        ball = Surroundings.of(thing)
        radius = float(np.linalg.norm(thing.means - ball.centre, axis=1).max())
        eyes = ball.centre + FAR * radius * directions
        angle = 2.2 / FAR  # of the whole thing, with the width of its outermost Gaussians
        self._cameras = [perspective(MAP_SIDE, MAP_SIDE, angle, look_at(eye, ball.centre)) for eye in eyes]
        drawing.replace(thing)
        self._maps = [drawing.picture(camera)[1:] for camera in self._cameras]

    def passing(self, points: np.ndarray, bias: float) -> np.ndarray:
        """Light (N, J), 0..1, that reaches points (N, 3); occluders nearer than `bias` [m] to a point do not count."""
        found = np.ones((len(points), len(self._cameras)), np.float32)
        for k, (camera, (depth, alpha)) in enumerate(zip(self._cameras, self._maps, strict=True)):
            at, z = image_positions(camera, points)
            shades = sampled(depth, at, outside=np.inf) < z - bias
            found[shades, k] -= sampled(cv2.GaussianBlur(alpha, (3, 3), 0), at)[shades]
        return found


@dataclass(frozen=True)
class ObjectShadow:
    """The light from directions (J, 3) that a surface loses (J,), relative to all that reaches it without occluders."""

    directions: np.ndarray
    lost: np.ndarray
    own: ShadowMaps
    others: ShadowMaps | None
    bias: float

    def left(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Share (N,) of the light that the object leaves to points (N, 3) with unit normals, DARKEST to 1."""
        toward = (normals @ self.directions.T).clip(0.0) * self.lost
        without = np.ones((len(points), 1)) if self.others is None else self.others.passing(points, self.bias)
        there = self.own.passing(points, self.bias) * without
        open_to = 1.0 - (toward * (1.0 - without)).sum(axis=1)
        shaded = 1.0 - (toward * (1.0 - there)).sum(axis=1)
        return (shaded / np.maximum(open_to, DARKEST)).clip(DARKEST, 1.0)


def find_shadow(
    drawing: BlendingWeights, removed: Gaussians, others: Gaussians, texture: SurfaceTexture, ball: Surroundings
) -> ObjectShadow | None:
    """Fit the shadow of an object, among others, on a surface; None if more of the surface is hidden than seen."""
    y, x = np.nonzero(texture.known)
    if len(y) <= texture.hole.sum():
        return None
    chosen = spread_indices(len(y), TEXELS)
    y, x = y[chosen], x[chosen]
    points = texture.surface.points(texture.places()[y, x])
    directions = half_sphere(DIRECTIONS) @ texture.surface.axes
    own, bias = ShadowMaps(drawing, removed, directions), BIAS * ball.radius
    maps = ShadowMaps(drawing, others, directions) if len(others) else None
    passing = own.passing(points, bias)
    if maps is not None:
        passing = passing * maps.passing(points, bias)
    cosines = directions @ texture.surface.axes[2]
    across = np.stack([x / texture.hole.shape[1], y / texture.hole.shape[0]], axis=1) - 0.5
    lost = fit_light(texture.color[y, x].mean(axis=1), cosines * (1.0 - passing) / cosines.sum(), across)
    return ObjectShadow(directions, lost / cosines.sum(), own, maps, bias)


def fit_light(shown: np.ndarray, hidden: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Non-negative b (J,) in shown (N,) = e (1 - hidden b), hidden (N, J), as far as it is `confirmed`.

    e >= 0 is linear in the place `across` (N, 2), -0.5 to 0.5.
    """
    n, count = hidden.shape
    tilts = np.concatenate([np.ones((n, 1)), 0.5 + across, 0.5 - across], axis=1)  # each >= 0, as their weights are
    columns, zeros = tilts.shape[1], np.zeros((count, tilts.shape[1]))
    small = np.concatenate([zeros, EVEN * np.sqrt(n) / count * np.eye(count)], axis=1)
    rows = np.concatenate([tilts, -hidden], axis=1)
    values, weights = shown / np.median(shown), np.ones(n)
    for _ in range(ROUNDS):
        weighted = np.concatenate([rows * weights[:, None], small])
        found, _ = nnls(weighted, np.concatenate([values * weights, np.zeros(count)]))
        off = values - rows @ found
        weights = 1.0 / np.sqrt(1.0 + (off / (1.48 * np.median(np.abs(off)) + 1e-6)) ** 2)
    open_light = float((tilts @ found[:columns]).mean())
    lost = found[columns:] / max(open_light, 1e-9)
    return lost * confirmed(shown, 1.0 - hidden @ lost, across)


def confirmed(shown: np.ndarray, left: np.ndarray, across: np.ndarray) -> float:
    """Confirmation of a fitted shadow by differences between neighbouring places (N, 2), 0..1: the median ratio of the
    difference of log `shown` (N,) to that of log `left` (N,).

    As a whole, dark wood around the foot in front of a white wall looks like a shadow, but only few neighbours differ.
    """
    near = cKDTree(across).query(across, k=min(NEIGHBOURS + 1, len(across)))[1]
    color = np.log(np.maximum(shown, DARKEST * np.median(shown)))
    light = np.log(np.maximum(left, DARKEST))[near].mean(axis=1)  # without the steps of light from few directions
    steps, seen = ((x[near[:, 1:]] - x[:, None]).ravel() for x in (light, color))
    steps, seen = steps[steps != 0.0], seen[steps != 0.0]
    order = np.argsort(seen / steps)
    weight = np.cumsum(np.abs(steps)[order])
    return float((seen / steps)[order][np.searchsorted(weight, 0.5 * weight[-1])].clip(0.0, 1.0)) if len(steps) else 0.0


def half_sphere(count: int) -> np.ndarray:
    """Unit directions (count, 3) evenly over the half sphere around +z."""
    return directions_around(2 * count)[:count, [0, 2, 1]]


def without_shadow(background: Gaussians, shadow: ObjectShadow, ball: Surroundings, views: list[HoleView]) -> Gaussians:
    """The background in its colours without the object's shadow; all else stays."""
    near = np.linalg.norm(background.means - ball.centre, axis=1) < REACH * ball.radius
    part = background.select(near)
    if len(part) < 3:  # no normals
        return background
    points = part.means.astype(np.float64)
    eye = np.mean([view.camera.position for view in views], axis=0)
    normals = normals_of(points)
    normals *= np.where(((eye - points) * normals).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    left = shadow.left(points, normals)
    sh, lit = background.sh.copy(), part.sh / left[:, None, None]
    lit[:, 0] += ((1.0 / left - 1.0) * 0.5 / C0)[:, None]  # colour = 0.5 + SH
    sh[near] = np.where((left < 1.0)[:, None, None], lit, part.sh)
    return replace(background, sh=sh)


def textures_without_shadow(textures: list[SurfaceTexture], shadow: ObjectShadow) -> list[SurfaceTexture]:
    """The textures in their colours without the object's shadow."""
    found = []
    for texture in textures:
        points = texture.surface.points(texture.places()[texture.known])
        left = shadow.left(points, np.broadcast_to(texture.surface.axes[2], points.shape))
        color = texture.color.copy()
        color[texture.known] /= left[:, None]
        found.append(replace(texture, color=color.clip(0.0, 1.0)))
    return found
