"""The world of a scene on the device: what a frame moves, deforms, shades and draws.

`sim` and `render` never meet but here: the solver's fields go to the embedding, the embedding
writes the splats' fields, shadow and renderer read them. Nothing passes through the host.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.morton import morton_order
from display.animation_targets import AnimationTargets
from display.body_registry import MORE, ROOM, BodyRegistry
from display.clock import SimulationCost, moves
from display.edit.editor import Editor
from display.protocol import (
    Command,
    Frame,
    Pause,
    PlayDemo,
    Rescale,
    Reset,
    SetInteraction,
    SetLight,
    SingleStep,
    WorldView,
    last_of,
)
from display.scene_bodies import load_bodies
from display.timing import Timings
from render.renderer import Renderer
from render.shadow_map import ShadowMap
from render.skinned_props import Skin, SkinnedProps
from render.sort_modes import MOVING_SORT
from render.splats import Splats
from scenes.scene import BodyState, Hand, Light, Scene
from sim.embedding import Embedding
from sim.model import Capacity
from sim.solver import Solver

SCRIPT_DT = 1 / 60  # [s]
NOTHING = Gaussians.of(*(np.zeros((0, k)) for k in (3, 4, 3)), np.zeros(0), np.zeros((0, 1, 3)))


class World(WorldView):
    """All state of a running scene. Sizes in pixels; `views` is 1 (mono) or 2 (stereo). With `depth` the picture has
    it in place of alpha.

    With `room` there is room for copies of bodies; else it is made for the first one, which takes seconds
    (display/body_registry.py). With `fingers`, what hands touch with (`Hand.touch`) pushes the bodies. `props` are drawn where
    frames put their parts (`Frame.prop_poses`), those that cast no shadow first; with them there is always room.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int,
        height: int,
        views: int = 1,
        interaction: str = "physics",
        embedding: str = "two-level",
        sort: str = MOVING_SORT,
        depth: bool = False,
        fingers: bool = False,
        room: bool = False,
        props: list[Skin] = (),
    ):
        self.scene, self.light, self.paused = scene, scene.light, False
        self.demo = False  # the scene's scripted hand plays
        self.editable = True
        self.moving = False  # did anything move in the last frame
        self._drawn: tuple | None = None  # cameras of the picture; None if it is no longer what is there
        self.timings = Timings()
        self.time = 0.0  # [s], of the simulation since the last reset
        self._cost = SimulationCost()
        self._hands: list[Hand] = []  # as of the last frame
        self.owed = 0.0  # [s] of a demonstration that has passed but is not simulated yet
        static, moving, animated = load_bodies(scene)
        still = concatenate([g for g, _ in static]) if static else NOTHING
        still = still.select(morton_order(still.means))
        first = len(still) + sum(len(s.gaussians) for s in props)  # of the bodies
        casts = len(still) + sum(len(s.gaussians) for s in props if not s.solid)  # what moves, and casts shadows
        grown = bool((room or props) and moving)
        count = sum(len(p.gaussians) for _, p in moving)
        times = ROOM if grown else 1.0
        self.splats = Splats(
            concatenate([still, *(s.gaussians for s in props), *(p.gaussians for _, p in moving)]),
            room=first + math.ceil(times * count),
        )
        self.props = SkinnedProps(self.splats, props, len(still)) if props else None
        self._colliders = [*scene.colliders, *(grid for _, grids in static for grid in grids)]
        self._fingers = fingers
        self.solver = self.make_solver([body for body, _ in moving], MORE if grown else None, interaction)
        self.embedding = None
        if moving:
            parts, offset = [], first
            for (_, part), vertices in zip(moving, self.solver.vertex_offset, strict=False):
                parts.append(replace(part, vertex_offset=vertices, gaussian_offset=offset))
                offset += len(part.gaussians)
            how = {"scheme": embedding, "with_rotation": self.splats.coefficients > 1, "room": times}
            self.embedding = Embedding(parts, **how)
        self.motions = [
            AnimationTargets(k, *placed, moving[k][0].vertices, self.solver) for k, placed in animated.items()
        ]
        self.shadow = ShadowMap(self.splats, scene.light, (casts, self.splats.count))
        self.views, self.sort, self.outputs = views, sort, "deep" if depth else "rgba8"
        self.renderer: Renderer | None = None
        self.resize(width, height)
        self.editor = Editor(self, BodyRegistry(self, first, grown=grown))
        self.refresh()

    def make_solver(self, bodies: list, room: Capacity | None, interaction: str | None = None) -> Solver:
        """A solver of the scene for these bodies."""
        scene = self.scene
        return Solver(
            bodies,
            self._colliders,
            gravity=scene.gravity,
            substep=scene.substep,
            iterations=scene.iterations,
            collision_passes=scene.collision_passes,
            interaction=interaction or self.interaction,
            fingers=self._fingers,
            room=room,
        )

    def make_renderer(self, splats: Splats) -> Renderer:
        """What draws pictures of the size that is wanted now."""
        how = {"views": self.views, "background": self.scene.background, "sort": self.sort}
        return Renderer(splats, *self.picture_size, outputs=self.outputs, **how)

    def warm_up(self) -> None:
        """Compile what is first needed in the midst of play, where the user would wait for it; nothing is changed."""
        self.solver.warm_up()
        self.editor.cast.warm_up()
        for motion in self.motions:
            motion.settled()
        self.stats()

    def resize(self, width: int, height: int) -> None:
        """Draw pictures of another size from now on."""
        self.picture_size, self._drawn = (width, height), None
        if self.renderer is None:
            self.renderer = self.make_renderer(self.splats)
        else:
            self.renderer.resize(width, height)

    def step(self, frame: Frame) -> None:
        """One frame: simulate, deform, shade, draw."""
        self.editor.begin()
        self.apply([*self._stretched(), *frame.commands])
        placed = False
        if self.props is not None and frame.prop_poses is not None:
            with self.timings.stage("hands"):
                placed = self.props.place(frame.prop_poses, self.light)
        advance = (not self.paused or last_of(SingleStep, frame.commands)) and not self.editor.waits
        if advance:
            before = None if self.demo else self.editor.before_step(frame.hands)
            begin = perf_counter()
            with self.timings.stage("simulate"):
                self._simulate(frame)
                self.moving, now = self.solver.observe()  # waits for the device
            self._cost.note(perf_counter() - begin, frame.dt)
            if self.moving:
                self._deform()
                placed = False  # its shadow is cast, too
            bodies, self._bodies = self._bodies, now
            if not self.demo:
                self.editor.after_step(before, bodies, self._bodies)
            if self.scene.game is not None:
                self.scene.game.update(self.time, self.editor.cast.of_the_scene(self._bodies))
        else:
            self.moving = False
        self._hands = frame.hands
        if placed:
            self._drawn = None
            with self.timings.stage("shadow"):
                self.shadow.cast()
        cameras = frame.cameras() if callable(frame.cameras) else frame.cameras
        seen = tuple((c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.world_to_camera.tobytes()) for c in cameras)
        if cameras and seen != self._drawn:
            with self.timings.stage("render"):
                self.renderer.render(cameras)
                if self.shadow.settle():
                    self.renderer.render(cameras)
            self._drawn = seen

    def _stretched(self) -> list[Command]:
        """The command to keep the size that two hands have given a body (sim/hands/two_hand_scaling.py), if they have let go of it."""
        done = self.solver.stretched()
        return [] if done is None else [Rescale(*done)]

    def _simulate(self, frame: Frame) -> None:
        """The user's hands move at the display's pace, a demonstration's at the one it was written for."""
        if not self.demo:
            for dt, hands in moves(frame.dt, frame.max_step, self._hands, frame.hands):
                self._advance(dt, hands)
            self.time += frame.dt
            return
        self.owed += frame.dt
        while self.owed >= SCRIPT_DT:
            self.owed -= SCRIPT_DT
            self.time += SCRIPT_DT
            self._advance(SCRIPT_DT, self.scripted_hands(self.time))

    def _advance(self, dt: float, hands: list[Hand]) -> None:
        for motion in self.motions:
            motion.drive(dt)
        self.solver.step(dt, hands)

    def _deform(self) -> None:
        self._drawn = None
        if self.embedding is None:
            return
        with self.timings.stage("embed"):
            self.embedding.deform(self.solver.x, self.splats.mean, self.splats.cov, self.splats.rotation)
        with self.timings.stage("shadow"):
            self.shadow.cast()

    def apply(self, commands: Sequence[Command]) -> None:
        """Carry out the commands of a frame in their order (display/protocol.py)."""
        demo, light = last_of(PlayDemo, commands), last_of(SetLight, commands)
        interaction, pause = last_of(SetInteraction, commands), last_of(Pause, commands)
        if demo is not None:
            self.demo = demo.on
        if last_of(Reset, commands) or (demo is not None and demo.on):  # a script begins at the beginning
            self.editor.record("reset")
            self.editor.reset()
        if light is not None:
            self.editor.record("light")
            self.set_light(light.light)
        if interaction is not None:
            self.settle()
            self.solver.interaction = interaction.mode
        self.editor.apply(commands)
        if pause is not None:
            self.paused = pause.on

    def refresh(self) -> None:
        """Bodies are where they were not: take note, and draw them there."""
        self._bodies = self.solver.bodies()
        self._deform()

    def set_light(self, light: Light) -> None:
        """Another light from now on."""
        self.light, self._drawn = light, None
        self.shadow.set_light(light)
        with self.timings.stage("shadow"):
            self.shadow.cast()

    def settle(self) -> None:
        """What moves by itself and was carried off while time stood still goes on from there."""
        if self.motions and self.interaction == "transform":
            self.motions = [motion.settled() for motion in self.motions]

    def scripted_hands(self, time: float) -> list[Hand]:
        """What the scene's own player does at `time` [s]."""
        bodies = self.editor.cast.of_the_scene(self._bodies)
        return self.scene.game.hands(time, bodies) if self.scene.game is not None else []

    @property
    def picture(self):
        """The finished picture, ti.ndarray u32 (views * H, W): R | G<<8 | B<<16 | A<<24, row 0 on top."""
        return self.renderer.picture

    @property
    def interaction(self) -> str:
        """ "physics" or "transform"."""
        return self.solver.interaction

    def bodies(self) -> list[BodyState]:
        """The simulated bodies after the last frame."""
        return self._bodies

    def pick(self, origin, direction) -> tuple[float, int] | None:
        """Distance [m] along a ray to the nearest simulated body, and its index."""
        return self.solver.pick(origin, direction)

    @property
    def selected(self) -> int | None:
        """The body that was last held or pointed out."""
        return self.editor.selected

    @property
    def recently_selected(self) -> bool:
        """Was the selected body pointed at or changed within the last seconds?"""
        return self.editor.recently_selected

    @property
    def simulation_cost(self) -> float | None:
        """Seconds of computing for a second of simulation; None before it is known."""
        return self._cost.value

    @property
    def notice(self) -> str:
        """What the user should know of the last command, for some seconds; else nothing."""
        return self.editor.notice

    def hand_forces(self) -> list[np.ndarray]:
        """Force of each hand of the last frame on what it holds [N], (3,)."""
        return self.solver.hand_forces()

    def touch_forces(self) -> list[np.ndarray]:
        """Force of what each hand touches with on what it does not hold [N], (3,); [] without fingers."""
        return self.solver.touch_forces()

    @property
    def score(self) -> int:
        return self.scene.game.score if self.scene.game is not None else 0

    @property
    def message(self) -> str:
        return self.scene.game.message if self.scene.game is not None else ""

    def stats(self) -> dict:
        """Counts and state for the panel and `--stats`."""
        s = self.solver.stats
        names = ("vertices", "tets", "substeps", "dt", "path", "iterations", "collision_passes", "finite")
        return {"gaussians": self.splats.count, **{n: s[n] for n in names}, "score": self.score}
