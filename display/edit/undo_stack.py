"""What the user did, to be taken back and done again. Knows nothing of worlds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

MOST_STEPS = 64
MOST_BYTES = 256 << 20


@dataclass
class Step:
    """How things were before (or, once it is taken back, after) an action.

    action  what the user did, in a word;  state  whatever brings that moment back
    sizes   bytes of the state, by the identity of what takes them: steps may share
    """

    action: str
    state: object
    sizes: dict[int, int] = field(default_factory=dict)


class UndoStack:
    """The last actions, no more than `steps`, and of no more than `size` bytes together: the oldest are forgotten."""

    def __init__(self, steps: int = MOST_STEPS, size: int = MOST_BYTES):
        self.steps, self.size = steps, size
        self.done: list[Step] = []
        self.undone: list[Step] = []

    def add(self, step: Step) -> None:
        """A new action; what was taken back before can no longer be done again."""
        self.done.append(step)
        self.undone.clear()
        self._trim()

    def back(self, now: Callable[[Step], Step]) -> Step | None:
        """Take the last action back: the step to return to, None if there is none. `now` gives the present state, as
        the same kind of step."""
        return self._move(self.done, self.undone, now)

    def forth(self, now: Callable[[Step], Step]) -> Step | None:
        """Do again what was taken back last."""
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
        """What all steps take, each thing that they share counted once."""
        return sum({key: n for step in (*self.done, *self.undone) for key, n in step.sizes.items()}.values())

    def _trim(self) -> None:
        while len(self.done) + len(self.undone) > self.steps or (self.bytes > self.size and self.done):
            (self.done or self.undone).pop(0)
