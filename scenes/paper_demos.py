"""The nine demos of the paper, and what it reports of them (VR-GS: Jiang et al. 2024, arXiv:2401.16663; RTX 4090)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from assets.library import find_asset, paper_folder, search_first
from core.errors import BadInput
from scenes import registry


@dataclass(frozen=True)
class PaperDemo:
    """A demo as it is played here, and the paper's figures.

    scene, options  name of the scene file, and options of its `build`
    gaussians       of the room and all bodies
    vertices        of all cages
    iterations      of the solver, each frame
    fps             pictures a second, both eyes
    """

    name: str
    scene: str
    gaussians: int
    vertices: int
    iterations: int
    fps: float
    options: dict[str, str] = field(default_factory=dict)


PAPER_DEMOS = (
    PaperDemo("fox", "manipulation", 305_000, 28_205, 1, 161, {"animal": "fox"}),
    PaperDemo("bear", "manipulation", 2_526_000, 19_472, 5, 77, {"animal": "bear"}),
    PaperDemo("horse", "manipulation", 1_295_000, 10_611, 5, 115, {"animal": "horse"}),
    PaperDemo("ring_toss", "ring_toss", 1_456_000, 9_002, 10, 38),
    PaperDemo("table_brick_game", "table_brick_game", 1_867_000, 33_279, 10, 41),
    PaperDemo("toy_collection", "toy_collection", 1_665_000, 46_428, 20, 24),
    PaperDemo("box_moving", "box_moving", 1_769_000, 1_434, 10, 74),
    PaperDemo("animal_crossing", "animal_crossing", 1_313_000, 36_386, 10, 35),
    PaperDemo("just_dance", "just_dance", 1_059_000, 13_936, 50, 34),
)


def paper_demos(names: Sequence[str] = ()) -> list[PaperDemo]:
    """The demos with these names, all if there are none. Raises BadInput."""
    known = {demo.name: demo for demo in PAPER_DEMOS}
    for name in names:
        if name not in known:
            raise BadInput(f"{name}: no such demo; there are {', '.join(known)}")
    return [known[name] for name in names or known]


def paper_demo_of(scene: str, options: dict[str, str]) -> PaperDemo:
    """The demo that this scene with these options is, the first that matches. Raises BadInput."""
    for demo in PAPER_DEMOS:
        if demo.scene == scene and demo.options.items() <= {**demo.options, **options}.items():
            return demo
    raise BadInput(f"the scene {scene} with these options is not a demo of the paper")


def use_paper_assets(demo: PaperDemo) -> None:
    """Let the demo's scene find its assets at the paper's sizes. Raises BadInput if some are not built yet."""
    folder = paper_folder(demo.name)
    search_first(folder)
    scene = registry.load(demo.scene, **demo.options)
    missing = [body.asset for body in scene.bodies if find_asset(body.asset).parent != folder]
    if missing:
        search_first(None)
        raise BadInput(f"{folder}/{missing[0]}.h5 is missing (make it: python -m studio --detail paper {demo.name})")
