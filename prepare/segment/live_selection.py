"""Objects of a splat by marks that a user adds and takes back: what belongs to marks that stay is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from prepare.blending_weights import BlendingWeights
from prepare.segment.marks import ViewMarks
from prepare.segment.splat_marks import SplatMarks
from prepare.segment.splat_seeds import Seeds, ViewSeeds, view_seeds
from prepare.segment.splat_segmentation import painted, selected
from prepare.segment.splat_selection import SplatSelection


class LiveSelection:
    """Draws a splat with the objects in colours. Taichi must be running.

    ids  (N,) uint16 of the objects that the Gaussians are selected for, 0: none
    """

    def __init__(self, gaussians: Gaussians):
        self.ids = np.zeros(len(gaussians), np.uint16)
        self._gaussians, self._selection = gaussians, SplatSelection(gaussians)
        self._drawn = BlendingWeights(painted(replace(gaussians, object_id=self.ids), 1))
        self._seeds: dict[tuple, ViewSeeds] = {}

    def select(self, marks: SplatMarks, numbers: Mapping[str, int]) -> dict[str, int]:
        """Select all objects with marks inside, in their order; returns how many Gaussians each has.

        `numbers`, 1, 2, ..., are the ids. Raises BadInput.
        """
        objects = {n: v for n, v in marks.marks.objects.items() if any(m.inside or m.boxes for m in v.values())}
        seeds = [
            Seeds(len(self.ids), [self._of_view(marks.cameras[view], mark) for view, mark in views.items()])
            for views in objects.values()
        ]
        ids = np.zeros_like(self.ids)
        for name, own in zip(objects, seeds, strict=True):
            ids[selected(self._selection, name, own, seeds, ids, marks.grow.get(name, 0))] = numbers[name]
        self.ids = ids
        self._drawn.recolour(painted(replace(self._gaussians, object_id=ids), max(numbers.values())).sh)
        return {name: int((ids == numbers[name]).sum()) for name in objects}

    def _of_view(self, camera: Camera, marks: ViewMarks) -> ViewSeeds:
        """Seeds of an object by its marks in a view."""
        kinds = (tuple(array.tobytes() for array in kind) for kind in (marks.inside, marks.outside, marks.boxes))
        key = (camera.world_to_camera.tobytes(), *kinds)
        if key not in self._seeds:
            self._seeds[key] = view_seeds(self._gaussians, self._drawn, camera, marks)
        return self._seeds[key]

    def picture(self, camera: Camera) -> np.ndarray:
        """Picture (H, W, 3) uint8 RGB."""
        return (self._drawn.picture(camera)[0].clip(0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)

    def destroy(self) -> None:
        """Free the device memory."""
        self._drawn.destroy()
        self._selection.destroy()
