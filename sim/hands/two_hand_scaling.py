"""Two-hand scaling (interaction = "transform"): a body held by two hands follows both in position, attitude and size.

    x = m + s R (x_0 - m_0),   s = |q_2 - q_1| / |p_2 - p_1|,   m the middle of the hands q; m_0 of p, at the grip

with R the shortest rotation that takes the line of the hands at the grip to their present line. When a hand lets go,
the body gets its own size back about the fixed point of a rescaling (its foot, or its centre of mass if the other hand
goes on holding it), and `take_finished` returns the factor by which it is to be rescaled.
"""

from dataclasses import dataclass

import numpy as np

from scenes.scene import Hand
from sim.hands.rigid_placement import RigidPlacement
from sim.state import State

MIN_SCALE, MAX_SCALE = 0.25, 4.0  # in one gesture
MIN_HAND_DISTANCE = 0.03  # [m] at the grip; closer hands would scale by their tremor
MIN_SCALE_CHANGE = 0.02  # a smaller change of size is ignored


@dataclass
class Pair:
    """Hands h and k on a body: their positions at the grip (2, 3) [m], and the change since."""

    h: int
    k: int
    places: np.ndarray
    factor: float = 1.0
    turn: np.ndarray = None  # R, (3, 3)
    middle: np.ndarray = None  # m, (3,)


class TwoHandScaling:
    """Bodies held by two hands; `moved` has their vertices at the second grip."""

    def __init__(self, state: State):
        self.state, self.moved = state, RigidPlacement(state)
        self.reset()

    def reset(self) -> None:
        """Forget all pairs of hands."""
        self.pairs: dict[int, Pair] = {}
        self.finished: tuple[int, float] | None = None

    def step(self, hands: list[Hand | None], gripped: list[int]) -> list[int]:
        """Move what two hands hold; gripped[h] is the body in hand h, -1 for none. The same for hands alone."""
        holding: dict[int, list[int]] = {}
        for h, body in enumerate(gripped[: len(hands)]):
            if body >= 0 and hands[h] is not None:
                holding.setdefault(body, []).append(h)
        for body, pair in list(self.pairs.items()):
            if holding.get(body, [])[:2] != [pair.h, pair.k]:
                self._end(body, alone=body in holding)
        alone = list(gripped)
        for body, by in holding.items():
            if len(by) < 2:
                continue
            places = np.array([hands[h].position for h in by[:2]], np.float64)
            if body not in self.pairs:
                if np.linalg.norm(places[1] - places[0]) < MIN_HAND_DISTANCE:
                    continue
                self.pairs[body] = Pair(*by[:2], places)
                self.moved.keep(body)
            self._follow(body, places)
            for h in by:
                alone[h] = -1
        return alone

    def _follow(self, body: int, places: np.ndarray) -> None:
        pair = self.pairs[body]
        before, now = pair.places[1] - pair.places[0], places[1] - places[0]
        lengths = np.linalg.norm(before), np.linalg.norm(now)
        pair.factor = float(np.clip(lengths[1] / lengths[0], MIN_SCALE, MAX_SCALE))
        pair.turn = turn_between(before / lengths[0], now / max(lengths[1], 1e-9))
        pair.middle = places.mean(0)
        self._place(body, pair.factor, pair.turn, pair.places.mean(0), pair.middle)

    def _place(self, body: int, factor: float, R: np.ndarray, origin: np.ndarray, to: np.ndarray) -> None:
        A = factor * R
        self.moved.to(body, A, to - A @ origin)

    def end(self) -> None:
        """Release all bodies."""
        for body in list(self.pairs):
            self._end(body, alone=False)

    def _end(self, body: int, *, alone: bool) -> None:
        """Give a body its own size back; `alone`: one hand goes on holding it."""
        pair, s = self.pairs.pop(body), self.state
        n = s.sizes.vertices
        mine = s.body_of_vertex.to_numpy()[:n] == body
        x, mass = self.moved.start.to_numpy()[:n][mine].astype(np.float64), s.mass.to_numpy()[:n][mine]
        stay = np.average(x, axis=0, weights=mass)
        if not alone:  # its foot, as it is turned now
            up = pair.turn.T @ (0.0, 1.0, 0.0)
            stay = stay + up * ((x - stay) @ up).min()
        to = pair.middle + pair.factor * pair.turn @ (stay - pair.places.mean(0))
        self._place(body, 1.0, pair.turn, stay, to)
        if abs(pair.factor - 1.0) > MIN_SCALE_CHANGE:
            self.finished = (body, pair.factor)

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self.moved.warm_up()
        for field in (self.state.body_of_vertex, self.moved.start, self.state.mass):
            field.to_numpy()

    def take_finished(self) -> tuple[int, float] | None:
        """Body and factor by which it is to be rescaled, once; None for none."""
        finished, self.finished = self.finished, None
        return finished

    def destroy(self) -> None:
        self.moved.destroy()


def turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The shortest rotation (3, 3) that takes unit vector a to b."""
    v, c = np.cross(a, b), float(a @ b)
    if c < -0.9999:  # about any axis across
        side = np.cross(a, (1.0, 0.0, 0.0) if abs(a[0]) < 0.9 else (0.0, 1.0, 0.0))
        side /= np.linalg.norm(side)
        return 2.0 * np.outer(side, side) - np.eye(3)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.eye(3) + K + K @ K / (1.0 + c)
