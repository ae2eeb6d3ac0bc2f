"""Source of a body's motion: the body's own .glb, or the rig given with a splat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from assets.asset import Asset
from assets.formats.gltf import GlbFile
from assets.formats.gltf_skin import read_mesh, read_rig
from assets.gaussians import Gaussians
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL

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
    material: str = ANIMATED_MATERIAL


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
    from prepare.rig.landmarks import landmarks_of, read_landmarks
    from prepare.rig.rigging import animate_person

    given = read_landmarks(landmarks) if landmarks is not None else {}
    skeleton = read_rig(rig)[0]

    def animate(asset: Asset, solid: DistanceGrid) -> Asset:
        moving = animate_person(asset, skeleton, landmarks_of(asset, given, solid), solid)
        moving.provenance["rig"]["source"] = Path(rig).name
        return moving

    return RigSource(None, None, animate)


def _own_rig(path: Path) -> RigSource:
    from prepare.rig.skinned_mesh import animate_mesh, sample_mesh, scene_from_mesh, surface_gaussians

    rig, file, skin = read_rig(path)
    mesh = read_mesh(file, skin, len(rig.joints))
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
        off = sorted(((v[1], k) for k, v in moving["residual"].items()), reverse=True)[:MAX_NAMED]
        named = ", ".join(f"{k} {100 * v:.1f} cm" for v, k in off if v > 0.0005)
        if named:
            lines.append(f"fitted skeleton off the landmarks: {named}")
    return lines
