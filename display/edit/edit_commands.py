"""The commands that change bodies in a running world: copies, sizes, turns, materials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from display.body_registry import BodyRegistry
from scenes.scene import BodyState

GAP = 0.01  # [m] between a body and its copy
SMALLEST, LARGEST = 0.2, 5.0  # times its first size
SAME = 1e-6  # a factor this near to 1 changes nothing


class Changes:
    """Part of the Editor. Bodies are named by their index, or None: the selected one. BadInput, and nothing has
    changed, if something cannot be."""

    cast: BodyRegistry
    selected: int | None

    def _index(self, k) -> int:
        """The body that is meant; None: the selected one."""
        k = self.selected if k is None else k
        if k is None:
            raise BadInput("Take hold of something first, or point at it.")
        if not 0 <= int(k) < len(self.cast.members):
            raise BadInput(f"There is no body {k}.")
        return int(k)

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

    def _rescale(self, k: int | None, wanted: float) -> None:
        factor = wanted
        k, w = self._index(k), self.world
        now, body = w.solver.parts[k].shape.factor, w.bodies()[k]
        if abs(factor - 1.0) < SAME:
            return
        if not np.isfinite(factor) or factor <= 0.0:
            raise BadInput(f"A body cannot be made {factor} times as large.")
        size = float(np.clip(now * factor, SMALLEST, LARGEST))
        size = 1.0 if abs(size - 1.0) < SAME else size
        factor = size / now
        if abs(factor - 1.0) < SAME:
            raise BadInput(f"It is as {'large' if wanted > 1.0 else 'small'} as it can be.")
        foot = body.centroid if body.held else np.array([body.centroid[0], body.low[1], body.centroid[2]])
        self.selected, before = k, self._before("rescale")
        self.cast.with_room(lambda: w.solver.rescale(k, factor, about=foot))
        self._keep("rescale", before)
        self._move(k, scaling(factor, foot))

    def _rotate(self, k: int | None, quaternion) -> None:
        k, w, q = self._index(k), self.world, np.asarray(quaternion, np.float64)
        if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
            raise BadInput(f"A body cannot be turned by {quaternion}.")
        body, by = w.bodies()[k], np.eye(4)
        by[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0]
        by[:3, 3] = body.centroid - by[:3, :3] @ body.centroid
        if not body.held:  # what stands on a table still does
            first, last = w.solver.vertex_offset[k : k + 2]
            by[1, 3] += body.low[1] - (w.solver.snapshot()["x"][first:last] @ by[1, :3] + by[1, 3]).min()
        self.selected, before = k, self._before("rotate")
        w.solver.displace(k, by)
        self._keep("rotate", before)
        self._move(k, by)

    def _set_material(self, k: int | None, material: Material | str) -> None:
        k, w = self._index(k), self.world
        self.selected, before = k, self._before("material")
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


def scaling(factor: float, about: np.ndarray) -> np.ndarray:
    """(4, 4) that puts everything `factor` times as far from a point [m]."""
    by = np.diag([factor, factor, factor, 1.0])
    by[:3, 3] = (1.0 - factor) * about
    return by


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
