"""Edits of a world by the user: execution, notices, undo and redo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from assets.library import SHIPPED_FOLDER, find_asset
from core.errors import BadInput
from core.rotation import best_fit_rotation, matrices_from_quaternions, pose_matrix
from core.vocabulary import Body, BodyState, Box, Hand
from display import user_commands as cmd
from display.edit.body_registry import BodyRegistry, Source
from display.edit.selection_marker import MARKED_SECONDS
from display.protocol import Notice
from display.scene_bodies import Piece, pieces_of, put_over
from scenes.scene import Scene

if TYPE_CHECKING:
    from display.device_scene import DeviceScene

DRAG_GAP = {"light": 30, "rescale": 2, "rotate": 2, "turn room": 2}  # frames without such a command that end its drag
SELECTING = (cmd.Select, cmd.Duplicate, cmd.Rescale, cmd.Rotate, cmd.Place, cmd.SetMaterial)  # what is marked then
Joining = tuple[list[Piece], list[Source]]  # the pieces of a body that is to join, and what is derived of them
SETTINGS = ("light", "gravity", "time_scale")  # of the world: an undo of one leaves the bodies where they are
FARTHEST = 100.0  # [m] that a body can be moved at once
BOX_SLACK = 0.05  # of a body's size, about its bounding box: its Gaussians reach over its cage
COPY_GAP = 0.01  # [m] between a body and its copy
SCALE_MIN, SCALE_MAX = 0.2, 5.0  # size of a body in multiples of its first one
SAME = 1e-6  # entries of a pose that differ by less are the same
SCALE_ROUNDING = 1e-6  # a factor this near to 1 changes nothing
STEPS_MAX = 64  # of the history
BYTES_MAX = 256 << 20  # of all its steps
T = TypeVar("T")


@dataclass
class Step:
    """State before an action (or, once it is undone, after it).

    action  name of the action;  state  any object from which the moment can be restored
    sizes   bytes of the state, by the identity of the objects that take them: steps may share
    """

    action: str
    state: object
    sizes: dict[int, int] = field(default_factory=dict)


class UndoStack:
    """The last actions, at most `steps` and at most `size` bytes together; the oldest are dropped."""

    def __init__(self, steps: int = STEPS_MAX, size: int = BYTES_MAX):
        self.steps, self.size = steps, size
        self.done: list[Step] = []
        self.undone: list[Step] = []

    def add(self, step: Step) -> None:
        """Push an action; undone actions can no longer be redone."""
        self.done.append(step)
        self.undone.clear()
        self._trim()

    def back(self, now: Callable[[str], Step]) -> Step | None:
        """Undo the last action: the step to return to, or None. `now` is the present state as a step of an action."""
        return self._move(self.done, self.undone, now)

    def forth(self, now: Callable[[str], Step]) -> Step | None:
        """Redo the action that was undone last."""
        return self._move(self.undone, self.done, now)

    def _move(self, source: list[Step], target: list[Step], now: Callable[[str], Step]) -> Step | None:
        if not source:
            return None
        step = source.pop()
        target.append(now(step.action))
        self._trim()
        return step

    @property
    def bytes(self) -> int:
        """Size of all steps, with shared objects counted once."""
        return sum({key: n for step in (*self.done, *self.undone) for key, n in step.sizes.items()}.values())

    def _trim(self) -> None:
        while len(self.done) + len(self.undone) > self.steps or (self.bytes > self.size and self.done):
            (self.done or self.undone).pop(0)


class Editor:
    """Carries out the commands that change bodies, and keeps the history of all that can be undone.

    A command that fails changes nothing, and `notice` says why. `selected` is the body that was last held or pointed
    at. `world` gives snapshots and restores them.
    """

    def __init__(self, world, bodies: BodyRegistry):
        self._world, self._bodies, self.history = world, bodies, UndoStack()
        self.selected: int | None = None
        self._last_action: tuple[str, int] = ("", 0)  # the action recorded last, and the frame of its last command
        self._frame = 0
        self._gripped: list[bool] = []  # by each hand in the frame before
        self.notice = Notice()
        self._selected_until = 0.0  # [s], of `recently_selected`

    @property
    def recently_selected(self) -> bool:
        """True if the selected body was pointed at or changed within the last seconds."""
        return monotonic() < self._selected_until

    def begin_frame(self) -> None:
        """Note that a frame begins."""
        self._frame += 1

    def apply(self, commands: Sequence[cmd.Command]) -> None:
        """Carry out the commands that change bodies."""
        for command in cmd.in_order(commands):
            if isinstance(command, cmd.EditCommand):
                try:
                    self.notice.clear()
                    self._carry_out(command)
                    if isinstance(command, SELECTING):
                        self._selected_until = monotonic() + MARKED_SECONDS
                except BadInput as e:
                    self.notice.tell(str(e))

    def _carry_out(self, command: cmd.Command) -> None:
        bodies = self._bodies
        match command:
            case cmd.Select(body):
                self.selected = None if body is None else self.index_of(body)
            case cmd.Remove(body):
                k = self.index_of(body)
                self.edit("remove", lambda: bodies.remove(k))
                self.selected = None
            case cmd.Duplicate(body):
                k = self.index_of(body)
                offset = copy_offset(k, self._world.bodies())
                self.selected = self.edit("duplicate", lambda: bodies.duplicate(k, offset))
            case cmd.Rescale(body, factor):
                self._rescale(self.index_of(body), factor)
            case cmd.Rotate(body, rotation):
                self._rotate(self.index_of(body), rotation)
            case cmd.Place(body, offset, rotation, continued):
                self._place(self.index_of(body), offset, rotation, continued)
            case cmd.TurnRoom(rotation, continued):
                self._turn_room(rotation, continued)
            case cmd.SetMaterial(body, material, continued):
                k = self.index_of(body)
                self.edit("material", lambda: bodies.set_material(k, material), select=k, continued=continued)
            case cmd.Undo():
                self._return(self.history.back(self._step), "Nothing to undo.")
            case cmd.Redo():
                self._return(self.history.forth(self._step), "Nothing to redo.")

    def index_of(self, body: int | None) -> int:
        """The body that a command names; None: the selected one."""
        k = self.selected if body is None else body
        if k is None:
            raise BadInput("Take hold of something first, or point at it.")
        if not 0 <= int(k) < len(self._bodies.members):
            raise BadInput(f"There is no body {k}.")
        return int(k)

    def edit(self, action: str, change: Callable[[], T], select: int | None = None, continued: bool = False) -> T:
        """Make a change of the bodies, remember the state before, unless it raises, and refresh the world."""
        before = self._before(action, continued)
        self.selected = self.selected if select is None else select
        result = change()
        self._record(action, before)
        self._world.refresh()
        return result

    def prepared(self, asset: str, name: str) -> Joining:
        """Read a body made of an asset, for `add`; a thread may do it while the play goes on. Raises BadInput."""
        pieces = pieces_of(asset, name)
        return pieces, self._bodies.derived(pieces)

    def add(self, joining: Joining) -> None:
        """Put a prepared body over the play. Raises BadInput: CapacityError where a larger world is needed."""
        if not self._bodies.members:
            raise BadInput("Nothing can be added to a scene without bodies.")
        pieces, derived = joining
        pieces = put_over(pieces, self._world.scene, self._world.bodies())
        self.selected = self.edit("add", lambda: self._bodies.add(pieces, derived))
        self._selected_until = monotonic() + MARKED_SECONDS

    def _rescale(self, k: int, wanted: float) -> None:
        now, body = self._bodies.device.solver.body_models[k].shape.factor, self._world.bodies()[k]
        if abs(wanted - 1.0) < SCALE_ROUNDING:
            return
        if not np.isfinite(wanted) or wanted <= 0.0:
            raise BadInput(f"A body cannot be made {wanted} times as large.")
        size = float(np.clip(now * wanted, SCALE_MIN, SCALE_MAX))
        size = 1.0 if abs(size - 1.0) < SCALE_ROUNDING else size
        factor = size / now
        if abs(factor - 1.0) < SCALE_ROUNDING:
            raise BadInput(f"It is as {'large' if wanted > 1.0 else 'small'} as it can be.")
        fixed = body.centroid if body.held else np.array([body.centroid[0], body.low[1], body.centroid[2]])
        self.edit("rescale", lambda: self._bodies.rescale(k, factor, fixed), select=k)

    def _rotate(self, k: int, rotation) -> None:
        body = self._world.bodies()[k]
        by = carrying(rotation_matrix(rotation), body.centroid, body.centroid)
        if not body.held:  # a body that stands on a table still does
            solver = self._bodies.device.solver
            first, last = solver.vertex_offset[k : k + 2]
            by[1, 3] += body.low[1] - (solver.snapshot()["x"][first:last] @ by[1, :3] + by[1, 3]).min()
        self.edit("rotate", lambda: self._bodies.displace(k, by), select=k)

    def _place(self, k: int, offset, rotation, continued: bool) -> None:
        offset, centroid = np.asarray(offset, np.float64), self._world.bodies()[k].centroid
        if offset.shape != (3,) or not (np.linalg.norm(offset) < FARTHEST):
            raise BadInput(f"A body cannot be moved by {offset.tolist()}.")
        by = carrying(rotation_matrix(rotation), centroid, centroid + offset)
        self.edit("place", lambda: self._bodies.displace(k, by, rest=True), select=k, continued=continued)

    def _turn_room(self, rotation, continued: bool) -> None:
        room = self._world.room
        by = room.about(rotation_matrix(rotation))

        def turn() -> None:
            room.place(by @ room.pose)
            for k in range(len(self._bodies.members)):
                self._bodies.displace(k, by, rest=True)

        self.edit("turn room", turn, continued=continued)

    # history

    def record(self, action: str, continued: bool = False) -> None:
        """Remember the state before this action; a drag, a command in each frame, is one action."""
        self._record(action, self._before(action, continued))

    def _before(self, action: str, continued: bool = False) -> Step | None:
        """The state before an action; None if it continues the last one."""
        last, frame = self._last_action
        if action == last and (continued or self._frame - frame <= DRAG_GAP.get(action, -1)):
            return None
        return self._step(action)

    def _record(self, action: str, step: Step | None) -> None:
        self._last_action = action, self._frame
        if step is not None:
            self.history.add(step)

    def _step(self, action: str) -> Step:
        """The present state, as a step that takes this action back."""
        if action in SETTINGS:
            return Step(action, getattr(self._world, action))
        snapshot = self._world.snapshot()
        solver = snapshot.bodies.solver
        sizes = {id(a): a.nbytes for a in solver.values() if isinstance(a, np.ndarray)}
        for model in solver["bodies"]:
            if model.shape.root is not model.shape:  # a scaled body has a distance grid of its own
                sizes[id(model.shape)] = model.shape.bytes
        return Step(action, (snapshot, self.selected), sizes)

    def _return(self, step: Step | None, nothing: str) -> None:
        """Bring the state of a step back."""
        self._last_action = ("", 0)
        if step is None:
            self.notice.tell(nothing)
        elif step.action in SETTINGS:
            getattr(self._world, f"set_{step.action}")(step.state)
        else:
            snapshot, self.selected = step.state
            self._world.restore(snapshot)

    # hands

    def before_step(self, hands: list[Hand]) -> Step | None:
        """The state, if a hand is about to close: then it may grasp something."""
        grips = [h is not None and h.grip for h in hands]
        before = self._gripped + [False] * len(grips)
        self._gripped = grips
        closes = any(g and not b for g, b in zip(grips, before, strict=False))
        return self._step("grab") if closes else None

    def after_step(self, step: Step | None, before: list[BodyState], bodies: list[BodyState]) -> None:
        """A body that a hand has grasped is selected, and the grasp can be undone."""
        grasped = [k for k, (a, b) in enumerate(zip(before, bodies, strict=True)) if b.held and not a.held]
        if grasped:
            self.selected = grasped[0]
            if step is not None:
                self._record("grab", step)


def rotation_matrix(rotation) -> np.ndarray:
    """Matrix (3, 3) of a quaternion (wxyz) of any length. Raises BadInput."""
    q = np.asarray(rotation, np.float64)
    if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
        raise BadInput(f"A body cannot be turned by {rotation}.")
    return matrices_from_quaternions((q / np.linalg.norm(q))[None])[0]


def carrying(rotation: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The transform (4, 4) with this rotation (3, 3) that carries a point to another."""
    return pose_matrix(end - rotation @ start, rotation)


def body_with(points: Sequence[np.ndarray], bodies: list[BodyState]) -> int | None:
    """Index of the smallest body whose bounding box, a little widened, holds all points (3,) [m]; None: none does."""
    found = []
    for k, body in enumerate(bodies):
        slack = BOX_SLACK * float((body.high - body.low).max())
        if all((p > body.low - slack).all() and (p < body.high + slack).all() for p in points):
            found.append((slack, k))
    return min(found)[1] if found else None


def copy_offset(k: int, bodies: list[BodyState]) -> np.ndarray:
    """Offset (3,) [m] of a copy from body k: above it, or beside it if it is animated, clear of all bounding boxes."""
    size = bodies[k].high - bodies[k].low + COPY_GAP
    directions = [[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]] if bodies[k].driven else [[0, 1, 0]]
    for steps in range(1, len(bodies) + 2):
        for direction in directions:
            offset = steps * size * direction
            low, high = bodies[k].low + offset, bodies[k].high + offset
            if all((low >= b.high).any() or (high <= b.low).any() for b in bodies):
                return offset
    return len(bodies) * size * directions[0]


def own_room(scene: Scene) -> Body | None:
    """The static body that is a room of the user; None: the scene has none, or it cannot be turned.

    It is the first static body. Those after it may be props of the play, such as a bottle.
    """
    still = [body for body in scene.bodies if body.material is None]
    shipped = SHIPPED_FOLDER.resolve()
    own = [b for b in still if not find_asset(b.asset).resolve().is_relative_to(shipped)]
    return own[0] if own == still[:1] and own and not any(isinstance(c, Box) for c in scene.colliders) else None


class RoomTurn:
    """The turn of the room since the start: `pose`, a rigid transform (4, 4) of the world.

    own   the room's body; None: the room is not the user's
    kept  the pose in the room's file
    """

    def __init__(self, device: DeviceScene):
        self._device, self.pose, self.kept = device, np.eye(4), np.eye(4)
        self.own = own_room(device.scene)

    @property
    def moved(self) -> bool:
        """True if the room is not in its first pose."""
        return bool(np.abs(self.pose - np.eye(4)).max() > SAME)

    @property
    def turned(self) -> bool:
        """True if the room was turned since its file was read or written."""
        return bool(np.abs(self.pose - self.kept).max() > SAME)

    def about(self, rotation: np.ndarray) -> np.ndarray:
        """The transform (4, 4) that turns the room by (3, 3) about `middle`. Raises BadInput."""
        if self.own is None:
            raise BadInput("Only a room of your own can be turned: vrgs.py capture, or --stage ROOM.")
        return carrying(rotation, self.middle, self.middle)

    @property
    def middle(self) -> np.ndarray:
        """The point (3,) [m] that the scene looks at, which turning leaves in place."""
        return np.asarray(self._device.scene.target, np.float64)

    def place(self, pose: np.ndarray) -> None:
        """Put the room, and the light with it, at a pose."""
        if np.abs(pose - self.pose).max() <= 0.0:
            return
        by, light = pose @ np.linalg.inv(self.pose), self._device.light
        self.pose = pose_matrix(pose[:3, 3], best_fit_rotation(pose[:3, :3]))  # without rounding errors
        self._device.place_room(self.pose)
        if light is not None:
            position, target = (
                tuple((by[:3, :3] @ np.asarray(p, np.float64) + by[:3, 3]).tolist())
                for p in (light.position, light.target)
            )
            self._device.set_light(replace(light, position=position, target=target))
