"""Who is on stage: which Gaussians belong to which body of the solver, as bodies are copied, taken away and scaled.

At the first change, what the device holds of each body is read back. When one does not fit, solver and picture are made
anew, once, with room for more: kernels are compiled for that, so it takes seconds. Without changes nothing of this
costs anything.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import keep_compiled_kernels
from core.runtime import is_out_of_memory
from render.shadow_map import ShadowMap
from scenes.scene import BodyState
from sim.embedding import Run
from sim.model import MAX_BODIES, Capacity, CapacityError

ROOM = 4.0  # times what the scene has: of vertices and Gaussians
MORE = Capacity(bodies=MAX_BODIES, factor=ROOM)
FULL = "There is no room for that: remove something first."
MAKING = "Making room for more bodies: some seconds, once."
GONE = 1e3  # [m] to the side, where the game sees what was taken away


@dataclass(frozen=True)
class Member:
    """A body of the solver: which of the scene's it looks like, and whether it is that one and no copy."""

    part: int
    own: bool = True


class NotYet(Exception):
    """It will take seconds: the user should see why before it begins."""


class BodyRegistry:
    """The members in the order of the solver's bodies. `world` has solver, splats, embedding, shadow and renderer."""

    def __init__(self, world, first: int, *, grown: bool = False):
        self.world, self.first = world, first  # first: index of the first Gaussian that moves
        self.parts = world.solver.parts  # as the scene has them
        self.scene = self.members = tuple(Member(k) for k in range(len(self.parts)))
        self.grown = self.announced = grown  # is there room for more; was it said that it will be made
        begins = [run.gaussian for run in world.embedding.runs] if world.embedding is not None else []
        self._counts = np.diff([*begins, world.splats.count], prepend=first)[1:]  # Gaussians of each
        self._packed: list[dict] | None = None
        self._looks: list[tuple[np.ndarray, np.ndarray]] = []

    @property
    def changed(self) -> bool:
        """Whether any body is not the scene's, as it was."""
        return self.members != self.scene or self.world.solver.parts != self.parts

    def of_the_scene(self, bodies: list[BodyState]) -> list[BodyState]:
        """The states of the scene's own bodies, in its order: all that its game sees. What was taken away is far."""
        if self.members == self.scene:
            return bodies
        places = {m.part: k for k, m in enumerate(self.members) if m.own}
        return [bodies[places[k]] if k in places else self._gone(k) for k in range(len(self.scene))]

    def _gone(self, k: int) -> BodyState:
        body, far = self.parts[k].body, np.array([GONE, 0.0, 0.0])
        up = np.array([0.0, 1.0, 0.0])
        return BodyState(body.name, far, np.zeros(3), far, far, up, False, body.pinned is not None)

    def with_room(self, edit):
        """The result of a change of the solver's bodies; with more room, if that is what it takes. BadInput, and NotYet
        the first time that room is wanted."""
        try:
            return edit()
        except CapacityError as e:
            if self.grown or len(self.members) >= MAX_BODIES:
                raise CapacityError(FULL) from e
        if not self.announced:
            self.announced = True
            raise NotYet
        self._grow()
        try:
            return edit()
        except CapacityError as e:
            raise CapacityError(FULL) from e

    def follow(self, members: tuple[Member, ...]) -> None:
        """Let the picture show these members where the solver has them."""
        world, before = self.world, self._places(self.members)
        parts, vertices, places = world.solver.parts, world.solver.vertex_offset, self._places(members)
        runs = [Run(m.part, v, g, p.shape.factor) for m, v, g, p in zip(members, vertices, places, parts, strict=False)]
        if runs != world.embedding.runs:
            self._read()
            world.embedding.load(runs, self._packed)
            for k, (m, g) in enumerate(zip(members, places, strict=False)):
                if not (k < len(self.members) and self.members[k].part == m.part and before[k] == g):
                    world.splats.put(g, *self._looks[m.part])
            world.splats.count = world.shadow.end = places[-1]
        self.members = members

    def warm_up(self) -> None:
        """Compile what the first change needs; nothing is changed."""
        world = self.world
        if self.members:
            world.splats.put(self.first, *world.splats.read(self.first, 1))
            world.embedding.warm_up()

    def check(self, members: tuple[Member, ...]) -> None:
        """NoRoom if the picture has no room for them."""
        self._read()
        runs = [Run(m.part, 0, 0) for m in members]
        if self._places(members)[-1] > self.world.splats.capacity or not self.world.embedding.fits(runs, self._packed):
            raise CapacityError("no room for Gaussians")

    def _places(self, members: tuple[Member, ...]) -> list[int]:
        """Where the Gaussians of each begin, and where the last ones end."""
        return (self.first + np.cumsum([0, *(self._counts[m.part] for m in members)])).tolist()

    def _read(self) -> None:
        """Keep on the host what the device holds of each of the scene's bodies."""
        if self._packed is None:
            places = self._places(self.scene)
            self._looks = [self.world.splats.read(a, n) for a, n in zip(places, self._counts.tolist(), strict=False)]
            self._packed = self.world.embedding.read()

    def _grow(self) -> None:
        """Make solver and picture anew, with room for more; the old ones stay if there is no memory for that."""
        world, old = self.world, self.world.solver
        self._read()
        print(MAKING, file=sys.stderr, flush=True)
        snapshot, made = old.snapshot(), []
        try:
            solver = world.make_solver([p.body for p in self.parts], MORE)
            made.append(solver)
            solver.restore(snapshot)
            splats = world.splats.larger(self.first + int(np.ceil(ROOM * self._counts.sum())))
            made.append(splats)
            embedding = world.embedding.larger(self._packed, ROOM)
            made.append(embedding)
            shadow = ShadowMap(splats, world.light, (world.shadow.begin, splats.count))
            made.append(shadow)
            renderer = world.make_renderer(splats)
        except (MemoryError, RuntimeError) as e:
            for thing in made:
                thing.destroy()
            if not is_out_of_memory(e):
                raise
            raise BadInput("There is no memory for more bodies.") from e
        ti.sync()
        with keep_compiled_kernels():
            for thing in (old, world.renderer, world.shadow, world.embedding, world.splats):
                thing.destroy()
        self.grown = True
        world.solver, world.splats, world.embedding = solver, splats, embedding
        world.shadow, world.renderer = shadow, renderer
        for motion in world.motions:
            motion.solver = solver
        self.follow(self.members)
        world.warm_up()
