"""A scene on the device: the solver of its bodies, the Gaussians that follow them, shadow map and renderer.

`sim` and `render` meet here alone: the solver's fields go to the embedding, the embedding writes the splats' fields,
shadow map and renderer read them. Nothing passes through the host.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera
from core.morton import morton_order
from core.vocabulary import Light
from display.scene_bodies import load_bodies, pieces_of
from render import MOVING_SORT
from render.film_screen import FilmScreen, screen_gaussians
from render.renderer import Renderer
from render.shadow_map import ShadowMap
from render.splats import Splats, StillPose
from scenes.scene import Scene
from sim.bodies import RigidBody
from sim.contact.contact_samples import MAX_SAMPLES
from sim.contact.static_shapes import LineOfSight, placed
from sim.embedding import BodySpan, Embedding, PackedBody
from sim.model import MAX_BODIES, Capacity
from sim.solver import SoftBody, Solver

if TYPE_CHECKING:
    from render.skinned_props import Skin, SkinnedProps

# Capacity for vertices and Gaussians of bodies, in multiples of the scene's own. Memory is cheap, and a loop skips what
# is not used; fields that had to grow at the first copy would be others, for which all kernels are compiled again.
HEADROOM = 4.0
NO_GAUSSIANS = Gaussians.of(*(np.zeros((0, k)) for k in (3, 4, 3)), np.zeros(0), np.zeros((0, 1, 3)))


class DeviceScene:
    """Solver, embedding, splats, shadow map and renderer of a scene, with capacity for copies of its bodies.

    The splats hold the `still` static Gaussians, at their end the screens', then the props', then those of the bodies,
    from `first` on.

    views      1 (mono) or 2 (stereo)
    depth      let the picture hold depth in place of alpha
    fingers    let finger capsules (`Hand.touch`) push the bodies
    props      skinned Gaussians that `place_props` moves, those that cast no shadow first
    reserve    assets of bodies for which there is capacity besides
    """

    def __init__(
        self,
        scene: Scene,
        picture_size: tuple[int, int],
        *,
        views: int = 1,
        interaction: str = "physics",
        embedding: str = "two-level",
        sort: str | None = None,
        depth: bool = False,
        fingers: bool = False,
        props: Sequence[Skin] = (),
        reserve: Sequence[str] = (),
    ):
        self.scene, self.light, self.picture_size, self.views = scene, scene.light, picture_size, views
        static, moving = load_bodies(scene)
        reserved = [piece for asset in reserve for piece in pieces_of(asset)]
        still = concatenate([g for g, _ in static]) if static else NO_GAUSSIANS
        still = still.select(morton_order(still.means))
        screens, parts = [screen_gaussians(s) for s in scene.screens], [s.gaussians for s in props]
        self.still = len(still) + sum(map(len, screens))
        self.first = self.still + sum(map(len, parts))
        first_caster = self.still + sum(len(s.gaussians) for s in props if not s.solid)  # of those that move
        self.parts = [piece.part for piece in moving]  # how each body of the scene is embedded
        gaussians = concatenate([still, *screens, *parts, *(piece.part.gaussians for piece in moving)])
        self.splats = Splats(
            gaussians,
            capacity=self.first
            + max(math.ceil(HEADROOM * sum(self.gaussian_counts)), 2 * sum(len(p.part.gaussians) for p in reserved)),
        )
        self.props: SkinnedProps | None = None
        if props:
            from render.skinned_props import SkinnedProps

            self.props = SkinnedProps(self.splats, props, self.still)
        begins = len(still) + np.cumsum([0, *map(len, screens)])
        films = zip(begins.tolist(), scene.screens, strict=False)
        self.screens = [FilmScreen(self.splats, begin, screen) for begin, screen in films]
        self.obstacles = obstacles = [*scene.colliders, *(grid for _, grids in static for grid in grids)]
        self._still_pose: StillPose | None = None
        self.sight = LineOfSight(obstacles)
        self.solver = Solver(
            [piece.body for piece in moving],
            obstacles,
            gravity=scene.gravity,
            interaction=interaction,
            capacity=capacity_for([piece.body for piece in reserved]) if moving else Capacity(),
            fingers=fingers,
        )
        self.trained_sort = gaussians.sort or MOVING_SORT
        begins = self.begins(range(len(moving)))
        placed = zip(moving, self.solver.vertex_offset, begins, strict=False)
        parts = [replace(piece.part, vertex_offset=v, gaussian_offset=g) for piece, v, g in placed]
        rotates, more = self.splats.coefficients > 1, [piece.part for piece in reserved]
        self.embedding: Embedding | None = None
        if moving:
            self.embedding = Embedding(parts, scheme=embedding, with_rotation=rotates, headroom=HEADROOM, reserve=more)
        self.animations = [animation for k, piece in enumerate(moving) for animation in piece.targets(k)]
        self.shadow = None if self.light is None else ShadowMap(self.splats, self.light, first_caster)
        captured = [k for k, piece in enumerate(moving) if piece.placed.captured]
        if self.shadow is not None and captured:
            self.deform()  # from the bodies' own frames to where they stand
            self.shadow.keep_captured_shadows([(begins[k], begins[k + 1]) for k in captured])
        self.renderer = Renderer(
            self.splats,
            *picture_size,
            views=views,
            background=scene.background,
            antialias=gaussians.antialias,
            sort=sort or self.trained_sort,
            outputs="deep" if depth else "rgba8",
            still=len(still),  # those of screens change their colours
        )

    @property
    def gaussian_counts(self) -> list[int]:
        """Number of Gaussians of each body of the scene."""
        return [len(part.gaussians) for part in self.parts]

    def begins(self, sources: Iterable[int]) -> list[int]:
        """Index of the first Gaussian of each of bodies that look like these, and the end of the last one's."""
        return (self.first + np.cumsum([0, *(self.gaussian_counts[k] for k in sources)])).tolist()

    def show(self, spans: list[BodySpan], packed: list[PackedBody], count: int) -> None:
        """Embed these spans, and draw only the first `count` Gaussians."""
        self.embedding.load(spans, packed)
        self.splats.count = count

    def deform(self) -> None:
        """Move the bodies' Gaussians to where the solver has the vertices."""
        if self.embedding is not None:
            s = self.splats
            self.embedding.deform(self.solver.x, s.mean, s.cov, s.rotation)

    def place_props(self, poses: np.ndarray) -> bool:
        """Move the props; returns whether any has moved."""
        return self.props is not None and self.props.place(poses, self.light)

    def show_films(self, time: float) -> bool:
        """Show on all screens the pictures of a moment [s]; returns whether one has changed."""
        return any([screen.show(time) for screen in self.screens])

    def place_room(self, pose: np.ndarray) -> None:
        """Let all that stands still be at a rigid transform (4, 4) of where it was at the start, colliders too."""
        if self.still and self._still_pose is None:
            self._still_pose = StillPose(self.splats, self.still)
        if self._still_pose is not None:
            self._still_pose.place(pose)
        shapes = [placed(shape, pose) for shape in self.obstacles]
        self.sight = LineOfSight(shapes)
        self.solver.place_static(shapes)
        self.renderer.forget()

    def set_light(self, light: Light) -> None:
        """Replace the scene's light."""
        self.light = light
        self.shadow.set_light(light)

    def cast_shadow(self) -> None:
        """Bring the shadows up to date with where the Gaussians are."""
        if self.shadow is not None:
            self.shadow.cast()

    def render(self, cameras: Sequence[Camera]) -> None:
        """Launch the drawing of the picture for these cameras, one a view."""
        self.renderer.render(cameras, wait=False)

    def finish(self, cameras: Sequence[Camera]) -> None:
        """Wait for the picture that `render` draws for these cameras, and draw it again if it is incomplete."""
        self.renderer.finish()
        if self.shadow is not None and self.shadow.finish():
            self.renderer.render(cameras)

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size [px] from now on."""
        self.picture_size = (width, height)
        self.renderer.resize(width, height)


def capacity_for(reserve: Sequence[SoftBody | RigidBody]) -> Capacity:
    """Capacity for copies of a scene's bodies, and for these bodies besides.

    Twice as much as these need: where the scene's own need more than that, a quarter of HEADROOM times theirs is more.
    """
    return Capacity(
        bodies=MAX_BODIES,
        factor=HEADROOM,
        vertices=2 * sum(len(b.vertices) for b in reserve),
        tets=2 * sum(len(b.tets) for b in reserve),
        triangles=2 * sum(len(b.surface) for b in reserve),
        samples=2 * sum(max(MAX_SAMPLES, len(b.vertices)) for b in reserve),
        nodes=2 * sum(b.sdf.values.size for b in reserve if b.sdf is not None),
    )
