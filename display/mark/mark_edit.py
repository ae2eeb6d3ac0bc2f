"""Marks being drawn: objects, strokes and boxes on views, with undo and redo."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass, field, replace

GROW_MAX = 50  # rings of neighbours


@dataclass(frozen=True)
class Mark:
    """A stroke or box of an object on a view.

    kind    "inside", "outside" or "boxes"
    points  (x, y) of a stroke in pixels of the picture; two opposite corners of a box
    """

    object: str
    view: str
    kind: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class MarkState:
    """All marks: names of the objects, marks, and by how many rings an object is grown.

    points  numbered points (x, y) on a view, by its name, in pixels of the picture; None: not there
    """

    objects: tuple[str, ...] = ("object_1",)
    marks: tuple[Mark, ...] = ()
    grow: dict[str, int] = field(default_factory=dict)
    points: dict[str, tuple[tuple[float, float] | None, ...]] = field(default_factory=dict)

    @property
    def views(self) -> list[str]:
        """Names of the views with marks, sorted."""
        return sorted({m.view for m in self.marks} | {view for view, row in self.points.items() if any(row)})


def free_name(kind: str, taken: Collection[str]) -> str:
    """A new name: "object_3"."""
    return next(name for k in itertools.count(len(taken) + 1) if (name := f"{kind}_{k}") not in taken)


class MarkEdit:
    """State of the marks with undo; `current` is the index of the object being marked."""

    def __init__(self, state: MarkState | None = None):
        self.state, self.current = state or MarkState(), 0
        self._done: list[MarkState] = []
        self._undone: list[MarkState] = []

    @property
    def name(self) -> str:
        """Name of the object being marked."""
        return self.state.objects[self.current]

    @property
    def changed(self) -> bool:
        """True if anything was marked since the start and not undone."""
        return bool(self._done)

    def _do(self, state: MarkState) -> None:
        if state != self.state:
            self._done.append(self.state)
            self._undone, self.state = [], state

    def add(self, view: str, kind: str, points) -> None:
        """Add a stroke or box of the current object."""
        mark = Mark(self.name, view, kind, tuple((float(x), float(y)) for x, y in points))
        self._do(replace(self.state, marks=(*self.state.marks, mark)))

    def put_point(self, view: str, number: int, at: tuple[float, float]) -> None:
        """Put the point of a number, from 0 on, at a place of a view."""
        row = [*self.state.points.get(view, ())]
        row += [None] * (number + 1 - len(row))
        row[number] = (float(at[0]), float(at[1]))
        self._do(replace(self.state, points=self.state.points | {view: tuple(row)}))

    def missing_point(self, view: str) -> int:
        """The lowest number whose point is not yet on a view."""
        row = (*self.state.points.get(view, ()), None)
        return row.index(None)

    def delete(self) -> None:
        """Delete the current object with its marks; the only one keeps its name."""
        name = self.name
        left = tuple(m for m in self.state.marks if m.object != name)
        objects = tuple(n for n in self.state.objects if n != name) or self.state.objects
        grow = {n: r for n, r in self.state.grow.items() if n != name}
        self._do(replace(self.state, objects=objects, marks=left, grow=grow))
        self.current = min(self.current, len(objects) - 1)

    def grow(self, rings: int) -> None:
        """Grow the current object by so many rings, or shrink it."""
        now = max(-GROW_MAX, min(GROW_MAX, self.state.grow.get(self.name, 0) + rings))
        self._do(replace(self.state, grow=self.state.grow | {self.name: now}))

    def new_object(self) -> None:
        """Start another object."""
        self._do(replace(self.state, objects=(*self.state.objects, free_name("object", self.state.objects))))
        self.current = len(self.state.objects) - 1

    def rename(self, name: str) -> bool:
        """Give the current object another name; False if it is taken or not valid."""
        old = self.name
        if not name or (name in self.state.objects and name != old):
            return False
        objects = tuple(name if n == old else n for n in self.state.objects)
        marks = tuple(replace(m, object=name) if m.object == old else m for m in self.state.marks)
        grow = {name if n == old else n: r for n, r in self.state.grow.items()}
        self._do(replace(self.state, objects=objects, marks=marks, grow=grow))
        return True

    def choose(self, index: int) -> None:
        """Make this object the current one, if it exists."""
        if 0 <= index < len(self.state.objects):
            self.current = index

    def undo(self) -> None:
        """Undo the last step."""
        self._step(self._done, self._undone)

    def redo(self) -> None:
        """Redo the step that was undone last."""
        self._step(self._undone, self._done)

    def _step(self, source: list[MarkState], target: list[MarkState]) -> None:
        if source:
            target.append(self.state)
            self.state = source.pop()
            self.current = min(self.current, len(self.state.objects) - 1)
