"""What `vrgs.py prepare` does for a body that moves by itself: a .glb, or a splat with --rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from assets.asset import Asset
from assets.formats.gltf_skin import read_mesh, read_rig
from assets.gaussians import Gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL

WORST = 5  # landmarks that are named at most


@dataclass(frozen=True)
class Mover:
    """How a body comes to move.

    gaussians  of the body, None if they are the file's;  up  the file's axis if it is known
    move       makes of the prepared asset, and the grid its cage was made from, one that moves
    """

    gaussians: Gaussians | None
    up: str | None
    move: Callable[[Asset, DistanceGrid], Asset]
    material: str = ANIMATED_MATERIAL


def mover(path: Path, rig: str | Path | None, landmarks: str | Path | None) -> Mover | None:
    """What makes the body of `path` move, None if nothing does. Reads all files that are named. Raises BadInput."""
    if path.suffix.lower() == ".glb":
        if rig is not None or landmarks is not None:
            raise BadInput(f"{path}: a .glb has its own rig; --rig and --landmarks are for splats")
        return _own(path)
    if rig is None:
        if landmarks is not None:
            raise BadInput("--landmarks belongs to --rig RIG.glb")
        return None
    from prepare.rig.landmark_file import read_landmarks
    from prepare.rig.landmarks import landmarks_of
    from prepare.rig.rigging import dance

    given = read_landmarks(landmarks) if landmarks is not None else {}
    skeleton = read_rig(rig)[0]

    def move(asset: Asset, solid: DistanceGrid) -> Asset:
        moving = dance(asset, skeleton, landmarks_of(asset, given, solid), solid)
        moving.provenance["rig"]["source"] = Path(rig).name
        return moving

    return Mover(None, None, move)


def _own(path: Path) -> Mover:
    from prepare.rig.skinned_mesh import placed_at_rest, sampled, surface_gaussians, walk

    rig, file, skin = read_rig(path)
    mesh = read_mesh(file, skin, len(rig.joints))
    place = placed_at_rest(rig)
    x = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    try:
        at = sampled(x, mesh.faces)
    except BadInput as e:
        raise file.error(str(e)) from e
    return Mover(surface_gaussians(x, mesh, at), "+y", lambda asset, _: walk(asset, mesh, rig, at))


def described(moving: dict) -> list[str]:
    """What the rig came to, in a few lines, from the provenance."""
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
        off = sorted(((v[1], k) for k, v in moving["residual"].items()), reverse=True)[:WORST]
        named = ", ".join(f"{k} {100 * v:.1f} cm" for v, k in off if v > 0.0005)
        if named:
            lines.append(f"fitted skeleton off the landmarks: {named}")
    return lines
