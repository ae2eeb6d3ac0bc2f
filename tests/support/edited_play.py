"""Two rings on a floor in a world that tests edit, by hands and commands, frame by frame."""

from numpy.testing import assert_array_equal

from core.camera import look_at, perspective
from core.vocabulary import Body, Hand, Light, Plane
from display.picture import pixels_of
from display.protocol import Frame
from scenes.dining_table import RING_MATERIAL as RUBBER
from scenes.scene import Scene

SIZE = (160, 90)
RED, BLUE = 0, 1
DT = 1 / 60


class Counting:
    """A game that remembers how many bodies it was shown, and where."""

    duration = 1.0

    def __init__(self):
        self.reset()

    def reset(self):
        self.seen, self.score, self.message = [], 0, ""

    def update(self, time, bodies):
        self.seen = [(b.name, b.centroid.copy()) for b in bodies]
        self.score += 1

    def hands(self, time, bodies):
        return []


class Play:
    """A world of two rings on a floor."""

    def __init__(self):
        from display.world import World

        rings = [Body("ring_red", RUBBER, (-0.15, 0.02, 0.0)), Body("ring_blue", RUBBER, (0.15, 0.02, 0.0))]
        light = Light((0.3, 2.0, 0.3))
        scene = Scene(rings, light, (0.0, 0.5, 0.9), (0.0, 0.1, 0.0), [Plane((0, 0, 0), (0, 1, 0))], game=Counting())
        self.camera = perspective(*SIZE, scene.fov_y, look_at(scene.eye, scene.target))
        self.world, self.time = World(scene, width=SIZE[0], height=SIZE[1]), 0.0

    def step(self, frames=1, *given):
        """Frames with these hands; commands among them come in the first."""
        hands, commands = ([g for g in given if isinstance(g, Hand) == k] for k in (True, False))
        for k in range(frames):
            self.time += DT
            self.world.step(Frame(DT, self.time, [self.camera], hands, commands if k == 0 else []))

    def do(self, *commands):
        """Only these commands; no time passes."""
        self.world.editor.begin_frame()
        self.world.apply(commands)
        self.world.paused = True
        self.world.step(Frame(0.0, self.time, [self.camera], []))
        self.world.paused = False

    def motion(self):
        s = self.world.device.solver.snapshot()
        return [s[name] for name in ("x", "x_lo", "v", "v_lo")]

    def picture(self):
        return pixels_of(self.world.picture).copy()

    def shown(self, k):
        """Means of the Gaussians that show body k, as the device has them."""
        run = self.world.device.embedding.spans[k]
        count = self.world.device.gaussian_counts[run.body]
        return self.world.device.splats.mean.to_numpy()[run.gaussian : run.gaussian + count]


def equal(before, after):
    for a, b in zip(before, after, strict=True):
        assert_array_equal(a, b)
