"""A scene on the device: the solver of its bodies, the Gaussians that follow them, shadow map and renderer.

`sim` and `render` meet here alone: the solver's fields go to the embedding, the embedding writes the splats' fields,
shadow map and renderer read them. Nothing passes through the host.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera
from core.errors import BadInput
from core.fields import keep_compiled_kernels
from core.morton import morton_order
from core.runtime import is_out_of_memory
from display.animation_targets import AnimationTargets
from display.scene_bodies import load_bodies
from render import MOVING_SORT
from render.renderer import Renderer
from render.shadow_map import ShadowMap
from render.skinned_props import Skin, SkinnedProps
from render.splats import Splats
from scenes.scene import Light, Scene
from sim.capacity import MAX_BODIES, Capacity
from sim.embedding import BodySpan, Embedding, PackedBody
from sim.solver import Solver

GROWTH = 4.0  # capacity for vertices and Gaussians of bodies after `grow`, in multiples of the scene's own
GROWN_CAPACITY = Capacity(bodies=MAX_BODIES, factor=GROWTH)
NO_GAUSSIANS = Gaussians.of(*(np.zeros((0, k)) for k in (3, 4, 3)), np.zeros(0), np.zeros((0, 1, 3)))


class DeviceScene:
    """Solver, embedding, splats, shadow map and renderer of a scene, which `grow` replaces by larger ones.

    The splats hold the static Gaussians, then the props', then those of the bodies, from `first` on.

    views      1 (mono) or 2 (stereo)
    depth      let the picture hold depth in place of alpha
    fingers    let finger capsules (`Hand.touch`) push the bodies
    grown      have capacity for copies of bodies from the start; there always is with props
    props      skinned Gaussians that `place_props` moves, those that cast no shadow first
    """

    def __init__(
        self,
        scene: Scene,
        picture_size: tuple[int, int],
        *,
        views: int = 1,
        interaction: str = "physics",
        embedding: str = "two-level",
        sort: str = MOVING_SORT,
        depth: bool = False,
        fingers: bool = False,
        grown: bool = False,
        props: Sequence[Skin] = (),
    ):
        self.scene, self.light, self.picture_size = scene, scene.light, picture_size
        static, moving, animated = load_bodies(scene)
        still = concatenate([g for g, _ in static]) if static else NO_GAUSSIANS
        still = still.select(morton_order(still.means))
        self.first = len(still) + sum(len(s.gaussians) for s in props)
        self._first_caster = len(still) + sum(len(s.gaussians) for s in props if not s.solid)  # of those that move
        self.grown = bool((grown or props) and moving)
        factor = GROWTH if self.grown else 1.0
        self.gaussian_counts = [len(embedded.gaussians) for _, embedded in moving]  # of each body of the scene
        self.splats = Splats(
            concatenate([still, *(s.gaussians for s in props), *(embedded.gaussians for _, embedded in moving)]),
            capacity=self.first + math.ceil(factor * sum(self.gaussian_counts)),
        )
        self.props = SkinnedProps(self.splats, props, len(still)) if props else None
        self._solver_options = {
            "colliders": [*scene.colliders, *(grid for _, grids in static for grid in grids)],
            "gravity": scene.gravity,
            "substep": scene.substep,
            "iterations": scene.iterations,
            "collision_passes": scene.collision_passes,
            "fingers": fingers,
        }
        capacity = GROWN_CAPACITY if self.grown else None
        self.solver = Solver(
            [body for body, _ in moving], interaction=interaction, capacity=capacity, **self._solver_options
        )
        self.embedding = self._embed([embedded for _, embedded in moving], embedding, factor) if moving else None
        self.animations = [
            AnimationTargets(k, *placed, moving[k][0].vertices, self.solver) for k, placed in animated.items()
        ]
        self.shadow = self._new_shadow(self.splats)
        self._renderer_options = {
            "views": views,
            "background": scene.background,
            "sort": sort,
            "outputs": "deep" if depth else "rgba8",
        }
        self.renderer = Renderer(self.splats, *picture_size, **self._renderer_options)

    def _embed(self, bodies: list, scheme: str, factor: float) -> Embedding:
        begins = self.first + np.cumsum([0, *self.gaussian_counts])
        placed = [
            replace(body, vertex_offset=v, gaussian_offset=int(g))
            for body, v, g in zip(bodies, self.solver.vertex_offset, begins, strict=False)
        ]
        return Embedding(placed, scheme=scheme, with_rotation=self.splats.coefficients > 1, headroom=factor)

    def _new_shadow(self, splats: Splats) -> ShadowMap | None:
        return None if self.light is None else ShadowMap(splats, self.light, (self._first_caster, splats.count))

    def grow(self, bodies: list, packed: list[PackedBody]) -> None:
        """Replace everything by objects with capacity for more bodies, in the same state but without bodies shown.

        It takes seconds, because kernels are compiled. `bodies` are the scene's own for a solver, and `packed` is
        `embedding.read()` of them. Raises BadInput, with nothing changed, if there is no memory.
        """
        old, made = self.solver, []
        snapshot = old.snapshot()
        try:
            solver = Solver(
                bodies,
                interaction=old.interaction,
                capacity=GROWN_CAPACITY,
                **self._solver_options,
            )
            made.append(solver)
            solver.restore(snapshot)
            splats = self.splats.enlarged(self.first + math.ceil(GROWTH * sum(self.gaussian_counts)))
            made.append(splats)
            embedding = self.embedding.enlarged(packed, GROWTH)
            made.append(embedding)
            shadow = self._new_shadow(splats)
            made.append(shadow)
            renderer = Renderer(splats, *self.picture_size, **self._renderer_options)
        except (MemoryError, RuntimeError) as e:
            for part in filter(None, made):
                part.destroy()
            if not is_out_of_memory(e):
                raise
            raise BadInput("There is no memory for more bodies.") from e
        ti.sync()
        with keep_compiled_kernels():
            for part in filter(None, (old, self.renderer, self.shadow, self.embedding, self.splats)):
                part.destroy()
        self.solver, self.splats, self.embedding = solver, splats, embedding
        self.shadow, self.renderer, self.grown = shadow, renderer, True

    def show(self, spans: list[BodySpan], packed: list[PackedBody], count: int) -> None:
        """Embed these spans, and draw only the first `count` Gaussians."""
        self.embedding.load(spans, packed)
        self.splats.set_count(count)
        if self.shadow is not None:
            self.shadow.set_end(count)

    def deform(self) -> None:
        """Move the bodies' Gaussians to where the solver has the vertices."""
        if self.embedding is not None:
            s = self.splats
            self.embedding.deform(self.solver.x, s.mean, s.cov, s.rotation)

    def place_props(self, poses: np.ndarray) -> bool:
        """Move the props; returns whether any has moved."""
        return self.props is not None and self.props.place(poses, self.light)

    def set_light(self, light: Light) -> None:
        """Replace the scene's light."""
        self.light = light
        self.shadow.set_light(light)

    def cast_shadow(self) -> None:
        """Bring the shadows up to date with where the Gaussians are."""
        if self.shadow is not None:
            self.shadow.cast()

    def render(self, cameras: Sequence[Camera]) -> None:
        """Draw the picture for these cameras, one a view."""
        self.renderer.render(cameras)
        if self.shadow is not None and self.shadow.finish():
            self.renderer.render(cameras)

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size [px] from now on."""
        self.picture_size = (width, height)
        self.renderer.resize(width, height)
