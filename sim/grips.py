"""What hands hold, as values that can be kept and given back (NumPy only)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.gaussians import matrices_of_quats
from scenes.scene import Hand


@dataclass(frozen=True, eq=False)
class Grip:
    """What a hand holds: some vertices (n,) of a body, and their places in the hand's frame [m], (n, 3)."""

    body: int
    vertices: np.ndarray
    places: np.ndarray


@dataclass(frozen=True)
class Grips:
    """What each hand holds, None for nothing, and how it was last given."""

    held: tuple[Grip | None, ...]
    last: tuple[Hand | None, ...]

    def moved(self, index: list[int | None]) -> Grips:
        """The same after bodies were renumbered: index[old] is the new one, None if it is gone, and so is the grip."""
        held = [g if g is None or index[g.body] is None else replace(g, body=index[g.body]) for g in self.held]
        gone = [g is not None and index[g.body] is None for g in self.held]
        return replace(self, held=tuple(None if out else g for g, out in zip(held, gone, strict=True)))

    def shifted(self, body: int, shift: np.ndarray) -> Grips:
        """The same after the vertices of a body were moved by (V, 3) [m]: the hands do not pull at them for it."""
        held = list(self.held)
        for h, grip in enumerate(held):
            if grip is not None and grip.body == body:
                world_from_hand = matrices_of_quats(unit(self.last[h].rotation)[None])[0]
                held[h] = replace(grip, places=grip.places + shift[grip.vertices] @ world_from_hand)
        return replace(self, held=tuple(held))


def unit(quaternion) -> np.ndarray:
    q = np.asarray(quaternion, np.float64)
    return q / np.linalg.norm(q)


def pose(hand: Hand) -> np.ndarray:
    """Position and unit quaternion of a hand, (7,)."""
    return np.concatenate([np.asarray(hand.position, np.float64), unit(hand.rotation)])
