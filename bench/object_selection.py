"""Held-out cases of `vrgs.py segment SPLATS`: shipped things placed in shipped rooms by chance, two strokes each.

    python -m bench.object_selection --cases 12 --seed 5 --sheet cases.png

A thing stands on a level place of a room, turned at random. In a view from above one stroke inside of it and one on
its support are drawn by a rule: the first within its exact mask, the second within those pixels around the mask whose
surface is as high as the thing's foot, because a user strokes what the thing stands on, not the floor that shows
beside the table. A view without such pixels is not marked. The row is the intersection over union of exact and selected
mask in another view, where the thing was not marked, and in brackets that of the Gaussians, hidden ones included.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians, concatenate
from assets.splat_files import read_gaussians
from core.camera import Camera, look_at, perspective
from core.runtime import start_taichi
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.segment.marks import Marks, ViewMarks
from prepare.segment.splat_marks import SplatMarks
from prepare.segment.splat_segmentation import segment_splat
from prepare.segment.view_depths import points_at

DATA = Path(__file__).parents[1] / "assets" / "data"
ROOMS = ("attic", "childrens_room", "dining_room", "study", "garden", "stage")
THINGS = ("toy_cat", "toy_duck", "toy_ladybird", "toy_octopus", "toy_rabbit", "toy_star", "toy_teddy", "box_tin",
          "basket", "ball", "jelly_bear", "brick_red", "bottle", "rubber_ball", "toy_elephant", "toy_frog")  # fmt: skip
PICTURE = (480, 270)  # [px]
AROUND = 1.5  # [m] of the room around the thing that is kept: the rest is far from every stroke
VISIBLE_MIN = 0.6  # of the thing, in both views
REGION = 0.35  # sizes of the thing around its mask in which the stroke outside may lie
LEVEL = 0.06  # radii of the thing by which its support may differ from the height of its foot


@dataclass(frozen=True)
class Case:
    """A thing in a room: pictures, its Gaussians (N,) bool, the pixels (H, W) bool of the view to mark it from where it
    and where its support may be stroked, that view's camera and one to compare in."""

    name: str
    drawn: Drawn
    own: np.ndarray
    thing: np.ndarray
    support: np.ndarray
    marked: Camera
    compared: Camera


class Drawn:
    """Pictures of Gaussians, and masks of some of them. Taichi must be running."""

    def __init__(self, gaussians: Gaussians):
        self.gaussians, self._weights = gaussians, BlendingWeights(gaussians)

    def picture(self, camera: Camera) -> np.ndarray:
        """Picture (H, W, 3) uint8."""
        self._weights.replace(self.gaussians)
        return (self._weights.picture(camera)[0].clip(0, 1) * 255).astype(np.uint8)

    def mask(self, own: np.ndarray, camera: Camera, *, alone: bool = False) -> np.ndarray:
        """Mask (H, W) bool of the pixels that Gaussians (N,) bool fill to more than a half; alone, without others."""
        g = self.gaussians
        sh = np.repeat((own[:, None, None] - 0.5) / C0, 3, axis=2).astype(np.float32)
        opacities = np.where(own, g.logit_opacities, -20.0).astype(np.float32) if alone else g.logit_opacities
        self._weights.replace(replace(g, sh=sh, logit_opacities=opacities))
        return self._weights.picture(camera)[0][..., 0] > 0.5

    def heights(self, camera: Camera) -> np.ndarray:
        """Heights (H, W) [m] of the surfaces in a picture."""
        self._weights.replace(self.gaussians)
        depth = self._weights.picture(camera)[1]
        y, x = np.indices(depth.shape).reshape(2, -1)
        return points_at(camera, depth, x, y)[:, 1].reshape(depth.shape)

    def destroy(self) -> None:
        """Free the device memory."""
        self._weights.destroy()


def level_places(room: Gaussians, radius: float, rng: np.random.Generator):
    """Points (3,) of a room in random order, around which a disc of `radius` [m] is level and free above."""
    tree = cKDTree(room.means)
    solid = np.flatnonzero((room.opacities > 0.5) & (room.means[:, 1] < 1.2))
    for k in rng.permutation(solid):
        p = room.means[k].astype(float)
        near = room.means[tree.query_ball_point(p, 1.3 * radius)]
        flat = near[np.abs(near[:, 1] - p[1]) < LEVEL * radius]
        sides = np.floor(np.arctan2(flat[:, 2] - p[2], flat[:, 0] - p[0]) / (np.pi / 4)).astype(int)
        if len(np.unique(sides)) < 8:
            continue
        above = room.means[tree.query_ball_point(p + (0, 1.4 * radius, 0), 1.35 * radius)]
        if not (above[:, 1] > p[1] + 0.15 * radius).any():
            yield p


def case_of(room_name: str, thing_name: str, rng: np.random.Generator) -> Case | None:
    """A thing placed in a room; None if no place or no two views of it are found."""
    room, thing = (read_gaussians(DATA / f"{n}.h5").with_sh_degree(0) for n in (room_name, thing_name))
    middle = 0.5 * (thing.means.min(axis=0) + thing.means.max(axis=0))
    radius = float(np.linalg.norm(np.ptp(thing.means, axis=0))) / 2
    turn = rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    for tried, place in enumerate(level_places(room, radius, rng)):
        if tried == 12:
            return None
        foot = rotation @ (middle[0], thing.means[:, 1].min(), middle[2])
        stood = thing.transformed(rotation, place - foot)
        close = np.linalg.norm(room.means - place, axis=1) < AROUND
        g = concatenate([room.select(close), stood])
        own, drawn = np.arange(len(g)) >= int(close.sum()), Drawn(g)
        target, views = place + (0, 0.4 * np.ptp(thing.means[:, 1]), 0), []
        start = rng.uniform(0, 2 * np.pi)
        for angle in start + np.radians([0, 100, -100, 140, 60, 180]):
            height = np.radians(rng.uniform(20, 45))
            way = np.array([np.cos(height) * np.sin(angle), np.sin(height), np.cos(height) * np.cos(angle)])
            camera = perspective(*PICTURE, 0.8, look_at(target + 3.4 * radius * way, target))
            alone, mask = drawn.mask(own, camera, alone=True), drawn.mask(own, camera)
            if not (mask & alone).sum() > VISIBLE_MIN * alone.sum() > 0:
                continue
            if not views:
                support = beside(mask) & (np.abs(drawn.heights(camera) - place[1]) < LEVEL * radius)
                if not cv2.erode(support.astype(np.uint8), np.ones((5, 5))).any():
                    continue
                thing_mask = mask
            views.append(camera)
            if len(views) == 2:
                return Case(f"{thing_name} in {room_name}", drawn, own, thing_mask, support, *views)
        drawn.destroy()
    return None


def random_stroke(region: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A straight stroke (2, 2) [px] within a region (H, W) bool, away from its border."""
    distance = cv2.distanceTransform(np.pad(region.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    y, x = np.nonzero(distance >= 0.6 * distance.max())
    k = rng.integers(len(x))
    best = None
    for angle in rng.uniform(0, np.pi, 4):
        way, ends = np.array([np.cos(angle), np.sin(angle)]), []
        for sign in (-1, 1):
            step = 0
            while step < max(region.shape):
                u, v = np.round((x[k], y[k]) + sign * (step + 1) * way).astype(int)
                inside = 0 <= u < region.shape[1] and 0 <= v < region.shape[0]
                if not inside or distance[v, u] < 0.3 * distance.max():
                    break
                step += 1
            ends.append((x[k] + 0.5, y[k] + 0.5) + 0.8 * sign * step * way)
        if best is None or np.linalg.norm(ends[1] - ends[0]) > np.linalg.norm(best[1] - best[0]):
            best = ends
    return np.array(best)


def beside(mask: np.ndarray) -> np.ndarray:
    """Pixels (H, W) bool around a mask, beside and below it, that a user might stroke as what it stands on."""
    y, _ = np.nonzero(mask)
    reach = max(3, round(REGION * np.sqrt(mask.sum())))
    gap = max(2, reach // 5)
    near, far = (cv2.dilate(mask.astype(np.uint8), np.ones((2 * r + 1,) * 2, np.uint8)) > 0 for r in (gap, reach))
    ring = far & ~near
    ring[: int(np.median(y))] = False
    return ring


def marks_of(case: Case, rng: np.random.Generator) -> SplatMarks:
    """A stroke inside of the thing, and one on its support."""
    own = ViewMarks([random_stroke(case.thing, rng)], [random_stroke(case.support, rng)])
    return SplatMarks({"view_1": case.marked}, Marks({"thing": {"view_1": own}}))


def measured(case: Case, rng: np.random.Generator) -> tuple[float, float, float, np.ndarray]:
    """Intersection over union in the other view and of the Gaussians, seconds of processor, and a picture of both views
    (H, W, 3)."""
    marks = marks_of(case, rng)
    start = time.process_time()
    found = segment_splat(case.drawn.gaussians, marks, lambda line: None).gaussians
    seconds = time.process_time() - start
    cut = Drawn(found)
    true, got = case.drawn.mask(case.own, case.compared), cut.mask(found.object_id == 1, case.compared)
    left, right = (case.drawn.picture(camera) for camera in (case.marked, case.compared))
    own = marks.marks.objects["thing"]["view_1"]
    for stroke, colour in ((own.inside[0], (255, 0, 0)), (own.outside[0], (0, 0, 0))):
        cv2.line(left, *np.round(stroke).astype(int).tolist(), colour, 3)
    right[got & ~true], right[true & ~got] = (255, 0, 0), (0, 80, 255)
    for drawn in (cut, case.drawn):
        drawn.destroy()
    selected = found.object_id[: len(case.own)] == 1
    return overlap(true, got), overlap(case.own, selected), seconds, np.hstack([left, right])


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of masks."""
    return float((a & b).sum() / max((a | b).sum(), 1))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--sheet", type=Path, help="pictures: strokes; red: too much, blue: missing")
    args = parser.parse_args()
    start_taichi("cpu")
    rng, rows, sheet = np.random.default_rng(args.seed), [], []
    things = rng.permutation(THINGS)
    tried = 0
    while len(rows) < args.cases:
        case = case_of(ROOMS[tried % len(ROOMS)], str(things[tried % len(things)]), rng)
        tried += 1
        if case is None:
            continue
        iou, whole, seconds, picture = measured(case, rng)
        rows.append(iou)
        sheet.append(picture)
        print(
            f"{case.name:<32} {len(case.own):>8,} Gaussians  IoU {iou:.3f} ({whole:.3f})  {seconds:5.1f} s", flush=True
        )
        if args.sheet is not None:
            cv2.imwrite(str(args.sheet), np.vstack(sheet)[..., ::-1])
    good = sum(iou >= 0.9 for iou in rows)
    print(f"mean {np.mean(rows):.3f}, worst {min(rows):.3f}, at least 0.9: {good} of {len(rows)}")


if __name__ == "__main__":
    main()
