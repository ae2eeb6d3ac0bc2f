"""What the user changes in a world, and how it is taken back: undo, redo, copies, sizes, turns, materials."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic

from core.errors import BadInput
from display.body_registry import MAKING, BodyRegistry, NotYet
from display.edit.edit_commands import Changes
from display.edit.selection_marker import SHOWN
from display.edit.undo_stack import Step, UndoStack
from display.edit.world_snapshot import WorldSnapshot, bring_back, moment_of, step_of
from display.protocol import Command, Duplicate, Redo, Remove, Rescale, Rotate, Select, SetMaterial, Undo, in_order
from scenes.scene import BodyState, Hand

TOGETHER = {"light": 30, "rescale": 2, "rotate": 2}  # frames without such a command that end a drag of it
NOTICE = 6.0  # [s] that a notice is shown
COMPILING = "This takes another solver, which is made once: some seconds."
EDITS = (Select, Remove, Duplicate, Rescale, Rotate, SetMaterial, Undo, Redo)
SELECTING = (Select, Duplicate, Rescale, Rotate, SetMaterial)  # after these the selected body is marked
SIMULATED = (Rescale, SetMaterial, Undo, Redo)  # may change how bodies are simulated


class Editor(Changes):
    """Carries out the commands that change bodies. `selected`: the body that was last held or pointed out."""

    def __init__(self, world, cast: BodyRegistry):
        self.world, self.cast, self.history = world, cast, UndoStack()
        self.selected: int | None = None
        self._motions = tuple(world.motions)  # as the scene has them
        self._last: tuple[str, int] = ("", 0)  # the action recorded last, and the frame of its last command
        self._frame = 0
        self._pending: list[Command] = []  # for the next frame
        self._gripped: list[bool] = []
        self._notice: tuple[str, float] = ("", 0.0)
        self._waits = False
        self._selected_until = 0.0  # [s], of `recently_selected`

    @property
    def recently_selected(self) -> bool:
        """Was the selected body pointed at or changed within the last seconds?"""
        return monotonic() < self._selected_until

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
        self._waits = False

    @property
    def waits(self) -> bool:
        """Whether time must stand still in this frame, so that its picture says why the next one takes long."""
        return self._waits

    def apply(self, commands: Sequence[Command]) -> None:
        """Carry out the commands that change bodies. One that cannot be carried out changes nothing; `notice` says why."""
        commands, self._pending = in_order([*self._pending, *commands]), []
        for command in commands:
            if isinstance(command, EDITS):
                try:
                    self._notice = ("", 0.0)
                    self._carry_out(command)
                    if isinstance(command, SELECTING):
                        self._selected_until = monotonic() + SHOWN
                except BadInput as e:
                    self.say(str(e))
                except NotYet:
                    self.say(MAKING)
                    self._pending.append(command)
        if any(isinstance(c, SIMULATED) for c in commands) and self.world.solver.fresh and self._frame > 1:
            self._waits = True
            self.say(COMPILING)

    def _carry_out(self, command: Command) -> None:
        match command:
            case Select(body):
                self.selected = None if body is None else self._index(body)
            case Remove(body):
                self._remove(body)
            case Duplicate(body):
                self._duplicate(body)
            case Rescale(body, factor):
                self._rescale(body, factor)
            case Rotate(body, rotation):
                self._rotate(body, rotation)
            case SetMaterial(body, material):
                self._set_material(body, material)
            case Undo():
                self._return(self.history.back(self._now), "Nothing to undo.")
            case Redo():
                self._return(self.history.forth(self._now), "Nothing to redo.")

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

    def _moment(self) -> WorldSnapshot:
        return moment_of(self.world, self.cast, self.selected)

    def _light_step(self) -> Step:
        return Step("light", self.world.light)

    def _now(self, step: Step) -> Step:
        return self._light_step() if step.action == "light" else step_of(step.action, self._moment())

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

    def before_step(self, hands: list[Hand]) -> WorldSnapshot | None:
        """How things are, if a hand is about to close: then it may take something."""
        grips = [h is not None and h.grip for h in hands]
        before = self._gripped + [False] * len(grips)
        self._gripped = grips
        if not any(g and not b for g, b in zip(grips, before, strict=False)):
            return None
        return self._moment()

    def after_step(self, moment: WorldSnapshot | None, before: list[BodyState], bodies: list[BodyState]) -> None:
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
