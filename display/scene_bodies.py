"""Bodies made of assets: those of a scene, placed and animated, and those that join a running play."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.animation import Animation
from assets.asset import Asset, split_components
from assets.gaussians import Gaussians
from assets.library import animated_height, default_material, find_asset
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.morton import morton_order
from core.rotation import best_fit_rotation, matrices_from_quaternions, pose_matrix
from core.vocabulary import Body, BodyState
from scenes.scene import Scene
from sim.bodies import RigidBody
from sim.contact.static_shapes import StaticGrid
from sim.embedding import EmbeddedBody
from sim.kinematic_targets import Skinning
from sim.solver import MAX_FRAME_DT, SoftBody, Solver

DROP_HEIGHT = 0.03  # [m] between a body and what it falls on
GAP = 0.01  # [m] between bounding boxes
RINGS, PLACES = 4, 12  # circles around the middle of the play on which an animated body may stand, places on each
ROUNDING = 1e-4  # [m]; a body closer to its targets has not been moved


@dataclass(frozen=True)
class Piece:
    """A body of the solver with its Gaussians, the animation that it may have, and the body of the scene that it is."""

    body: SoftBody | RigidBody
    part: EmbeddedBody
    animation: Animation | None
    placed: Body

    def targets(self, body: int) -> list[AnimationTargets]:
        """The animation, if it has one, as that of body number `body` of a solver."""
        led = self.animation is not None
        return [AnimationTargets(body, self.placed, self.animation, self.body.vertices)] if led else []


def load_bodies(scene: Scene) -> tuple[list[tuple[Gaussians, list[StaticGrid]]], list[Piece]]:
    """Read each asset once and place it: static ones in the world, simulated ones scaled in their own frame.

    The pieces of an asset are bodies of their own: its largest in the scene's order, all others after those.
    """
    library: dict[str, Asset] = {}
    pieces: dict[str, list[Asset]] = {}
    static, moving, others = [], [], []
    for body in scene.bodies:
        if body.asset not in library:
            library[body.asset] = Asset.load(find_asset(body.asset))
        if body.material is None:
            static.append(place_static(library[body.asset], body))
            continue
        if body.asset not in pieces:
            pieces[body.asset] = split_components(library[body.asset])
        largest, *rest = pieces[body.asset]
        moving.append((largest, body))
        others += [(asset, body) for asset in rest]
    return static, [place_soft(asset, body) for asset, body in [*moving, *others]]


def place_static(asset: Asset, body: Body) -> tuple[Gaussians, list[StaticGrid]]:
    """Gaussians in the world, and the colliders."""
    rotation = matrices_from_quaternions(np.array(body.rotation))
    gaussians = asset.gaussians.transformed(rotation, body.position, body.scale)
    friction = asset.material.friction if asset.material is not None else 0.5
    return gaussians, [StaticGrid(g, body.rotation, body.position, body.scale, friction) for g in asset.grids]


def place_soft(asset: Asset, body: Body) -> Piece:
    """The simulated body and its Gaussians, both at rest in the body's frame. Raises BadInput."""
    if asset.cage is None or asset.embedding is None:
        raise BadInput(f"{body.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    s = body.scale
    order = morton_order(asset.gaussians.means)
    vertices = asset.cage.vertices * np.float32(s)
    g = asset.gaussians.select(order)
    gaussians = replace(g, means=g.means * np.float32(s), log_scales=g.log_scales + np.float32(np.log(s)))
    sdf = None
    if asset.sdf is not None:
        d = asset.sdf
        sdf = DistanceGrid(np.asarray(d.values, np.float32) * s, np.asarray(d.origin) * s, float(d.spacing) * s)
    driven = None if asset.animation is None else asset.animation.vertices[asset.animation.driven]
    fixed = None if body.fixed_below is None else np.flatnonzero(asset.cage.vertices[:, 1] < body.fixed_below)
    motion = None
    if body.filmed:
        if asset.clip is None:
            raise BadInput(f"{body.asset}: has no clip (vrgs.py fit ASSET VIDEO keeps it)")
        fixed, motion = asset.clip.held, s * np.stack([asset.clip.positions, asset.clip.velocities])
    soft = SoftBody(
        name=body.asset,
        vertices=vertices,
        tets=asset.cage.tets,
        surface=asset.cage.surface,
        material=body.material,
        rotation=body.rotation,
        position=body.position,
        velocity=body.velocity,
        sdf=sdf,
        motion=motion,
        pinned=fixed if driven is None else driven,
        self_contact=True if driven is None else "parts",
        asleep=body.asleep,
    )
    part = EmbeddedBody(
        host=asset.embedding.host[order],
        weights=asset.embedding.weights[order],
        gaussians=gaussians,
        rest=vertices,
        tets=asset.cage.tets,
    )
    if body.kind == "soft":
        return Piece(soft, part, asset.animation, body)
    if body.kind not in ("rigid", "kinematic"):
        raise BadInput(f"{body.asset}: kind must be soft, rigid or kinematic, not {body.kind!r}")
    return Piece(RigidBody.from_soft(soft, kinematic=body.kind == "kinematic"), part, None, body)


class AnimationTargets:
    """The animation of body number `body` of a solver, where it is placed, `time` [s] after its start.

    placed    the body as the scene places it
    vertices  of the body at rest [m], scaled as it is placed, (V, 3)
    """

    def __init__(self, body: int, placed: Body, animation: Animation, vertices: np.ndarray):
        self.body, self.animation, self.time = body, animation, 0.0
        q = np.asarray(placed.rotation, np.float64)
        rotation = matrices_from_quaternions(q / np.linalg.norm(q))
        self.world_from_body = pose_matrix(placed.position, rotation * placed.scale)
        driven = animation.driven
        index = animation.vertices[driven]
        self.skinning = Skinning(
            index,
            vertices[index] / placed.scale,
            animation.joints[driven],
            animation.weights[driven],
            len(animation.parents),
        )

    def drive(self, solver: Solver, dt: float) -> None:
        """Give the solver the targets at the end of the next frame of dt [s]; none while it simulates no time."""
        if solver.interaction == "transform":
            return
        self.time += min(dt, MAX_FRAME_DT)
        self._pose(solver)
        solver.kinematic.drive_surface(self.body)

    def _pose(self, solver: Solver) -> None:
        matrices = self.world_from_body @ self.animation.matrices(self.time)
        self.skinning.pose(matrices, solver.kinematic.target, solver.vertex_offset[self.body])

    def at(self, time: float) -> AnimationTargets:
        """A copy at another time [s]."""
        other = copy(self)
        other.time = time
        return other

    def moved(self, by: np.ndarray, body: int | None = None) -> AnimationTargets:
        """A copy moved by an affine map (4, 4) of the world, for body number `body` if that is another one."""
        other = copy(self)
        other.world_from_body = by @ self.world_from_body
        other.body = self.body if body is None else body
        return other

    def placed_as(self, other: AnimationTargets) -> AnimationTargets:
        """A copy at the place and time of another one, for its body."""
        copied = self.at(other.time)
        copied.world_from_body, copied.body = other.world_from_body, other.body
        return copied

    def rebased(self, solver: Solver) -> AnimationTargets:
        """The animation relocated to where a hand has put the body while time stood still."""
        self._pose(solver)
        index = self.animation.vertices[self.animation.driven] + solver.vertex_offset[self.body]
        there, here = (f.to_numpy()[index].astype(np.float64) for f in (solver.kinematic.target, solver.x))
        if np.abs(here - there).max() < ROUNDING:
            return self
        rotation = best_fit_rotation((here - here.mean(0)).T @ (there - there.mean(0)))
        return self.moved(pose_matrix(here.mean(0) - rotation @ there.mean(0), rotation))


def pieces_of(asset: str, name: str = "") -> list[Piece]:
    """The bodies that an asset consists of, each in its own frame at the origin. Raises BadInput."""
    height, material = animated_height(asset), default_material(asset)
    placed = Body(asset, material if height is None else material.animated(height))
    pieces = [place_soft(piece, placed) for piece in split_components(Asset.load(find_asset(asset)))]
    return [replace(p, body=replace(p.body, name=name or Path(asset).stem)) for p in pieces]


def put_over(pieces: Sequence[Piece], scene: Scene, bodies: Sequence[BodyState]) -> list[Piece]:
    """The pieces over the middle of the play, clear of its bodies; animated ones stand beside them."""
    x = np.concatenate([p.body.vertices for p in pieces]).astype(np.float64)
    low, high = x.min(0), x.max(0)
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
