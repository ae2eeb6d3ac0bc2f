"""A world of one ball before a coloured sky, cheap enough to test displays with.

Run as a program it opens the real window, the headset or the server of a page on it and logs each frame, one JSON a
line:
    python tests/support/fake_world.py LOG.jsonl [--size W H] [--frames N] [--xr | --web] [--coarse]
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import taichi as ti

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core.material import MATERIALS
from core.runtime import COMPILER_OPTIONS
from core.vocabulary import BodyState, Light
from display import user_commands as cmd
from display.adaptive_resolution import DynamicResolution, WindowResolution
from display.keep.keeper import Keeper
from display.protocol import WorldView
from display.timing import Timings
from scenes.scene import Scene

RADIUS = 0.3  # [m]
RED = (230, 60, 50)
PERIOD = 1 / 60  # [s] a frame at least: what is drawn faster only costs
vec3 = ti.types.vector(3, ti.f32)


class BallGame:
    """Scores once the ball has left its place."""

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.score, self.message = 0, "Throw the red ball."

    def update(self, time, bodies) -> None:
        if np.linalg.norm(bodies[0].centroid) > 0.5:
            self.score, self.message = 1, "Well thrown!"

    def hands(self, time, bodies) -> list:
        return []

    def verify(self, bodies) -> None:
        assert self.score == 1


def fake_scene() -> Scene:
    """Camera 3 m in front of the ball, which is at the origin."""
    return Scene(
        bodies=[], light=Light(position=(1.0, 2.0, 1.5)), eye=(0.0, 0.0, 3.0), target=(0.0, 0.0, 0.0), game=BallGame()
    )


@ti.kernel
def paint(
    picture: ti.types.ndarray(ti.u32, ndim=2),
    view: ti.i32,
    height: ti.i32,
    eye: vec3,
    right: vec3,
    down: vec3,
    forward: vec3,
    fx: ti.f32,
    fy: ti.f32,
    ball: vec3,
    light: vec3,
):
    """Ray cast: sky coloured by direction, ball shaded by the angle to the light."""
    for i, j in ti.ndrange(height, picture.shape[1]):
        x = (j + 0.5 - 0.5 * picture.shape[1]) / fx
        y = (i + 0.5 - 0.5 * height) / fy
        d = (x * right + y * down + forward).normalized()
        colour = 255.0 * ti.math.clamp(vec3(0.3 + 0.25 * d.x, 0.45 + 0.3 * d.y, 0.6 + 0.2 * d.z), 0.0, 1.0)
        b = d.dot(eye - ball)
        root = b * b - (eye - ball).dot(eye - ball) + RADIUS * RADIUS
        if root > 0 and -b - ti.sqrt(root) > 0:
            n = (eye + (-b - ti.sqrt(root)) * d - ball) / RADIUS
            colour = (0.4 + 0.6 * ti.max(n.dot((light - ball).normalized()), 0.0)) * vec3(RED)
        r, g, a = ti.cast(colour.x, ti.u32), ti.cast(colour.y, ti.u32), ti.cast(colour.z, ti.u32)
        picture[view * height + i, j] = r | (g << ti.u32(8)) | (a << ti.u32(16)) | ti.u32(4278190080)


class BallWorld(WorldView):
    """A ball that hangs still, follows a hand, and flies on when thrown; without a picture."""

    def __init__(self, scene: Scene):
        self.scene, self.light, self.timings = scene, scene.light, Timings()
        self.editable, self.steps = True, 0
        self.reset()

    def reset(self) -> None:
        self.ball, self.velocity, self.offset = np.zeros(3), np.zeros(3), None  # from the hand that holds it
        self.stuff = MATERIALS["silicone"], "silicone"
        self.scene.game.reset()

    def material(self, body: int):
        return self.stuff

    def apply(self, commands) -> None:
        for command in cmd.in_order(commands):
            match command:
                case cmd.Reset():
                    self.reset()
                case cmd.SetLight(light):
                    self.light = light
                case cmd.SetInteraction(mode):
                    self.interaction = mode
                case cmd.Select(body):
                    self.selected = body
                case cmd.Place(_, offset):
                    self.ball, self.velocity = self.ball + offset, np.zeros(3)
                case cmd.SetMaterial(_, material):
                    self.stuff = material, "silicone, changed"
                case cmd.Pause(on):
                    self.paused = on

    def move(self, frame) -> None:
        self.steps += 1
        grip = next((hand for hand in frame.hands if hand.grip), None)
        if grip is None:
            self.offset = None
        elif self.offset is None and np.linalg.norm(grip.position - self.ball) <= RADIUS + grip.reach:
            self.offset = self.ball - grip.position
        if self.offset is not None:
            goal = grip.position + self.offset
            self.velocity = (goal - self.ball) / max(frame.dt, 1e-6)
            self.ball = goal
        else:
            self.ball = self.ball + self.velocity * frame.dt
        self.moving = bool(np.any(self.velocity))
        self.scene.game.update(frame.time, self.bodies())

    def pick(self, origin, direction):
        b = direction @ (origin - self.ball)
        root = b * b - (origin - self.ball) @ (origin - self.ball) + RADIUS**2
        return (-b - np.sqrt(root), 0) if root > 0 and -b - np.sqrt(root) > 0 else None

    def bodies(self) -> list[BodyState]:
        low, high = self.ball - RADIUS, self.ball + RADIUS
        up = np.array([0.0, 1.0, 0.0])
        return [BodyState("ball", self.ball, self.velocity, low, high, up, self.offset is not None)]

    @property
    def score(self) -> int:
        return self.scene.game.score

    @property
    def message(self) -> str:
        return self.scene.game.message

    def stats(self) -> dict:
        counts = {"gaussians": 1_234_567, "vertices": 2000, "tets": 8123, "substeps": 17, "dt": 1e-3}
        return {**counts, "score": self.score, "finite": bool(np.isfinite(self.ball).all())}


class FakeWorld(BallWorld):
    """The ball's world with its picture."""

    def __init__(self, scene: Scene, *, width: int, height: int, views: int = 1, hands=lambda time: []):
        super().__init__(scene)
        self.views, self.scripted_hands = views, hands
        self.resize(width, height)

    def resize(self, width: int, height: int) -> None:
        self.picture = ti.ndarray(ti.u32, (self.views * height, width))
        self.picture_size, self._drawn = (width, height), None

    def step(self, frame) -> None:
        self.apply(frame.commands)
        if not self.paused or cmd.last_of(cmd.SingleStep, frame.commands):
            with self.timings.stage("simulate"):
                self.move(frame)
        self.draw(frame.cameras() if callable(frame.cameras) else frame.cameras)

    def draw(self, cameras) -> None:
        self.cameras, height = cameras, self.picture_size[1]
        seen = [(c.world_to_camera.tobytes(), c.fx, *self.ball, *self.light.position) for c in self.cameras]
        if seen == self._drawn:
            return
        self._drawn, self.pictures = seen, self.pictures + 1
        with self.timings.stage("render"):
            for view, camera in enumerate(self.cameras):
                assert (camera.width, camera.height) == self.picture_size
                axes = [vec3(*row) for row in camera.world_to_camera[:3, :3]]
                eye, ball, light = vec3(*camera.position), vec3(*self.ball), vec3(*self.light.position)
                paint(self.picture, view, height, eye, *axes, camera.fx, camera.fy, ball, light)


def main() -> None:
    """Open the window, or the headset, and log its frames."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log")
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540))
    parser.add_argument("--frames", type=int, default=10**9)
    parser.add_argument("--xr", action="store_true")
    parser.add_argument("--web", action="store_true")
    parser.add_argument("--coarse", action="store_true", help="from the first motion on draw with the fewest pixels")
    args = parser.parse_args()
    if args.coarse:
        WindowResolution.FRAME_TIME, WindowResolution.STILL_AFTER, DynamicResolution.MIN_DRAWING = 1e-6, np.inf, 0.0

    ti.init(arch=ti.cpu, log_level=ti.WARN, **COMPILER_OPTIONS)
    scene = fake_scene()
    log_file = open(args.log, "w", encoding="utf-8", buffering=1)  # noqa: SIM115
    with open_display(scene, args) as display, Keeper("ball") as keeper, log_file as log:
        world = FakeWorld(scene, width=display.size[0], height=display.size[1], views=1 + args.xr)
        world.timings.budget = 1e-3  # [s] which every frame of a window misses
        for frame in display.frames(world):
            begin = time.perf_counter()
            world.step(frame)
            display.present(world)
            keeper.after(frame, world)
            log.write(json.dumps(record(frame, world)) + "\n")
            if world.steps >= args.frames:
                break
            time.sleep(max(0.0, PERIOD - (time.perf_counter() - begin)))
    web = {"web": display.stats()} if args.web else {}
    print(json.dumps({"fps": world.timings.fps, **world.timings.as_dict(), **web}))


def open_display(scene: Scene, args):
    if args.xr:
        from display.xr.headset import Headset

        return Headset(scene, title="Ball")
    if args.web:
        from display.web.browser import Browser

        return Browser(scene, title="Ball")
    from display.window.window import Window

    return Window(scene, title="Ball", size=tuple(args.size))


def record(frame, world) -> dict:
    """One frame for the log."""
    hand = frame.hands[0] if frame.hands else None
    camera = world.cameras[0] if world.cameras else None
    return {
        "dt": frame.dt,
        "eye": camera and camera.position.tolist(),
        "forward": camera and camera.world_to_camera[2, :3].tolist(),
        "size": world.picture_size,
        "hand": list(hand.position) if hand else None,
        "grip": hand is not None and hand.grip,
        "ball": world.ball.tolist(),
        "speed": float(np.linalg.norm(world.velocity)),
        "held": world.offset is not None,
        "commands": {c.key or type(c).__name__: vars(c).get("mode", vars(c).get("on", True)) for c in frame.commands},
        "paused": world.paused,
        "interaction": world.interaction,
        "steps": world.steps,
        "missed": world.timings.missed,
        "pictures": world.pictures,
        "light": world.light.position,
        "material": [world.stuff[0].young, world.stuff[1]],
        "selected": world.selected,
    }


if __name__ == "__main__":
    main()
