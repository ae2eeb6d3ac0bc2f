"""A training step on the device: render, loss, backpropagation to the parameters, Adam."""

import numpy as np
import taichi as ti

from core.camera import Camera
from prepare.train.image_loss import DSSIM_WEIGHT, ImageLoss
from prepare.train.object_labels import LabelPass
from prepare.train.population import AdamStep, Population
from prepare.train.train_options import BETA1, BETA2
from prepare.train.view_corrections import Exposure
from render.blend_gradients import BlendGradients
from render.projection_gradients import ProjectionGradients
from render.renderer import FloatImages, Renderer

DEPTH_PIXELS = 4  # that one depth stands for, along both axes: a sixteenth of them tells how far a view reaches


@ti.data_oriented
class GradientStep:
    """Renders `population` in pictures of at most (height, width) and updates it from their loss.

    Pictures may change their size without recompilation. The buffers for pairs of tile and Gaussian grow on demand;
    only then are the kernels that read them recompiled.

    exposes    colours are mapped before they are compared with a photograph, see `exposure`
    of_camera  gradients with respect to the camera are computed, too
    cut_out    photographs have opacities: they and the picture are compared over `loss.background`
    """

    def __init__(
        self,
        population: Population,
        height: int,
        width: int,
        *,
        antialias: bool,
        sort: str,
        exposes: bool = False,
        of_camera: bool = False,
        cut_out: bool = False,
    ):
        self.population, self.of_camera = population, of_camera
        how = {"outputs": "float", "antialias": antialias, "sort": sort, "linear": True}
        self.renderer = Renderer(population.splats, width, height, **how)
        self.loss = ImageLoss(height, width, cut_out=cut_out)
        self.labelled = FloatImages(1, height, width) if population.labels is not None else None  # pictures of labels
        self.exposure = Exposure(height, width) if exposes else None
        self._passes: _BackwardPass | None = None

    def destroy(self) -> None:
        """Free the device memory."""
        if self._passes is not None:
            self._passes.destroy()
        if self.labelled is not None:
            self.labelled.destroy()
        self.loss.destroy()
        if self.exposure is not None:
            self.exposure.destroy()
        self.renderer.destroy()

    def draw(self, camera: Camera) -> "_BackwardPass":
        """Render for a camera; returns the backward pass of the picture."""
        if (camera.width, camera.height) != (self.renderer.width, self.renderer.height):
            self.renderer.resize(camera.width, camera.height)
        self.renderer.render([camera])
        bins = self.renderer.rasterizer.tile_pass.bins
        if self._passes is None or self._passes.bins is not bins:
            if self._passes is not None:
                self._passes.destroy()
            self._passes = _BackwardPass(self, bins)
        return self._passes

    def compute(self, photograph: ti.Ndarray, camera: Camera, scale: float, mask=None, mask_scale=0.0) -> None:
        """Render, compare with a photograph, and compute all gradients; scale: 1 / (3 counted pixels).

        mask, mask_scale  `packed_labels` of the photograph and the factor of its loss: labels are compared, too
        """
        rows, passes = (self.population.frozen, self.population.count), self.draw(camera)
        if mask is not None:
            passes.labels.draw()
        passes.compute_blend(photograph, camera.height, camera.width, rows[1], scale, DSSIM_WEIGHT)
        if mask is not None:
            passes.labels.backward(mask, rows[1], camera.height, camera.width, mask_scale)
        passes.compute_projection(*rows)

    def update_labels(self, step: int) -> None:
        """A step of Adam, counted from 1, for the labels with the gradients of the last `compute` with a mask."""
        biases = 1.0 - BETA1**step, 1.0 - BETA2**step
        self._passes.update_labels(self.population.frozen, self.population.count, *biases)

    def update(self, step: AdamStep) -> None:
        """A step of Adam with the gradients of the last `compute`."""
        self._passes.update(self.population.frozen, self.population.count, step)

    def camera_gradient(self) -> np.ndarray:
        """Gradient of the last `compute` with respect to the rows of world_to_camera, (3, 4); waits for the device."""
        return self._passes.gradients.d_camera.to_numpy()

    def compare(self, photograph: ti.Ndarray, camera: Camera) -> np.ndarray:
        """Sums of ImageLoss for a photograph alone, beside colours within 0..1, without exposure."""
        kept = self.loss.sums.to_numpy()
        self.loss.sums.fill(0.0)
        self.draw(camera).compare(photograph, camera.height, camera.width)
        sums = self.take_sums()
        self.loss.sums.from_numpy(kept)
        return sums

    def take_sums(self) -> np.ndarray:
        """Sums of ImageLoss since the last call, (4,)."""
        sums = self.loss.sums.to_numpy().sum(axis=0)
        self.loss.sums.fill(0.0)
        return sums

    def depths(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Depth and opacity of every DEPTH_PIXELS-th pixel along both axes of the picture for a camera, float32."""
        self.draw(camera)
        part = 0, slice(0, camera.height, DEPTH_PIXELS), slice(0, camera.width, DEPTH_PIXELS)
        return self.renderer.depth.to_numpy()[part], self.renderer.alpha.to_numpy()[part]

    def labels(self, camera: Camera) -> np.ndarray:
        """Picture of the labels for a camera, (H, W, 3) float32."""
        self.draw(camera).labels.draw()
        return self.labelled.rgb.to_numpy()[0, : camera.height, : camera.width]

    def weights(self, camera: Camera, mask: ti.Ndarray) -> np.ndarray:
        """Weights of the Gaussians in a picture, summed over the pixels whose object is known, (N,) float64."""
        labels = self.draw(camera).labels
        labels.backward(mask, self.population.count, camera.height, camera.width, 0.0)
        return labels.gradients.sums.to_numpy()[: self.population.count, -1].astype(np.float64)

    def picture(self, camera: Camera) -> np.ndarray:
        """Picture for a camera, (H, W, 3) uint8."""
        self.draw(camera)
        rgb = self.renderer.rgb.to_numpy()[0, : camera.height, : camera.width]
        return (rgb.clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


@ti.data_oriented
class _BackwardPass:
    """The kernels that depend on the bins of a picture."""

    def __init__(self, step: GradientStep, bins):
        self.population, self.bins, self.picture, self.loss = step.population, bins, step.renderer.sink, step.loss
        self.exposure, self.exposes = step.exposure, step.exposure is not None
        background = self.loss.background if self.loss.cut_out else None
        self.blend = BlendGradients(bins, self.picture, with_depth=False, background=background)
        self.gradients = ProjectionGradients(self.blend, of_camera=step.of_camera)
        labels = self.population.labels
        self.labels = LabelPass(labels, self.blend, step.labelled) if labels is not None else None

    def destroy(self) -> None:
        """Free the device memory."""
        if self.labels is not None:
            self.labels.destroy()
        self.gradients.destroy()
        self.blend.destroy()

    @ti.func
    def _compare(self, photograph: ti.template(), height: ti.i32, width: ti.i32, scale: ti.f32, dssim: ti.f32):
        """Write the gradient with respect to the picture, through its exposure; outermost level of a kernel."""
        self._over_background(height, width)
        if ti.static(self.exposes):
            self.exposure.apply(self.picture.rgb, height, width)
            self.loss.backward(self.exposure.rgb, photograph, self.blend.d_rgb, height, width, scale, dssim)
            self.exposure.backward(self.picture.rgb, self.blend.d_rgb, height, width)
        else:
            self.loss.backward(self.picture.rgb, photograph, self.blend.d_rgb, height, width, scale, dssim)

    @ti.func
    def _over_background(self, height: ti.i32, width: ti.i32):
        """Lay the picture over the background; outermost level of a kernel."""
        if ti.static(self.loss.cut_out):
            for y, x in ti.ndrange(height, width):
                self.picture.rgb[0, y, x] += (1.0 - self.picture.alpha[0, y, x]) * self.loss.background[0]

    @ti.kernel
    def compute_blend(
        self, photograph: ti.types.ndarray(ti.u32, 2), height: ti.i32, width: ti.i32, end: ti.i32, scale: ti.f32,
        dssim: ti.f32,
    ):  # fmt: skip
        """Gradients of the splats; labels add theirs before `compute_projection`."""
        self._compare(photograph, height, width, scale, dssim)
        self.blend.clear(0, end)
        self.blend.backward()

    @ti.kernel
    def compute_projection(self, begin: ti.i32, end: ti.i32):
        self.gradients.backward(begin, end)

    @ti.kernel
    def update_labels(self, begin: ti.i32, end: ti.i32, bias1: ti.f32, bias2: ti.f32):
        self.population.labels.update(self.labels.gradients, begin, end, bias1, bias2)

    @ti.kernel
    def compare(self, photograph: ti.types.ndarray(ti.u32, 2), height: ti.i32, width: ti.i32):
        self._over_background(height, width)
        for y, x in ti.ndrange(height, width):
            self.picture.rgb[0, y, x] = ti.math.clamp(self.picture.rgb[0, y, x], 0.0, 1.0)  # as they are shown
        self.loss.backward(self.picture.rgb, photograph, self.blend.d_rgb, height, width, 0.0, 0.0)

    @ti.kernel
    def update(self, begin: ti.i32, end: ti.i32, step: AdamStep):
        self.population.update(self.gradients, begin, end, step)
        self.population.parameters.activate(begin, end)
