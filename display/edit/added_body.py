"""A body of the user's that joins a running play: its pieces, and a place for it over the play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.animation import Animation
from assets.asset import Asset
from assets.components import split_components
from assets.gaussians import Gaussians
from assets.library import animated_height, default_material, find_asset
from core.vocabulary import Body, BodyState
from display.scene_bodies import place_soft
from scenes.roles import bounds
from scenes.scene import Scene
from sim.embedding import EmbeddedBody
from sim.rigid.rigid_body import RigidBody
from sim.solver import SoftBody

DROP_HEIGHT = 0.03  # [m] between a body and what it falls on
GAP = 0.01  # [m] between bounding boxes
RINGS, PLACES = 4, 12  # circles around the middle of the play on which an animated body may stand, places on each


@dataclass(frozen=True)
class Piece:
    """A body of the solver with its Gaussians, and the animation that it may have."""

    body: SoftBody | RigidBody
    part: EmbeddedBody
    animation: Animation | None
    placed: Body


def pieces_of(asset: str, name: str = "") -> list[Piece]:
    """The bodies that an asset consists of, each in its own frame at the origin. Raises BadInput."""
    height, material = animated_height(asset), default_material(asset)
    placed = Body(asset, material if height is None else material.animated(height))
    pieces = []
    for piece in split_components(Asset.load(find_asset(asset))):
        body, part = place_soft(piece, placed)
        pieces.append(Piece(replace(body, name=name or Path(asset).stem), part, piece.animation, placed))
    return pieces


def put_over(pieces: Sequence[Piece], scene: Scene, bodies: Sequence[BodyState]) -> list[Piece]:
    """The pieces over the middle of the play, clear of its bodies; animated ones stand beside them."""
    placed = pieces[0].placed
    low, high = bounds(placed.asset, placed)
    spot = np.array(scene.room.spot if scene.room is not None else scene.target, np.float64)
    foot = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    if any(p.animation is not None for p in pieces):
        position = standing_place(spot, high - low, bodies) - foot
    else:
        position = spot + [0.0, DROP_HEIGHT, 0.0] - foot
        for body in sorted(bodies, key=lambda b: b.low[1]):
            if overlap(low + position, high + position, body):
                position[1] = body.high[1] + DROP_HEIGHT - low[1]
    at = tuple(map(float, position))
    return [replace(p, body=replace(p.body, position=at), placed=replace(p.placed, position=at)) for p in pieces]


def standing_place(spot: np.ndarray, size: np.ndarray, bodies: Sequence[BodyState]) -> np.ndarray:
    """The point (3,) nearest to the spot on which a body of this size [m] meets no other; the spot if there is none."""
    radius = 0.5 * float(max(size[0], size[2])) + GAP
    for k in range(RINGS + 1):
        for angle in 2 * np.pi / PLACES * np.arange(PLACES if k else 1):
            at = spot + k * radius * np.array([np.sin(angle), 0.0, np.cos(angle)])
            low = at - [0.5 * size[0], 0.0, 0.5 * size[2]]
            if not any(overlap(low, low + size, body) for body in bodies):
                return at
    return spot


def overlap(low: np.ndarray, high: np.ndarray, body: BodyState) -> bool:
    """True if a box meets a body's bounding box, or nearly."""
    return bool((low - GAP < body.high).all() and (body.low < high + GAP).all())


def fitted_harmonics(gaussians: Gaussians, coefficients: int) -> np.ndarray:
    """Harmonics (N, coefficients, 3) of the Gaussians: those of higher degrees are left out, missing ones are zero."""
    sh = np.zeros((len(gaussians), coefficients, 3), np.float32)
    shared = min(coefficients, gaussians.sh.shape[1])
    sh[:, :shared] = gaussians.sh[:, :shared]
    return sh
