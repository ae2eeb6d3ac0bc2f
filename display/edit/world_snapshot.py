"""A moment of a running world, kept and brought back."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from display.body_registry import BodyRegistry, Member
from display.edit.undo_stack import Step


@dataclass(frozen=True)
class WorldSnapshot:
    """Everything of a running world but its light and its settings."""

    solver: dict
    members: tuple[Member, ...]
    motions: tuple
    time: float
    owed: float
    game: dict
    selected: int | None


def moment_of(world, cast: BodyRegistry, selected: int | None) -> WorldSnapshot:
    """How things are now; hands count as open."""
    world.settle()
    snapshot = {**world.solver.snapshot(), "grips": ()}
    game = {} if world.scene.game is None else deepcopy(vars(world.scene.game))
    motions = tuple((m, m.time) for m in world.motions)
    return WorldSnapshot(snapshot, cast.members, motions, world.time, world.owed, game, selected)


def bring_back(moment: WorldSnapshot, world, cast: BodyRegistry) -> None:
    """Let everything be as it was then."""
    cast.with_room(lambda: world.solver.restore(moment.solver))
    world.motions = [motion for motion, _ in moment.motions]
    for motion, time in moment.motions:
        motion.time, motion.solver = time, world.solver
    world.time, world.owed = moment.time, moment.owed
    if world.scene.game is not None:
        vars(world.scene.game).update(deepcopy(moment.game))
    cast.follow(moment.members)
    world.refresh()


def step_of(action: str, moment: WorldSnapshot) -> Step:
    """The moment as a step of the history, with what it takes."""
    sizes = {id(a): a.nbytes for a in moment.solver.values() if isinstance(a, np.ndarray)}
    for part in moment.solver["bodies"]:
        if part.shape.root is not part.shape:  # a scaled body has a distance grid of its own
            sizes[id(part.shape)] = part.shape.bytes
    return Step(action, moment, sizes)
