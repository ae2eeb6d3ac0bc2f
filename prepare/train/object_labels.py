"""Labels, three learned numbers per Gaussian that encode its object, and the segmentation loss."""

import numpy as np
import taichi as ti

from core.fields import FieldGroup
from prepare.train.image_loss import packed, unpacked
from prepare.train.train_options import BETA1, BETA2, EPSILON
from render.blend import Blend
from render.blend_gradients import BlendGradients
from render.per_pixel_sort import PerPixelSort
from render.renderer import FloatImages

SEGMENTATION_WEIGHT = 0.1  # lambda_seg of the paper
LABEL_RATE = 0.02  # of Adam: some 50 steps that see a Gaussian move its label from the background's to an object's
UNKNOWN = 255  # in masks: no object and no background

vec3 = ti.math.vec3


def label_colors(count: int) -> np.ndarray:
    """Labels of the background, black, and of `count` objects, (count + 1, 3) float64 in 0..1, far from each other.

    Each one is the lattice point farthest from all before it. They replace the masks' colours, which may be alike.
    """
    side = 2
    while side**3 <= count:
        side += 1
    lattice = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    chosen, distance = [0], np.full(len(lattice), np.inf)
    for _ in range(count):
        distance = np.minimum(distance, np.linalg.norm(lattice - lattice[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return lattice[chosen]


def nearest_label(labels: np.ndarray, count: int) -> np.ndarray:
    """Object id of the nearest of `label_colors(count)`, (...) uint8, of labels (..., 3)."""
    best, ids = np.full(labels.shape[:-1], np.inf), np.zeros(labels.shape[:-1], np.uint8)
    for k, color in enumerate(label_colors(count)):
        distance = np.square(labels - color).sum(axis=-1)
        ids[distance < best] = k
        best = np.minimum(best, distance)
    return ids


def packed_labels(ids: np.ndarray, counted: np.ndarray, count: int) -> ti.Ndarray:
    """A mask (H, W) uint8 of ids up to `count`, where they count, as an image of labels on the device."""
    levels = np.zeros((UNKNOWN + 1, 3), np.uint8)
    levels[: count + 1] = np.rint(255 * label_colors(count))
    return packed(levels[ids], counted)


@ti.data_oriented
class Labels:
    """Labels of up to `capacity` Gaussians, of shape (capacity,), and the moments of Adam. All begin as background.

    value          vec3; targets are those of `label_colors`
    first, second  moments
    """

    def __init__(self, capacity: int):
        self.fields = f = FieldGroup()
        self.value, self.first, self.second = (f.vector(capacity) for _ in range(3))
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def update(self, gradients: ti.template(), begin: ti.i32, end: ti.i32, bias1: ti.f32, bias2: ti.f32):
        """A step of Adam for rows [begin, end) with BlendGradients by labels; outermost level of a kernel."""
        for g in range(begin, end):
            d = gradients.d_color(g)
            first, second = BETA1 * self.first[g] + (1.0 - BETA1) * d, BETA2 * self.second[g] + (1.0 - BETA2) * d * d
            self.first[g], self.second[g] = first, second
            self.value[g] -= LABEL_RATE * (first / bias1) / (ti.sqrt(second / bias2) + EPSILON)


@ti.data_oriented
class LabelPass:
    """The picture of labels over the bins of a picture, and the gradient of its distance from a mask.

    L_seg = |M - I_seg|, the mean over three numbers and the pixels whose object is known   (VR-GS, Sec. 4.1)

    It is part of the total loss: its gradient with respect to shapes and opacities is added to `blend`'s, so that
    Gaussians end at the borders of objects. Without that, those that straddle a border between similar colours remain.
    """

    def __init__(self, labels: Labels, blend: BlendGradients, images: FloatImages):
        self.labels, self.images = labels, images
        drawer = PerPixelSort if blend.by_pixel else Blend
        self.drawer = drawer(blend.bins, with_color=True, with_depth=False, color=labels.value)
        self.gradients = BlendGradients(blend.bins, images, with_depth=False, color=labels.value, into=blend)

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()

    @ti.kernel
    def draw(self):
        """Draw the labels of the Gaussians that are binned."""
        self.drawer.draw(self.images, 0)

    @ti.kernel
    def backward(self, mask: ti.types.ndarray(ti.u32, 2), count: ti.i32, height: ti.i32, width: ti.i32, scale: ti.f32):
        """Gradients of `scale` times the sum of |M - I_seg|, after `blend.clear`.

        With a scale of 0 those of the sum of I_seg over the pixels that count: by a label that is the sum of weights w.

        mask: `packed_labels` of the picture that was drawn; count: Gaussians whose gradients are set. It stands in no
        kernel with another backward pass: on CUDA both share arrays between threads.
        """
        for y, x in ti.ndrange(height, width):
            truth, alpha = unpacked(mask[y, x])
            d = vec3(0.0)
            if alpha != ti.u32(0):
                d = vec3(1.0)  # without a scale
                if scale > 0.0:
                    d = scale * ti.math.sign(self.images.rgb[0, y, x] - truth)
            self.gradients.d_rgb[y, x] = d
        self.gradients.clear(0, count)
        self.gradients.backward()
