"""What the user changes in a world, and how it is taken back: undo, redo, copies, sizes, turns, materials."""

from __future__ import annotations

from dataclasses import replace
from time import monotonic

import numpy as np

from assets.errors import BadInput
from assets.gaussians import matrices_of_quats
from display.cast import MAKING, Cast, NotYet
from display.history import History, Step
from display.moment import Moment, bring_back, moment_of, step_of
from scenes.scene import BodyState, Hand, Material

GAP = 0.01  # [m] between a body and its copy
SMALLEST, LARGEST = 0.2, 5.0  # times its first size
TOGETHER = {"light": 30, "rescale": 2, "rotate": 2}  # frames without such a command that end a drag of it
NOTICE = 6.0  # [s] that a notice is shown
COMMANDS = ("select", "remove", "duplicate", "rescale", "rotate", "material", "undo", "redo")


class Editor:
    """Carries out the commands that change bodies. `selected`: the body that was last held or pointed out."""

    def __init__(self, world, cast: Cast):
        self.world, self.cast, self.history = world, cast, History()
        self.selected: int | None = None
        self._motions = tuple(world.motions)  # as the scene has them
        self._last: tuple[str, int] = ("", 0)  # the action recorded last, and the frame of its last command
        self._frame = 0
        self._pending: dict = {}  # for the next frame
        self._gripped: list[bool] = []
        self._notice: tuple[str, float] = ("", 0.0)

    @property
    def notice(self) -> str:
        """What the user should know of the last command, for some seconds."""
        text, until = self._notice
        return text if monotonic() < until else ""

    def say(self, text: str) -> None:
        """Let the panels show this for a while."""
        self._notice = text, monotonic() + NOTICE

    def begin(self) -> None:
        """A frame begins."""
        self._frame += 1

    def apply(self, commands: dict) -> None:
        """Carry out what is asked for; what cannot be is said, and changes nothing."""
        commands, self._pending = {**self._pending, **commands}, {}
        for name in COMMANDS:
            if name in commands and commands[name] is not False:
                try:
                    self._notice = ("", 0.0)
                    getattr(self, f"_{name}")(commands[name])
                except BadInput as e:
                    self.say(str(e))
                except NotYet:
                    self.say(MAKING)
                    self._pending[name] = commands[name]

    # history

    def record(self, action: str) -> None:
        """Remember how things are before this action; a drag, a command in each frame, is one action."""
        self._keep(action, self._before(action))

    def _before(self, action: str) -> Step | None:
        """How things are before an action; None if it only goes on."""
        last, at = self._last
        if action == last and self._frame - at <= TOGETHER.get(action, -1):
            return None
        return self._light_step() if action == "light" else step_of(action, self._moment())

    def _keep(self, action: str, step: Step | None) -> None:
        """The action has been done."""
        self._last = action, self._frame
        if step is not None:
            self.history.add(step)

    def _moment(self) -> Moment:
        return moment_of(self.world, self.cast, self.selected)

    def _light_step(self) -> Step:
        return Step("light", self.world.light)

    def _now(self, step: Step) -> Step:
        return self._light_step() if step.action == "light" else step_of(step.action, self._moment())

    def _undo(self, wanted) -> None:
        self._return(self.history.back(self._now), "Nothing to undo.")

    def _redo(self, wanted) -> None:
        self._return(self.history.forth(self._now), "Nothing to redo.")

    def _return(self, step: Step | None, nothing: str) -> None:
        self._last = ("", 0)
        if step is None:
            self.say(nothing)
        elif step.action == "light":
            self.world.set_light(step.state)
        else:
            self.world.demo = False
            self.selected = step.state.selected
            bring_back(step.state, self.world, self.cast)

    # hands

    def before_step(self, hands: list[Hand]) -> Moment | None:
        """How things are, if a hand is about to close: then it may take something."""
        grips = [h is not None and h.grip for h in hands]
        before = self._gripped + [False] * len(grips)
        self._gripped = grips
        return self._moment() if any(g and not b for g, b in zip(grips, before, strict=False)) else None

    def after_step(self, moment: Moment | None, before: list[BodyState], bodies: list[BodyState]) -> None:
        """A hand that has taken something has begun an action."""
        taken = [k for k, (a, b) in enumerate(zip(before, bodies, strict=True)) if b.held and not a.held]
        if taken:
            self.selected = taken[0]
            if moment is not None:
                self._keep("grab", step_of("grab", moment))

    def reset(self) -> None:
        """The scene's own bodies at their starts, and no others; its game begins anew."""
        w, game = self.world, self.world.scene.game
        changed = self.cast.changed
        w.solver.reset(self.cast.parts if changed else None)
        w.time = w.owed = 0.0
        w.motions = list(self._motions)
        for motion in w.motions:
            motion.solver = w.solver
            motion.reset()
        if game is not None:
            game.reset()
        if changed:
            self.selected = None
            self.cast.follow(self.cast.scene)
        w.refresh()

    # commands

    def _index(self, k) -> int:
        """The body that is meant; None or True: the selected one."""
        k = self.selected if k is None or k is True else k
        if k is None:
            raise BadInput("Take hold of something first, or point at it.")
        if not 0 <= int(k) < len(self.cast.members):
            raise BadInput(f"There is no body {k}.")
        return int(k)

    def _select(self, k) -> None:
        self.selected = None if k is None else self._index(k)

    def _remove(self, k) -> None:
        k, w = self._index(k), self.world
        before = self._before("remove")
        w.solver.remove(k)
        self._keep("remove", before)
        w.motions = [m.moved(np.eye(4), m.body - (m.body > k)) for m in w.motions if m.body != k]
        members = self.cast.members
        self.selected = None
        self.cast.follow(members[:k] + members[k + 1 :])
        w.refresh()

    def _duplicate(self, k) -> None:
        k, w = self._index(k), self.world
        aside = free_place(k, w.bodies())
        members = (*self.cast.members, replace(self.cast.members[k], own=False))

        def copy() -> int:
            self.cast.check(members)
            return w.solver.duplicate(k, aside=aside)

        before = self._before("duplicate")
        new = self.cast.with_room(copy)
        self._keep("duplicate", before)
        by = np.eye(4)
        by[:3, 3] = aside
        w.motions += [m.moved(by, new) for m in w.motions if m.body == k]
        self.selected = new
        self.cast.follow(members)
        w.refresh()

    def _rescale(self, asked) -> None:
        k, factor = asked
        k, w = self._index(k), self.world
        part, body = w.solver.parts[k], w.bodies()[k]
        if not np.isfinite(factor) or factor <= 0.0:
            raise BadInput(f"A body cannot be made {factor} times as large.")
        size = float(np.clip(part.shape.factor * factor, SMALLEST, LARGEST))
        size = 1.0 if abs(size - 1.0) < 1e-6 else size
        factor = size / part.shape.factor
        if abs(factor - 1.0) < 1e-6:
            raise BadInput(f"It is as {'large' if asked[1] > 1.0 else 'small'} as it can be.")
        foot = body.centroid if body.held else np.array([body.centroid[0], body.low[1], body.centroid[2]])
        before = self._before("rescale")
        self.cast.with_room(lambda: w.solver.rescale(k, factor, about=foot))
        self._keep("rescale", before)
        by = np.diag([factor, factor, factor, 1.0])
        by[:3, 3] = (1.0 - factor) * foot
        self._move(k, by)

    def _rotate(self, asked) -> None:
        k, quaternion = asked
        k, w, q = self._index(k), self.world, np.asarray(quaternion, np.float64)
        if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
            raise BadInput(f"A body cannot be turned by {quaternion}.")
        body, by = w.bodies()[k], np.eye(4)
        by[:3, :3] = matrices_of_quats((q / np.linalg.norm(q))[None])[0]
        by[:3, 3] = body.centroid - by[:3, :3] @ body.centroid
        if not body.held:  # what stands on a table still does
            first, last = w.solver.vertex_offset[k : k + 2]
            by[1, 3] += body.low[1] - (w.solver.snapshot()["x"][first:last] @ by[1, :3] + by[1, 3]).min()
        before = self._before("rotate")
        w.solver.displace(k, by)
        self._keep("rotate", before)
        self._move(k, by)

    def _material(self, asked) -> None:
        k, material = asked
        k, w = self._index(k), self.world
        before = self._before("material")
        material = material if isinstance(material, Material) else Material.named(str(material))
        self.cast.with_room(lambda: w.solver.set_material(k, material))
        self._keep("material", before)
        self.cast.follow(self.cast.members)
        w.refresh()

    def _move(self, k: int, by: np.ndarray) -> None:
        """What moves by itself goes on where it was put."""
        w = self.world
        w.motions = [m.moved(by) if m.body == k else m for m in w.motions]
        self.cast.follow(self.cast.members)
        w.refresh()


def free_place(k: int, bodies: list[BodyState]) -> np.ndarray:
    """How far from body k [m], (3,), its copy stands: above it, or beside it if it moves by itself, and nowhere in the
    bounds of another one."""
    size = bodies[k].high - bodies[k].low + GAP
    ways = [[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]] if bodies[k].driven else [[0, 1, 0]]
    for far in range(1, len(bodies) + 2):
        for way in ways:
            aside = far * size * way
            if all((bodies[k].low + aside >= b.high).any() or (bodies[k].high + aside <= b.low).any() for b in bodies):
                return aside
    return len(bodies) * size * ways[0]
