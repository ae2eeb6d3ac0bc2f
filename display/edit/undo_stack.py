"""Undo stack of the user's actions, independent of worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

STEPS_MAX = 64
BYTES_MAX = 256 << 20


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

    def back(self, now: Callable[[Step], Step]) -> Step | None:
        """Undo the last action: the step to return to, or None. `now` returns the present state as a step."""
        return self._move(self.done, self.undone, now)

    def forth(self, now: Callable[[Step], Step]) -> Step | None:
        """Redo the action that was undone last."""
        return self._move(self.undone, self.done, now)

    def _move(self, source: list[Step], target: list[Step], now: Callable[[Step], Step]) -> Step | None:
        if not source:
            return None
        step = source.pop()
        target.append(now(step))
        self._trim()
        return step

    @property
    def bytes(self) -> int:
        """Size of all steps, with shared objects counted once."""
        return sum({key: n for step in (*self.done, *self.undone) for key, n in step.sizes.items()}.values())

    def _trim(self) -> None:
        while len(self.done) + len(self.undone) > self.steps or (self.bytes > self.size and self.done):
            (self.done or self.undone).pop(0)
