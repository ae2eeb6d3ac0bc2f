"""From a prepared body and a rig to a body that moves: cage, weights, embedding, motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.animation import Animation, Pose, close_loop, linear_blend_skinning, world_matrices
from assets.asset import Asset, Cage
from assets.formats.gltf_skin import Rig
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cage.embedding_hosts_reference import embed
from prepare.rig.body_parts import Parts, meets, parted, shortened
from prepare.rig.cage_cut import cut
from prepare.rig.landmarks import Landmarks
from prepare.rig.part_embedding import calmed, within
from prepare.rig.retargeting import BONES, PARENTS, fit
from prepare.rig.skin_weights import EDGES, HOLD, diffused, firm, least_volumes, strongest
from prepare.rig.solid_segmentation import Solid

LOOP = 0.3  # [s] in which a motion that does not come round is led to its start
JUMP = (0.01, 0.02)  # [statures], [rad]: what is less comes round by itself
CORE = 0.0201  # of the stature: a vertex so near to its bone is in it (rig_parts.THINNEST is the least that is told)
SHAPES = 48  # frames of the motion in which tets are looked at


@dataclass(frozen=True)
class Skeleton:
    """What moves a cage: joints as in Animation, and the share of each in each vertex."""

    names: list[str]
    parents: np.ndarray
    inverse_bind: np.ndarray
    rest: Pose
    frames: Pose
    fps: float


def dance(asset: Asset, rig: Rig, marks: Landmarks, solid: DistanceGrid | None = None) -> Asset:
    """A standing person with the motion of a rig that is not its own; `solid` is a finer grid of it than the asset's.

    Raises BadInput.
    """
    fitted = fit(rig, marks)
    height = float(np.ptp(asset.cage.vertices[:, 1]))
    person = parted(Solid.of(solid or asset.sdf), fitted, marks, height)
    joined = meets(fitted)
    cage, label, _ = cut(asset.cage, person.of_tets(asset.cage), joined)
    V, J = len(cage.vertices), len(BONES)
    votes = np.bincount(cage.tets.ravel().astype(np.int64) * J + np.repeat(label, 4), minlength=V * J).reshape(V, J)
    target = np.eye(J)[np.argmax(votes, axis=1)]
    off = person.off_bone(cage.vertices)
    weights = diffused(cage.vertices, cage.tets, HOLD / off**2, target)
    steps = fitted.rest - np.where((PARENTS >= 0)[:, None], fitted.rest[PARENTS], 0.0)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (J, 1))
    inverse = np.tile(np.eye(4), (J, 1, 1))
    inverse[:, :3, 3] = -fitted.rest
    rest = (steps, upright, np.ones((J, 3)))
    own = Skeleton(BONES, PARENTS, inverse, rest, fitted.frames, rig.fps)
    parts = Parts(label, person.of_points(asset.gaussians.means), joined)
    gaussians, fewer = shortened(asset.gaussians, person, joined)
    moving = animated(
        replace(asset, gaussians=gaussians), cage, parts, own, weights, on_ground=True, core=off <= CORE * height
    )
    of_rig = {
        "shortened": fewer,
        "motion": rig.animation,
        "landmarks": {k: {"at": np.round(v, 4).tolist(), "from": marks.source[k]} for k, v in marks.points.items()},
        "residual": {k: [round(v, 4) for v in values] for k, values in fitted.residual.items()},
        "held": [{"by": h.by, "center": np.round(h.center, 4).tolist(), "radius": round(h.radius, 4)}
                 for h in person.held],
    }  # fmt: skip
    return with_provenance(moving, of_rig)


def animated(
    asset: Asset,
    cage: Cage,
    parts: Parts,
    own: Skeleton,
    weights: np.ndarray,
    *,
    on_ground: bool,
    core: np.ndarray | None = None,
) -> Asset:
    """The asset with this cage, cut or not, its Gaussians embedded anew, and the motion. Raises BadInput.

    weights  share of each joint in each vertex, (V, J);  core  those in the bones, (V,) bool
    """
    frames = come_round(own, float(np.ptp(cage.vertices[:, 1])))
    joints, strong = strongest(weights)
    matrices = world_matrices(own.parents, frames) @ own.inverse_bind
    picked = np.linspace(0, len(matrices), min(SHAPES, len(matrices)), endpoint=False).astype(int)
    shapes = np.stack(
        [cage.vertices.astype(np.float64)] + [linear_blend_skinning(cage.vertices, joints, strong, matrices[k]) for k in picked]
    )
    if on_ground:
        lift = shapes[0, :, 1].min() - shapes[1:, :, 1].min()
        frames[0][:, 0, 1] += lift
        shapes[1:, :, 1] += lift
    surface = np.unique(cage.surface)
    leader = np.where(np.isin(joints[:, 0], own.parents), joints[:, 0], -1)
    driven = firm(cage.vertices, strong, cage.tets, surface, shapes, core, leader)
    led = np.union1d(surface, np.flatnonzero(driven))
    g = asset.gaussians
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    embedded, mended = within(embedded, g.means.astype(np.float64), cage, parts)
    embedded, rehung = calmed(embedded, g, cage, parts, shapes)
    motion = Animation(
        list(own.names),
        np.asarray(own.parents, np.int32),
        own.inverse_bind,
        own.rest,
        frames,
        own.fps,
        led.astype(np.int32),
        joints[led],
        strong[led],
        driven[led],
    )
    least = least_volumes(cage.tets, shapes)
    figures = {
        "joints": len(own.names),
        "frames": len(frames[0]),
        "seconds": round(float(motion.duration), 3),
        "driven": int(driven[surface].sum()),
        "driven_in_bones": int(driven.sum() - driven[surface].sum()),
        "surface": len(surface),
        "added_vertices": len(cage.vertices) - len(asset.cage.vertices),
        "least_volume_driven": round(float(least[driven[cage.tets].all(1)].min(initial=1.0)), 3),
        "least_volume_skinned": round(float(least.min()), 3),
        "largest_stretch_skinned": round(largest_stretch(cage.tets, shapes), 2),
        "kept_to_their_part": mended,
        "kept_calm": rehung,
    }
    moving = replace(asset, cage=cage, embedding=embedded, animation=motion)
    return with_provenance(moving, figures)


def come_round(own: Skeleton, size: float) -> Pose:
    """The frames of a motion without the last, which is the first again, or is made so."""
    t, q, s = (np.array(x) for x in own.frames)
    if own.fps <= 0 or len(t) < 2:
        raise BadInput("the motion has no frames")
    angle = 2 * np.arccos(np.abs((q[0] * q[-1]).sum(-1)).clip(0, 1)).max()
    if np.abs(t[0] - t[-1]).max() < JUMP[0] * size and angle < JUMP[1]:
        return t[:-1], q[:-1], s[:-1]
    return close_loop((t, q, s), LOOP, own.fps)


def largest_stretch(tets: np.ndarray, shapes: np.ndarray) -> float:
    """Of an edge of the tets in shapes (F, V, 3), of 1 in the first."""
    ends = np.unique(np.sort(tets[:, EDGES].reshape(-1, 2), axis=1), axis=0)
    length = [np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1) for x in shapes]
    return float(max((n / length[0]).max() for n in length))


def with_provenance(asset: Asset, of_rig: dict) -> Asset:
    """The asset with more said under "rig"."""
    return replace(asset, provenance=asset.provenance | {"rig": asset.provenance.get("rig", {}) | of_rig})
