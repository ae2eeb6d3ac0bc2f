"""The bodies of a scene: their assets read once, placed in the world or in their own frame, and animated."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from assets.animation import Animation
from assets.asset import Asset
from assets.components import split_components
from assets.gaussians import Gaussians
from assets.library import find_asset
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.morton import morton_order
from core.rotation import best_fit_rotation, matrices_from_quaternions
from core.vocabulary import Body
from scenes.scene import Scene
from sim.contact.static_shapes import StaticGrid
from sim.embedding import EmbeddedBody
from sim.kinematic_targets import Skinning
from sim.rigid.rigid_body import RigidBody
from sim.solver import MAX_FRAME_DT, SoftBody, Solver


def load_bodies(
    scene: Scene,
) -> tuple[
    list[tuple[Gaussians, list[StaticGrid]]],
    list[tuple[SoftBody | RigidBody, EmbeddedBody]],
    dict[int, tuple[Body, Animation]],
    list[int],
]:
    """Read each asset once and place it: static ones in the world, simulated ones scaled in their own frame.

    The pieces of an asset are bodies of their own: its largest in the scene's order, all others after those.

    Out.  static bodies, simulated bodies, and the animated ones and the indices of the captured ones among the latter
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
    placed = [*moving, *others]
    animated = {
        k: (body, asset.animation)
        for k, (asset, body) in enumerate(placed)
        if asset.animation is not None and body.kind == "soft"
    }
    captured = [k for k, (_, body) in enumerate(placed) if body.captured]
    return static, [place_soft(asset, body) for asset, body in placed], animated, captured


def place_static(asset: Asset, body: Body) -> tuple[Gaussians, list[StaticGrid]]:
    """Gaussians in the world, and the colliders."""
    rotation = matrices_from_quaternions(np.array(body.rotation))
    gaussians = asset.gaussians.transformed(rotation, body.position, body.scale)
    friction = asset.material.friction if asset.material is not None else 0.5
    return gaussians, [StaticGrid(g, body.rotation, body.position, body.scale, friction) for g in asset.grids]


def place_soft(asset: Asset, body: Body) -> tuple[SoftBody | RigidBody, EmbeddedBody]:
    """The simulated body and its Gaussians, both at rest in the body's frame."""
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
    led = None if asset.animation is None else asset.animation.vertices[asset.animation.driven]
    fixed = None if body.fixed_below is None else np.flatnonzero(asset.cage.vertices[:, 1] < body.fixed_below)
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
        pinned=fixed if led is None else led,
        self_contact=True if led is None else "parts",
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
        return soft, part
    if body.kind not in ("rigid", "kinematic"):
        raise BadInput(f"{body.asset}: kind must be soft, rigid or kinematic, not {body.kind!r}")
    return RigidBody.from_soft(soft, kinematic=body.kind == "kinematic"), part


ROUNDING = 1e-4  # [m]; a body closer to its targets has not been moved


class AnimationTargets:
    """The animation of body number `body` of a solver, where it is placed, `time` [s] after its start.

    placed    the body as the scene places it
    vertices  of the body at rest [m], scaled as it is placed, (V, 3)
    """

    def __init__(self, body: int, placed: Body, animation: Animation, vertices: np.ndarray, solver: Solver):
        self.body, self.animation, self.time = body, animation, 0.0
        q = np.asarray(placed.rotation, np.float64)
        self.world_from_body = np.eye(4)
        self.world_from_body[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0] * placed.scale
        self.world_from_body[:3, 3] = placed.position
        driven = animation.driven
        index = animation.vertices[driven]
        self.skinning = Skinning(
            solver.vertex_offset[body],
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
        by = np.eye(4)
        by[:3, :3] = best_fit_rotation((here - here.mean(0)).T @ (there - there.mean(0)))
        by[:3, 3] = here.mean(0) - by[:3, :3] @ there.mean(0)
        return self.moved(by)
