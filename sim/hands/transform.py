"""Rigid editing: gripped bodies follow the hand exactly and nothing else moves (interaction = "transform")."""

import numpy as np

from core.rotation import matrices_from_quaternions
from scenes.scene import Hand
from sim.hands.rigid_placement import RigidPlacement
from sim.hands.two_hand_scaling import TwoHandScaling
from sim.state import State


class Transform:
    """x = hand_now hand_at_grip^-1 x_at_grip for all vertices of a gripped body.

    Always from the positions at the grip, so that no error accumulates however long a body is held. A body held by two
    hands follows both (sim/hands/two_hand_scaling.py).
    """

    def __init__(self, state: State):
        self.moved = RigidPlacement(state)
        self.stretch = TwoHandScaling(state)
        self.grips: dict[int, tuple[int, np.ndarray]] = {}  # hand -> body, hand_from_world at the grip
        self._poses: dict[int, np.ndarray] = {}  # hand -> world_from_hand after the last step, of those that hold
        self._held: dict[int, np.ndarray] = {}  # the same of those that go on holding what was changed

    def step(self, hands: list[Hand | None], gripped: list[int]) -> None:
        """Move what the hands hold; gripped[h] is the body in hand h, -1 for none."""
        gripped = self.stretch.step(hands, gripped)
        for h, hand in enumerate(hands):
            body = gripped[h] if h < len(gripped) else -1
            if body < 0:
                self.grips.pop(h, None)
            elif self.grips.get(h, (-1,))[0] != body:
                begin = self._held.get(h)
                self.grips[h] = (body, np.linalg.inv(world_from_hand(hand) if begin is None else begin))
                self.moved.keep(body)
        moved = set()
        for h, (body, hand_from_world) in sorted(self.grips.items()):
            if body not in moved and h < len(hands):
                M = world_from_hand(hands[h]) @ hand_from_world
                self.moved.to(body, M[:3, :3], M[:3, 3])
                moved.add(body)
        self._held = {}
        self._poses = {h: world_from_hand(hands[h]) for h in self.grips if h < len(hands)}

    def reset(self, *, held: bool = False) -> None:
        """Restart from changed positions; bodies that are `held` stay in the hands, relative to their last poses."""
        self.grips.clear()
        self.stretch.reset()
        self._held = self._poses if held else {}

    def end(self) -> None:
        """Release all bodies that two hands scale."""
        self.stretch.end()

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self.moved.warm_up()
        self.stretch.warm_up()

    def destroy(self) -> None:
        self.moved.destroy()
        self.stretch.destroy()


def world_from_hand(hand: Hand) -> np.ndarray:
    """Pose of a hand as a 4x4 matrix, float64."""
    M = np.eye(4)
    q = np.asarray(hand.rotation, np.float64)
    M[:3, :3] = matrices_from_quaternions((q / np.linalg.norm(q))[None])[0]
    M[:3, 3] = hand.position
    return M
