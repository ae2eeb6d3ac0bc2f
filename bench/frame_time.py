"""`vrgs.py bench frame`: a headset's frame without a headset: ring toss in stereo, scripted hands, up to the textures.

Two eyes of 1800x1920, a head that sways, hands drawn and in contact. As in a headset, the head is located after the
simulation, at the start of drawing; the time from there to the finished picture is measured by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from time import perf_counter

import numpy as np

from bench.render_speed import two_eyes
from core.camera import Camera, look_at
from core.fields import destroy_fields
from core.runtime import keep_compiled_kernels
from core.vocabulary import Hand
from display.protocol import Frame
from display.timing import Timings
from display.world import World
from display.xr import avatar
from display.xr.actions import Controller
from display.xr.headset import Mirror
from display.xr.swapchains import FRAGMENT, VERTEX
from scenes import ring_toss
from scenes.scene import Scene

EYE_SIZE = (1800, 1920)  # [px] of an eye
RATE = 90.0  # [Hz]
REACH = (0.2, -0.3, 0.4)  # [m] of each hand from the head: sideways, up, forwards


class StereoPlay:
    """A running world, and its frames of 1/90 s.

    frame_ms, photon_ms  of each frame since `start`: all of it, and from where the head is located to its end
    """

    def __init__(self, scene: Scene, size: tuple[int, int] = EYE_SIZE, *, reserve: Sequence[str] = ()) -> None:
        self.scene, self.size = scene, size
        hands = avatar.skins()
        self.hand_gaussians = sum(len(skin.gaussians) for skin in hands)
        view = {"width": size[0], "height": size[1], "views": 2}
        self.world = World(scene, **view, reserve=reserve, fingers=True, props=hands)
        self.world.script_dt = 1 / RATE  # each frame is simulated, as with hands of a player's
        self.world.warm_up()
        self.frame_ms: list[float] = []
        self.photon_ms: list[float] = []
        self._world_from_head = np.linalg.inv(look_at(scene.eye, scene.target))
        self._count = 0

    def close(self) -> None:
        """Free the world's device memory."""
        with keep_compiled_kernels():
            destroy_fields(list(vars(self.world.device).values()))

    def start(self, *, exact: bool) -> None:
        """Put the scene at its start and begin to measure; with `exact` each stage waits for the device."""
        self.world.reset()
        self.world.timings = Timings(exact=exact)
        self.frame_ms, self.photon_ms = [], []

    def play(self, frames: int, present: Callable[[], None]) -> None:
        """Play frames; `present` shows the picture and waits for the device. A game that is over begins again."""
        for _ in range(frames):
            if self.scene.game is not None and self.world.time > self.scene.game.duration:
                self.world.reset()
            self.frame(present)

    def frame(self, present: Callable[[], None], hands: list[Hand] | None = None, commands: Sequence = ()) -> None:
        """Play a frame with these hands (None: the scripted player's) and commands."""
        k, located = self._count, perf_counter()

        def cameras() -> list[Camera]:
            nonlocal located
            located = perf_counter()
            return self.eyes(k)

        begin = perf_counter()
        poses = avatar.hidden()
        for h, controller in enumerate(self.controllers(k)):
            avatar.show_hand(poses, h, controller, np.eye(4), 0.0)
        hands = self.world.scripted_hands(self.world.time) if hands is None else hands
        self.world.step(Frame(1 / RATE, k / RATE, cameras, hands, list(commands), prop_poses=poses))
        with self.world.timings.stage("present"):
            present()
        end = perf_counter()
        self.frame_ms.append(1e3 * (end - begin))
        self.photon_ms.append(1e3 * (end - located))
        self._count += 1

    def eyes(self, k: int) -> list[Camera]:
        """Both eyes of a head that sways: one to the left, one to the right, looking the same way."""
        sway = (0.05 * math.sin(0.02 * k), 0.02 * math.sin(0.013 * k), 0.0)
        between = look_at([e + s for e, s in zip(self.scene.eye, sway, strict=True)], self.scene.target)
        return two_eyes(between, *self.size, 0.55 * self.size[0])

    def controllers(self, k: int) -> list[Controller]:
        """Both hands before the head, in motion."""
        result = []
        for side in (-1, 1):
            c = Controller()
            aside, up, ahead = REACH
            sway = (0.03 * math.sin(0.05 * k), 0.05 * math.sin(0.07 * k))
            at = self._world_from_head @ (side * aside + sway[0], -up - sway[1], ahead, 1.0)
            c.grip = np.eye(4)
            c.grip[:, 3] = at
            c.aim = c.grip
            result.append(c)
        return result


FRAMES = 1000
WARM_FRAMES = 2  # warm-up frames: kernels are compiled, and everything is in motion


def run() -> Iterator[dict]:
    """Measure as it runs, and stage by stage; prints and yields both rows."""
    for row in map(measure, (False, True)):
        print("stage by stage" if row["exact"] else "as it runs")
        for name, values in row["stages"].items():
            print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f}".format(name, **values))
        print("  {:10} {median_ms:8.2f} ms, worst {worst_ms:8.2f} of {frames}".format("frame", **row))
        print(f"  from motion to light {row['photon_ms']:.2f} ms and {500 / RATE:.2f} on average to the next refresh")
        print(f"  pictures go to OpenGL {'through the host' if row['through_host'] else 'on the device'}")
        yield row


def measure(exact: bool) -> dict:
    """Times [ms] of FRAMES frames and their stages; with `exact` each stage waits for the device."""
    play = StereoPlay(ring_toss.build())
    opengl = Mirror("", (0, 0), 2, shown=False)
    gl, picture = opengl.gl, opengl.texture
    targets = [gl.framebuffer(color_attachments=[gl.texture(EYE_SIZE, 4)]) for _ in range(2)]
    program = gl.program(VERTEX, FRAGMENT)
    triangle = gl.vertex_array(program, [])

    def present() -> None:
        picture.upload(play.world.picture)
        picture.texture.use(0)
        for view, target in enumerate(targets):
            target.use()
            gl.viewport = (0, 0, *EYE_SIZE)
            program["rows"] = (view * EYE_SIZE[1], EYE_SIZE[1])
            triangle.render(gl.TRIANGLES, vertices=3)
        gl.finish()

    play.play(WARM_FRAMES, present)
    play.start(exact=exact)
    play.play(FRAMES, present)
    stages = play.world.timings.as_dict()
    row = {"exact": exact, "stages": stages, "frames": FRAMES, "median_ms": float(np.median(play.frame_ms))}
    row |= {"worst_ms": max(play.frame_ms), "photon_ms": float(np.median(play.photon_ms))}
    row |= {"through_host": picture.through_host}
    opengl.close()
    return row
