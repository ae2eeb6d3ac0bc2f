"""Assets at the paper's sizes: each demo's own set, whose Gaussians and cage vertices add up to the paper's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from assets.file_access import make_folder
from assets.hdf5 import open_hdf5
from assets.library import find_asset, search_first
from core.errors import BadInput
from core.program import check_package
from scenes import registry
from scenes.paper_demos import PaperDemo
from scenes.scene import Scene
from studio.detail import Detail


@dataclass(frozen=True)
class Part:
    """An asset of a scene: how often it stands there, its sizes as shipped, and whether its cage is simulated."""

    asset: str
    count: int
    gaussians: int
    vertices: int
    simulated: bool


def parts_of(scene: Scene) -> list[Part]:
    """The assets of a scene in the order in which they are built: simulated ones first, the largest last."""
    counts = Counter(body.asset for body in scene.bodies)
    soft = {body.asset for body in scene.bodies if body.material is not None and body.kind == "soft"}
    parts = [Part(asset, count, *asset_sizes(asset), asset in soft) for asset, count in counts.items()]
    return sorted(parts, key=lambda part: (not part.simulated, part.gaussians))


def asset_sizes(name: str) -> tuple[int, int]:
    """Numbers of Gaussians and of cage vertices (0: no cage) of an asset. Raises BadInput."""
    with open_hdf5(find_asset(name)) as file:
        gaussians = len(file.array("gaussians/means", "fiu", (None, 3)))
        return gaussians, len(file.array("cage/vertices", "f", (None, 3))) if file.has("cage") else 0


def detail_of(part: Part, left: list[Part], gaussians: int, vertices: int) -> Detail:
    """The detail of a part, when it and the others of `left` are to have so many Gaussians and vertices in all.

    Gaussians closer together need fewer rays each: of f times as many, each gets f^-1/2 of the rays.
    """
    factor = gaussians / sum(p.count * p.gaussians for p in left)
    if factor <= 0:
        raise BadInput(f"{part.asset}: the other assets have more Gaussians than the whole demo is to have")
    rays = min(factor**-0.5, 1.0)
    if not part.simulated:
        return Detail(factor, rays=rays)
    own = sum(p.count * p.vertices for p in left if p.simulated)
    return Detail(factor, max(round(vertices * part.vertices / own), 1), rays)


def build_demo(demo: PaperDemo, folder: Path, report: Callable[[str], None], *, force: bool = False) -> None:
    """Build the assets of a demo into `folder`, but for those that are there already (unless `force`). Raises BadInput.

    What an asset misses of its share, the next ones make up for. Taichi must be running.
    """
    from assets.asset import Asset
    from studio.catalogue import MODELS, build_model

    check_package("studio", "open3d", "studio/requirements.txt")
    search_first(None)
    left = parts_of(registry.load(demo.scene, **demo.options))
    for part in left:
        if part.asset not in MODELS:
            raise BadInput(f"{part.asset}: no model makes it, so that {demo.name} cannot be built at another size")
    make_folder(folder)
    gaussians, vertices = demo.gaussians, demo.vertices
    for k, part in enumerate(left):
        path = folder / f"{part.asset}.h5"
        if path.is_file() and not force:
            report(f"{path}: is there already (--force builds it again)")
            asset = Asset.load(path)
        else:
            detail = detail_of(part, left[k:], gaussians, vertices)
            report(f"{demo.name}: {part.asset}, about {round(detail.gaussians * part.gaussians):,} Gaussians")
            asset = build_model(part.asset, detail, report)
            asset = replace(asset, provenance=asset.provenance | {"detail": [detail.gaussians, detail.vertices]})
            asset.save(path, quantised=True)
        gaussians -= part.count * len(asset.gaussians)
        if part.simulated:
            vertices -= part.count * len(asset.cage.vertices)
        report(f"{path}: {len(asset.gaussians):,} Gaussians, {path.stat().st_size / 1e6:.2f} MB")
    got = demo.gaussians - gaussians, demo.vertices - vertices
    report(
        f"{demo.name}: {got[0]:,} Gaussians ({demo.gaussians:,} in the paper), {got[1]:,} vertices ({demo.vertices:,})"
    )
