"""From a prepared body and a rig (its own .glb, or one given with a splat) to an animated body."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.animation import Animation, Pose, close_loop, linear_blend_skinning, world_matrices
from assets.asset import Asset, Cage
from assets.formats.gltf import Rig
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from prepare.cage.embedding_hosts import embed
from prepare.rig import skin_weights
from prepare.rig.body_segmentation import Segments, cut, segment_person, shortened, skeleton_adjacency
from prepare.rig.landmarks import Landmarks, Solid
from prepare.rig.retargeting import BONES, PARENTS, retarget

LOOP_BLEND = 0.3  # [s] in which a motion that does not return to its start is blended to it
MAX_LOOP_GAP = (0.01, 0.02)  # [statures], [rad]; a motion with less returns by itself
CORE_RADIUS = 0.0201  # of the stature; a vertex this near to its bone is in it (MIN_DISTANCE is the least told)
SAMPLED_FRAMES = 48  # of the motion, in which tets are examined


@dataclass(frozen=True)
class Skeleton:
    """Joints and frames of a motion, as in Animation."""

    names: list[str]
    parents: np.ndarray
    inverse_bind: np.ndarray
    rest: Pose
    frames: Pose
    fps: float


def animate_person(asset: Asset, rig: Rig, landmarks: Landmarks, solid: DistanceGrid) -> Asset:
    """Give a standing person the motion of another's rig. Raises BadInput.

    solid  the distance grid that the cage was made from, finer than the asset's
    """
    body = retarget(rig, landmarks)
    height = float(np.ptp(asset.cage.vertices[:, 1]))
    person = segment_person(Solid.of(solid), body, landmarks, height)
    joined = skeleton_adjacency(body)
    cage, label, _ = cut(asset.cage, person.bone_of_tets(asset.cage), joined)
    J = len(BONES)
    votes = np.zeros((len(cage.vertices), J), int)
    np.add.at(votes, (cage.tets, label[:, None]), 1)
    target = np.eye(J)[np.argmax(votes, axis=1)]
    off = person.bone_distance(cage.vertices)
    weights = skin_weights.diffuse_weights(cage.vertices, cage.tets, skin_weights.HOLD / off**2, target)
    steps = body.rest - np.where((PARENTS >= 0)[:, None], body.rest[PARENTS], 0.0)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (J, 1))
    inverse = np.tile(np.eye(4), (J, 1, 1))
    inverse[:, :3, 3] = -body.rest
    rest = (steps, upright, np.ones((J, 3)))
    own = Skeleton(BONES, PARENTS, inverse, rest, body.frames, rig.fps)
    segments = Segments(label, person.bone_of_points(asset.gaussians.means), joined)
    asset = replace(asset, gaussians=shortened(asset.gaussians, person, joined))
    core = off <= CORE_RADIUS * height
    moving = with_animation(asset, cage, segments, own, weights, core, on_ground=True)
    of_rig = {
        "motion": rig.animation,
        "landmarks": {
            k: {"at": np.round(v, 4).tolist(), "from": landmarks.source[k]} for k, v in landmarks.points.items()
        },
        "residual": {k: round(v, 4) for k, v in body.residual.items()},
        "held": [
            {"by": h.by, "center": np.round(h.center, 4).tolist(), "radius": round(h.radius, 4)} for h in person.held
        ],
    }
    return with_provenance(moving, of_rig)


def with_animation(
    asset: Asset,
    cage: Cage,
    segments: Segments,
    own: Skeleton,
    weights: np.ndarray,
    core: np.ndarray,
    *,
    on_ground: bool,
) -> Asset:
    """The asset with this cage, cut or not, its Gaussians embedded again, and the motion. Raises BadInput.

    weights    skin weights (V, J);  core  vertices in the bones, (V,) bool
    on_ground  the motion is lifted or lowered so that its lowest point is that of the body at rest
    """
    frames = looping_frames(own, float(np.ptp(cage.vertices[:, 1])))
    joints, strong = skin_weights.largest_influences(weights)
    matrices = world_matrices(own.parents, frames) @ own.inverse_bind
    picked = np.linspace(0, len(matrices), min(SAMPLED_FRAMES, len(matrices)), endpoint=False).astype(int)
    skinned = [linear_blend_skinning(cage.vertices, joints, strong, matrices[k]) for k in picked]
    shapes = np.stack([cage.vertices.astype(np.float64), *skinned])
    if on_ground:
        lift = shapes[0, :, 1].min() - shapes[1:, :, 1].min()
        frames[0][:, 0, 1] += lift
        shapes[1:, :, 1] += lift
    surface = np.unique(cage.surface)
    leader = np.where(np.isin(joints[:, 0], own.parents), joints[:, 0], -1)
    driven = skin_weights.driven_vertices(cage.vertices, strong, cage.tets, surface, shapes, core, leader)
    led = np.union1d(surface, np.flatnonzero(driven))
    g = asset.gaussians
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), cage.vertices, cage.tets)
    embedded = skin_weights.keep_to_segments(embedded, g.means.astype(np.float64), cage, segments)
    embedded = skin_weights.without_spikes(embedded, g, cage, segments, shapes)
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
    least = skin_weights.least_volumes(cage.tets, shapes)
    figures = {
        "joints": len(own.names),
        "frames": len(frames[0]),
        "seconds": round(float(motion.duration), 3),
        "driven": int(driven[surface].sum()),
        "surface": len(surface),
        "least_volume_driven": round(float(least[driven[cage.tets].all(1)].min(initial=1.0)), 3),
        "least_volume_skinned": round(float(least.min()), 3),
    }
    moving = replace(asset, cage=cage, embedding=embedded, animation=motion)
    return with_provenance(moving, figures)


def looping_frames(own: Skeleton, size: float) -> Pose:
    """Frames of a motion that repeats, without the last, which is the first again or is made so."""
    t, q, s = (np.array(x) for x in own.frames)
    if own.fps <= 0 or len(t) < 2:
        raise BadInput("the motion has no frames")
    angle = 2 * np.arccos(np.abs((q[0] * q[-1]).sum(-1)).clip(0, 1)).max()
    if np.abs(t[0] - t[-1]).max() < MAX_LOOP_GAP[0] * size and angle < MAX_LOOP_GAP[1]:
        return t[:-1], q[:-1], s[:-1]
    return close_loop((t, q, s), LOOP_BLEND, own.fps)


def with_provenance(asset: Asset, of_rig: dict) -> Asset:
    """The asset with more entries under "rig" in its provenance."""
    return replace(asset, provenance=asset.provenance | {"rig": asset.provenance.get("rig", {}) | of_rig})
