"""A step of training cut into its stages, each of which is waited for."""

from time import perf_counter

import taichi as ti

from prepare.train.image_loss import DSSIM_WEIGHT


@ti.data_oriented
class StagedStep:
    """Steps of a trainer, stage by stage; the sum is longer than a step, which waits for nothing."""

    def __init__(self, trainer):
        self.trainer, self._backward = trainer, None

    def run(self, view: int) -> dict[str, float]:
        """One step from a view; seconds by stage."""
        trainer, step = self.trainer, self.trainer.gradients
        image, camera, counted, _, _ = trainer.views.at(view, 1.0)
        passes = step.draw(camera)  # sets the camera, and makes room for all pairs
        if self._backward is None or self._backward.passes is not passes:
            self._backward = _StagedBackward(passes)
        rasterizer, population = step.renderer.rasterizer, trainer.population
        rows = population.frozen, population.count
        adam = trainer.adam_step(camera, population.splats.coefficients)
        size = camera.height, camera.width
        return _timed(
            {
                "project, sort by depth": lambda: rasterizer._order(0, population.count, 0, True),
                "bin": lambda: rasterizer.tile_pass._bin(),
                "blend": lambda: rasterizer.tile_pass._blend_to_fields(0),
                "loss and its gradient": lambda: self._backward.loss(image, *size, 1.0 / (3 * counted), DSSIM_WEIGHT),
                "backward of blend": lambda: self._backward.blend(population.count),
                "backward of projection": lambda: self._backward.project(*rows),
                "Adam": lambda: step.update(adam),
            }
        )


@ti.data_oriented
class _StagedBackward:
    """The backward pass of a picture as one kernel a stage; without exposure and labels."""

    def __init__(self, passes):
        self.passes = passes

    @ti.kernel
    def loss(
        self, photograph: ti.types.ndarray(ti.u32, 2), height: ti.i32, width: ti.i32, scale: ti.f32, dssim: ti.f32
    ):
        self.passes.loss.backward(
            self.passes.picture.rgb, photograph, self.passes.blend.d_rgb, height, width, scale, dssim
        )

    @ti.kernel
    def blend(self, count: ti.i32):
        self.passes.blend.clear(0, count)
        self.passes.blend.backward()

    @ti.kernel
    def project(self, begin: ti.i32, end: ti.i32):
        self.passes.gradients.backward(begin, end)


def _timed(parts: dict) -> dict[str, float]:
    """Seconds that each part takes until the device is done with it."""
    taken = {}
    ti.sync()
    for name, part in parts.items():
        begin = perf_counter()
        part()
        ti.sync()
        taken[name] = perf_counter() - begin
    return taken
