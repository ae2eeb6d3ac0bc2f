"""Source of a body's motion: the rig given with a splat, or the body's own .glb, a skinned mesh.

Of a skinned mesh: Gaussians on its surface, its skeleton, and its weights transferred to a cage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from assets.animation import decompose, local_matrices, world_matrices
from assets.asset import Asset, Cage
from assets.formats.gltf import GlbFile, Rig, SkinnedMesh, linear_from_srgb, read_mesh, read_rig, srgb_from_linear
from assets.gaussians import Gaussians
from assets.orientation import rotation_to_up
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.point_location import TetLocator
from core.rotation import turns_to
from core.spherical_harmonics import C0
from core.tetmesh import TET_EDGES, triangle_areas, vertex_components
from prepare.rig.body_segmentation import Joined, Segments, cut
from prepare.rig.landmarks import landmarks_of, read_landmarks
from prepare.rig.rigging import Skeleton, animate_person, with_animation, with_provenance
from prepare.rig.skin_weights import diffuse_weights

GAUSSIANS = 60_000
GAUSSIAN_SIGMA = 0.75  # standard deviation over the spacing of samples: closed where these are uneven
FLATNESS = 0.1  # thickness over width
OPACITY = 4.0  # logit
R2 = (0.7548776662466927, 0.5698402909980532)  # Roberts' R2 sequence: even in the plane
MAX_SHEAR = 0.02  # of a joint at rest, taken for rounding
JOINED_RADIUS = 2.5  # edges of the cage, about where two joints' segments touch on the mesh


@dataclass(frozen=True)
class Samples:
    """Points spread evenly on a mesh: the face (N,) and barycentric weights (N, 3) of each; spacing [m]."""

    face: np.ndarray
    weights: np.ndarray
    spacing: float

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Values at the corners of each face (F, 3, k), interpolated to the points, (N, k)."""
        return np.einsum("nk,nkd->nd", self.weights, values[self.face])


def sample_mesh(vertices: np.ndarray, faces: np.ndarray) -> Samples:
    """Points on triangles, GAUSSIANS in number, in proportion to area. Raises BadInput if there is no area."""
    area = triangle_areas(vertices, faces)
    total = area.sum()
    if not (np.isfinite(total) and total > 0):
        raise BadInput("the mesh has no area")
    k = np.arange(GAUSSIANS)
    face = np.searchsorted(np.cumsum(area), (k + 0.5) / GAUSSIANS * total).clip(0, len(faces) - 1)
    a, b = ((0.5 + k * t) % 1.0 for t in R2)
    over = a + b > 1
    a, b = np.where(over, 1 - a, a), np.where(over, 1 - b, b)
    return Samples(face, np.stack([1 - a - b, a, b], 1), float(np.sqrt(total / GAUSSIANS)))


def surface_gaussians(vertices: np.ndarray, mesh: SkinnedMesh, at: Samples) -> Gaussians:
    """Flat Gaussians on the mesh with these vertices (V, 3), in its colours."""
    v = vertices[mesh.faces]
    normals = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])[at.face]  # of triangles with an area
    quats = turns_to(normals, np.zeros(len(normals)))
    sigma = GAUSSIAN_SIGMA * at.spacing
    scales = np.log(np.tile([sigma, sigma, FLATNESS * sigma], (len(at.face), 1)))
    linear = at.interpolate(mesh.colours)
    uv, texture = at.interpolate(mesh.uv), mesh.texture[at.face]
    for k, pixels in enumerate(mesh.textures):
        textured = texture == k
        height, width = pixels.shape[:2]
        place = np.floor((uv[textured] % 1.0) * [width, height]).astype(int).clip(0, [width - 1, height - 1])
        linear[textured] *= linear_from_srgb(pixels[place[:, 1], place[:, 0]] / 255.0)
    sh = ((srgb_from_linear(linear) - 0.5) / C0)[:, None]
    return Gaussians.of(at.interpolate(v), quats, scales, np.full(len(quats), OPACITY), sh)


def scene_from_mesh(rig: Rig) -> np.ndarray:
    """Matrix (4, 4) from the mesh's own frame to the scene's, where the skin's first joint is at rest."""
    first = int(np.argmin(rig.joints))  # parents come first
    return world_matrices(rig.parents, rig.rest)[rig.joints[first]] @ rig.inverse_bind[first]


def skeleton_of(rig: Rig, at_rest: np.ndarray, asset_from_scene: np.ndarray) -> tuple[Skeleton, np.ndarray]:
    """The rig's joints and their ancestors, under one that holds the similarity transform `asset_from_scene` (4, 4).

    Out.  the skeleton, whose rest pose is the mesh as in the file, and the index in it of each joint of the skin
    """
    wanted = np.zeros(len(rig.names), bool)
    wanted[rig.joints] = True
    for j in range(len(wanted) - 1, -1, -1):
        if wanted[j] and rig.parents[j] >= 0:
            wanted[rig.parents[j]] = True
    nodes = np.flatnonzero(wanted)
    place = np.full(len(wanted) + 1, -1)  # of -1, the last: none
    place[nodes] = np.arange(len(nodes)) + 1
    parents = np.r_[-1, np.where(rig.parents[nodes] < 0, 0, place[rig.parents[nodes]])]
    bind = {int(j): np.linalg.inv(m) for j, m in zip(rig.joints, rig.inverse_bind, strict=True)}
    local = local_matrices(rig.rest)
    world = np.empty((len(nodes) + 1, 4, 4))
    world[0] = asset_from_scene
    for k, j in enumerate(nodes, 1):
        known = int(j) in bind
        world[k] = asset_from_scene @ at_rest @ bind[int(j)] if known else world[parents[k]] @ local[j]
    steps = world.copy()
    steps[1:] = np.linalg.inv(world[parents[1:]]) @ world[1:]
    t, q, s, off = decompose(steps)
    if off.max() > MAX_SHEAR:
        raise BadInput("the rig's joints shear or mirror at rest; such a skeleton cannot be animated")
    count = len(rig.frames[0])
    frames = [
        np.concatenate([np.tile(x[:1], (count, 1, 1)), f[:, nodes]], 1)
        for x, f in zip((t, q, s), rig.frames, strict=True)
    ]
    names = ["asset", *(rig.names[j] for j in nodes)]
    return Skeleton(names, parents, np.linalg.inv(world), (t, q, s), tuple(frames), rig.fps), place[rig.joints]


def animate_mesh(asset: Asset, mesh: SkinnedMesh, rig: Rig, at: Samples) -> Asset:
    """The asset prepared from the mesh's Gaussians, with the rig's motion. Raises BadInput."""
    at_rest, done = scene_from_mesh(rig), asset.provenance
    similarity = np.eye(4)
    similarity[:3, :3] = done["metres_per_unit"] * rotation_to_up(done["up"])
    similarity[:3, 3] = done["moved"]
    own, place = skeleton_of(rig, at_rest, similarity)
    J = len(own.names)
    skin = np.zeros((len(mesh.vertices), J))
    np.add.at(skin, (np.arange(len(skin))[:, None], place[mesh.joints]), mesh.weights)
    to_asset = similarity @ at_rest
    x = mesh.vertices @ to_asset[:3, :3].T + to_asset[:3, 3]
    points, target = at.interpolate(x[mesh.faces]), at.interpolate(skin[mesh.faces])
    weights = transferred_weights(asset.cage, points, target)
    label = np.argmax(weights[asset.cage.tets].mean(1), axis=1)
    joined = mesh_adjacency(asset.cage, own.parents, x, mesh.faces, np.argmax(skin, 1))
    cage, label, _ = cut(asset.cage, label, joined)
    weights = transferred_weights(cage, points, target)
    nearest = cKDTree(points).query(asset.gaussians.means)[1]  # its own sample, but for those that were cleaned away
    segments = Segments(label, np.argmax(target[nearest], axis=1), joined)
    moving = with_animation(asset, cage, segments, own, weights, np.zeros(len(cage.vertices), bool), on_ground=False)
    return with_provenance(moving, {"motion": rig.animation})


def transferred_weights(cage: Cage, points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Weights (V, J) of cage vertices from those (N, J) of points (N, 3) inside it, diffused through the cage."""
    locator = TetLocator(cage.vertices, cage.tets)
    host = locator.find(points)
    inside = host >= 0
    if not inside.any():
        raise BadInput("the mesh does not lie in its cage")
    w = locator.weights(host[inside], points[inside]).clip(0)
    corner = cage.tets[host[inside]]
    V = len(cage.vertices)
    amount = np.bincount(corner.ravel(), w.ravel(), minlength=V)
    shares = coo_matrix((w.ravel(), (corner.ravel(), np.repeat(np.arange(len(w)), 4))), shape=(V, len(w)))
    mean = shares.tocsr() @ target[inside] / np.maximum(amount, 1e-12)[:, None]
    mean /= np.maximum(mean.sum(1, keepdims=True), 1e-12)
    held = 4.0 / median_edge(cage) ** 2 * amount / max(float(amount[amount > 0].mean()), 1e-12)
    component = vertex_components(cage.tets)
    if len(np.setdiff1d(component, component[(amount[cage.tets] > 0).any(1)])):
        raise BadInput("a component of the cage holds nothing of the mesh")
    return diffuse_weights(cage.vertices, cage.tets, held, mean)


def median_edge(cage: Cage) -> float:
    """Median length [m] of the edges of a cage's tets."""
    ends = cage.vertices[cage.tets[:, TET_EDGES]].astype(np.float64)
    return float(np.median(np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1)))


def mesh_adjacency(cage: Cage, parents: np.ndarray, x: np.ndarray, faces: np.ndarray, label: np.ndarray) -> Joined:
    """Pairs of joined segments: parent and child joints, and others near where their segments of the mesh touch."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = ends[label[ends[:, 0]] != label[ends[:, 1]]]
    middle, pair = x[ends].mean(1), np.sort(label[ends], axis=1)
    radius = JOINED_RADIUS * median_edge(cage)

    def joined(a: np.ndarray, b: np.ndarray, centre: np.ndarray) -> np.ndarray:
        result = (parents[a] == b) | (parents[b] == a)
        low, high = np.minimum(a, b), np.maximum(a, b)
        open_ = ~result & (a != b)
        for p in np.unique(np.stack([low[open_], high[open_]], 1), axis=0):
            here, there = open_ & (low == p[0]) & (high == p[1]), (pair == p).all(1)
            if there.any():
                result[here] = cKDTree(middle[there]).query(centre[here])[0] < radius
        return result

    return joined


MAX_NAMED = 5  # landmarks with the largest residuals that are reported


@dataclass(frozen=True)
class RigSource:
    """Motion for a body that is prepared.

    gaussians  of the body, None if they are the file's;  up  the file's axis if it is known
    animate    (prepared asset, distance grid its cage was made from) -> animated asset
    """

    gaussians: Gaussians | None
    up: str | None
    animate: Callable[[Asset, DistanceGrid], Asset]


def is_skinned(path: Path) -> bool:
    """True for a .glb with a skeleton. Raises BadInput."""
    return path.suffix.lower() == ".glb" and bool(GlbFile(path).json.get("skins"))


def rig_source(path: Path, rig: str | Path | None, landmarks: str | Path | None) -> RigSource | None:
    """Source of the motion of the body in `path`, None if it has none. Reads all files named. Raises BadInput."""
    if is_skinned(path):
        if rig is not None or landmarks is not None:
            raise BadInput(f"{path}: a .glb has its own rig; --rig and --landmarks are for splats")
        return _own_rig(path)
    if rig is None:
        if landmarks is not None:
            raise BadInput("--landmarks belongs to --rig RIG.glb")
        return None
    given = read_landmarks(landmarks) if landmarks is not None else {}
    skeleton = read_rig(rig)[0]

    def animate(asset: Asset, solid: DistanceGrid) -> Asset:
        moving = animate_person(asset, skeleton, landmarks_of(asset, given, solid), solid)
        moving.provenance["rig"]["source"] = Path(rig).name
        return moving

    return RigSource(None, None, animate)


def _own_rig(path: Path) -> RigSource:
    """The source of the motion of a skinned mesh."""
    rig, file = read_rig(path)
    mesh = read_mesh(file, len(rig.joints))
    place = scene_from_mesh(rig)
    x = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    try:
        at = sample_mesh(x, mesh.faces)
    except BadInput as e:
        raise file.error(str(e)) from e
    return RigSource(surface_gaussians(x, mesh, at), "+y", lambda asset, _: animate_mesh(asset, mesh, rig, at))


def described(moving: dict) -> list[str]:
    """Summary of the animation in a few lines, from the provenance."""
    lines = [
        f"motion: {moving['seconds']:.2f} s, {moving['joints']} joints; {moving['driven']} of {moving['surface']} "
        f"vertices of the surface are driven, the others bend"
    ]
    if "landmarks" in moving:
        by = [m["from"] for m in moving["landmarks"].values()]
        lines.append(
            f"landmarks: {by.count('given')} given, {by.count('solid')} found in the solid, "
            f"{by.count('proportions')} by proportions (--landmarks overrides)"
        )
        for h in moving["held"]:
            place = " ".join(f"{v:.2f}" for v in h["center"])
            lines.append(f"the {h['by'].replace('_', ' ')} holds what is within {h['radius']:.2f} m of {place}")
        off = sorted(((v, k) for k, v in moving["residual"].items()), reverse=True)[:MAX_NAMED]
        named = ", ".join(f"{k} {100 * v:.1f} cm" for v, k in off if v > 0.0005)
        if named:
            lines.append(f"fitted skeleton off the landmarks: {named}")
    return lines
