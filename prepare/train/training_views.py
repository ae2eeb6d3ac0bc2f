"""The training photographs on the device, at full and reduced size."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import taichi as ti

from core.camera import Camera
from prepare.train.object_labels import packed_labels
from prepare.train.photographs import Photograph, reduced

COARSE = (4, 2)  # divisors of width and height in the coarse stage, each for an equal part of it
SIDE_MIN = 32  # [px] smaller pictures are not reduced: SSIM's window is 11


class Target(NamedTuple):
    """A training view: an image, its camera, the number of pixels that count, and object labels if known.

    mask   `packed_labels`, or None; known: the number of pixels that it counts
    """

    image: ti.Ndarray
    camera: Camera
    counted: int
    mask: ti.Ndarray | None
    known: int


class TrainingViews:
    """Training photographs by view, at the size for the current stage of the training.

    coarse   fraction of the steps that use reduced pictures; 0: none, and no reduced copies are kept
    objects  number of objects in their masks
    """

    def __init__(self, photographs: list[Photograph], coarse: float, objects: int):
        self.cameras, self.coarse = [p.camera for p in photographs], coarse
        side = min(min(c.width, c.height) for c in self.cameras)
        divisors = [d for d in COARSE if side >= d * SIDE_MIN] if coarse > 0.0 else []
        self.levels = [[target(reduced(p, d), objects) for p in photographs] for d in (*divisors, 1)]

    def __len__(self) -> int:
        return len(self.cameras)

    def at(self, view: int, progress: float) -> Target:
        """The target for a view after a fraction `progress` of the steps."""
        stages = len(self.levels) - 1
        k = min(stages, math.floor(stages * progress / self.coarse)) if stages else 0
        found = self.levels[k][view]
        return found._replace(camera=replace(found.camera, world_to_camera=self.cameras[view].world_to_camera))

    def set_pose(self, view: int, world_to_camera: np.ndarray) -> None:
        """Render a view from another pose from now on."""
        self.cameras[view] = replace(self.cameras[view], world_to_camera=world_to_camera)


def target(photograph: Photograph, objects: int) -> Target:
    """A photograph on the device, with labels if it knows its `objects`."""
    ids, mask, known = photograph.objects, None, 0
    if ids is not None and objects > 0:
        counts = photograph.mask & (ids <= objects)
        known = int(counts.sum())
        mask = packed_labels(ids, counts, objects) if known else None
    return Target(packed(photograph), photograph.camera, max(1, int(photograph.mask.sum())), mask, known)


def packed(photograph: Photograph) -> ti.Ndarray:
    """A photograph on the device: u32 R | G<<8 | B<<16 | A<<24, A = 255 where a pixel counts."""
    rgba = np.dstack([photograph.pixels, np.where(photograph.mask, 255, 0).astype(np.uint8)])
    image = ti.ndarray(ti.u32, rgba.shape[:2])
    image.from_numpy(np.ascontiguousarray(rgba).view("<u4")[..., 0])
    return image
