"""played_headset.py LOG FRAMES SCENE ...: the program in a headset, led by each scene's scripted player.

What the script's hands do, the controllers do: that goes through Monado's remote driver and comes back as the player's
hands. Where a hand is to grip, it first goes to the nearest point of a body within the script's reach, as a user would
who sees it: a controller reaches less far. The script waits for the controllers, and the head walks along. Each scene
ends once a body was held for a while, or after FRAMES frames; a JSON line in LOG says how it went.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import display.world
import vrgs
from display.xr import headset, player
from tests.support.remote_headset import PORT
from tests.support.remote_headset import Player as Wearer

ARM = 0.45  # [m] from the head to a hand, horizontally, that is convenient
EYE_HEIGHT = 1.6  # [m]
HELD_FRAMES = 10
STEP = 0.1  # [s] by which the script goes on in a frame at most
REST_FRAMES = 2  # after which a controller may be where it was sent
PATIENCE = 20  # frames that a hand tries to take something
SMALL = "0.3"  # of the recommended size: pictures are looked at elsewhere


class Play:
    """One scene: leads the controllers, and notes what comes of it."""

    def __init__(self, limit: int):
        self.limit = limit
        self.headset = self.player = self.wearer = None
        self.noted = {"frames": 0, "held": 0, "scripted": 0, "off": 9.9, "finite": True, "contrast": 0}
        self._lag = 0.0  # [s] of the script behind the world
        self._shift = [np.zeros(3), np.zeros(3)]  # [m] from the script's hands to the controllers
        self._sent = [None, None]  # positions in the world
        self._rests = [0, 0]  # frames for which they were the same
        self._grips, self._tried = [False, False], [0, 0]

    def after(self, world, frame) -> None:
        """Note the frame, and lead the controllers on."""
        noted, bodies = self.noted, world.bodies()
        held = any(body.held for body in bodies)
        noted["frames"] += 1
        noted["held"] += bool(held)
        noted["finite"] &= bool(all(np.isfinite(body.centroid).all() for body in bodies))
        if noted["frames"] % 5 == 0:
            noted["contrast"] = max(noted["contrast"], int(np.ptp(world.picture.to_numpy() & 255)))
        self._lag += max(frame.dt - STEP, 0.0)
        if any(0 < tries < PATIENCE for tries in self._tried):
            self._lag += min(frame.dt, STEP)  # the script waits
        self.lead(world, frame, held)
        if noted["frames"] >= self.limit or noted["held"] >= HELD_FRAMES:
            type(self.headset._mirror).closing = True  # as if the user had closed the window

    def lead(self, world, frame, held: bool) -> None:
        """Move the controllers to where the script's hands are."""
        if self.wearer is None:
            self.wearer = Wearer(int(os.environ[PORT]))
        controllers = (self.wearer.left, self.wearer.right)
        to_play = np.linalg.inv(self.player.play_space.world_from_play)
        for k, (hand, controller) in enumerate(
            zip(world.scripted_hands(world.time - self._lag), controllers, strict=False)
        ):
            at = np.array(hand.position, float)
            there = np.array(frame.hands[k].position)
            if hand.grip and not self._grips[k]:
                nearest = world.nearest(at)
                near = np.linalg.norm(nearest - at) <= hand.reach
                self._shift[k], self._tried[k] = (nearest - at if near else np.zeros(3)), 1
            elif hand.grip and self._tried[k]:
                arrived = np.linalg.norm(there - self._sent[k]) < 0.01
                self._tried[k] = 0 if held else self._tried[k] + 1
                controller.squeeze = float(arrived or held)
            elif not hand.grip:
                controller.squeeze, self._shift[k], self._tried[k] = 0.0, np.zeros(3), 0
            self.noted["scripted"] += bool(hand.grip)
            self._grips[k] = hand.grip
            same = self._sent[k] is not None and np.allclose(at + self._shift[k], self._sent[k], atol=1e-6)
            self._rests[k] = self._rests[k] + 1 if same else 0
            if self._rests[k] >= REST_FRAMES:
                self.noted["off"] = min(self.noted["off"], float(np.linalg.norm(there - self._sent[k])))
            self._sent[k] = at + self._shift[k]
            controller.position = tuple((to_play @ [*self._sent[k], 1.0])[:3].tolist())
            self.walk(np.array(controller.position))
        self.wearer.send()

    def walk(self, hand: np.ndarray) -> None:
        """Bring the head to where the hand is convenient."""
        head = np.array(self.wearer.position, float)
        away = (hand - head)[[0, 2]]
        distance = np.linalg.norm(away)
        if distance > ARM:
            head[[0, 2]] += away * (distance - ARM) / distance
        self.wearer.position = (float(head[0]), EYE_HEIGHT, float(head[2]))


class PlayedWorld(display.world.World):
    """The world itself; what is not needed is not compiled."""

    def warm_up(self) -> None:
        pass

    def nearest(self, at: np.ndarray) -> np.ndarray:
        """The nearest vertex of a body."""
        x = self.device.solver.x.to_numpy()
        return x[np.argmin(np.linalg.norm(x - at, axis=1))].astype(float)


def play(name: str, frames: int) -> dict:
    """Play a scene in the headset."""
    now = Play(frames)

    class Watched(PlayedWorld):
        def step(self, frame):
            super().step(frame)
            now.after(self, frame)

    display.world.World = Watched
    made, worn = headset.Headset.__init__, player.Player.__init__
    headset.Headset.__init__ = lambda self, *a, **k: (setattr(now, "headset", self), made(self, *a, **k))[1]
    player.Player.__init__ = lambda self, *a: (setattr(now, "player", self), worn(self, *a))[1]
    try:
        status = vrgs.main(["--xr", "--scene", name, "--arch", "cpu", "--render-scale", SMALL])
    finally:
        headset.Headset.__init__, player.Player.__init__ = made, worn
        if now.wearer is not None:
            now.wearer.close()
    return {"scene": name, "status": status, **now.noted}


if __name__ == "__main__":
    log, frames, *names = sys.argv[1:]
    with open(log, "w", encoding="utf-8", buffering=1) as file:
        for name in names:
            file.write(json.dumps(play(name, int(frames))) + "\n")
