"""Masks of marked objects in all views of a capture: marks spread through its geometry, borders follow colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from core.errors import BadInput
from core.program import in_threads
from prepare.progress import Progress, no_progress
from prepare.segment.marks import Marks, drawn_boxes, drawn_strokes
from prepare.segment.mask_files import Masks, object_colors
from prepare.segment.surface_cloud import (
    POINTS,
    SurfaceCloud,
    depths_of_points,
    depths_of_splats,
    planes_behind,
    silhouettes,
    spread,
    surface_cloud,
)
from prepare.train.capture import Capture
from prepare.train.photographs import Photograph, image_size

MARGIN = 0.3  # object sizes around an object from which the background's colours are learned
SURE = 0.2  # a pixel is disputed if its second label is at least this probable
ROUNDS = 3  # iterations of GrabCut
PIXELS_MIN = 6  # a smaller object is not refined

# (picture (H, W, 3) uint8, likely (H, W) 0..1, sure inside (H, W) bool, sure outside (H, W) bool) -> inside (H, W) bool
Cut = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
STEPS = ("depths", "surface", "masks", "votes")
STROKE_WIDTH = 0.008  # fraction of a picture's diagonal
SURROUNDINGS = 0.4  # radius of the ball around the marks that is processed, relative to the cameras' distance from them
RIM = 0.93  # fraction of that radius beyond which everything is background
REACH = 2.5  # spacings of the cloud: a pixel takes the labels of points within this distance
BAND = 0.010  # fraction of a picture's diagonal: half the width of the band along a border in which colour decides
DENSER = 4  # points of the cloud per sparse point, interpolated between them
COARSE_BAND = 2  # factor on BAND where depth comes from sparse points only
GAP = 1.08  # ratio of depths under a stroke that separates two surfaces
DEPTH_TOLERANCE = 0.02  # relative: a point this near to the depth map is visible
VOTERS, VOTE_REACH = 10, 0.02  # nearest views that vote, and how far around their masks [diagonals]


def grab_cut(picture: np.ndarray, likely: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Cut out an object (H, W) bool by GrabCut (Rother et al. 2004): sure pixels stay, colours decide on the others."""
    mask = np.where(likely > 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    mask[inside], mask[outside] = cv2.GC_FGD, cv2.GC_BGD
    there = [(mask == a) | (mask == b) for a, b in ((cv2.GC_FGD, cv2.GC_PR_FGD), (cv2.GC_BGD, cv2.GC_PR_BGD))]
    if min(t.sum() for t in there) < PIXELS_MIN:
        return there[0]
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(np.ascontiguousarray(picture[..., ::-1]), mask, None, *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    return (mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)


def border_band(labels: np.ndarray, width: int) -> np.ndarray:
    """Mask (H, W) bool of the pixels within `width` of a border between labels (H, W) uint8."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1,) * 2)
    return cv2.dilate(labels, kernel) != cv2.erode(labels, kernel)


def cut_objects(picture: np.ndarray, likely: np.ndarray, unsure: np.ndarray, reach: int, cut: Cut) -> np.ndarray:
    """Ids (H, W) uint8 of objects in a picture.

    likely  probability (H, W, K + 1) of the background and each object
    unsure  (H, W) bool, pixels in which the colours decide
    reach   [px] by which an object may grow, except in disputed pixels
    """
    first = likely.argmax(axis=2)
    found = np.zeros(likely.shape, np.float32)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    for k in range(1, likely.shape[2]):
        own = (first == k).astype(np.uint8)
        if own.sum() < PIXELS_MIN:
            continue
        x, y, w, h = cv2.boundingRect(own)
        pad = 2 * reach + int(MARGIN * max(w, h))
        at = np.s_[max(y - pad, 0) : y + h + pad, max(x - pad, 0) : x + w + pad]
        near = unsure[at] & ((cv2.dilate(own[at], kernel) > 0) | (likely[at][..., k] > SURE))
        own = own[at] > 0
        core = own & ~near
        if not core.any():
            core = likely[at][..., k] > 0.9 * likely[at][..., k].max()
        inside = cut(picture[at], likely[at][..., k], core, ~own & ~near)
        found[at][..., k] = np.where(inside, 0.5 + likely[at][..., k], 0.0)
    return np.where(found.max(axis=2) > 0, found.argmax(axis=2), 0).astype(np.uint8)


class MarkPropagation:
    """Geometry of a capture, over which marks spread.

    photographs  undistorted, of the capture's views in their order, perhaps reduced
    depths       of their pixels (H, W) along the camera's axis, 0: unknown; see `view_depths`
    coarse       the depths come from sparse points
    cut          refines borders in a picture
    points       approximate number that samples the surfaces
    """

    def __init__(
        self,
        capture: Capture,
        photographs: Sequence[Photograph],
        depths: Sequence[np.ndarray],
        *,
        coarse: bool = False,
        cut: Cut = grab_cut,
        points: int = POINTS,
    ):
        self.capture, self.photographs, self.coarse, self.cut = capture, photographs, coarse, cut
        self.wanted = min(points, DENSER * len(capture.points)) if coarse else points
        self.cameras: list[Camera] = [p.camera for p in photographs]
        self.depths = [np.where(p.mask, d, 0.0).astype(np.float32) for p, d in zip(photographs, depths, strict=True)]
        self.names: list[str] = []
        self.cloud: SurfaceCloud | None = None
        self.labels = np.zeros((0, 1))
        self._forbidden: dict[int, dict[int, np.ndarray]] = {}
        self._strokes: dict[int, list[tuple[int, np.ndarray]]] = {}

    def mark(self, marks: Marks, report: Progress = no_progress) -> None:
        """Spread marks over the surfaces. Raises BadInput if an object's marks lie where nothing is known."""
        self.names = list(marks.objects)
        self._read(marks)
        places = self._marked_points()
        everything = np.concatenate(list(places.values()))
        low, high = everything.min(axis=0), everything.max(axis=0)
        centre = 0.5 * (low + high)
        far = np.median([np.linalg.norm(c.position - centre) for c in self.cameras])
        radius = 0.5 * float(np.linalg.norm(high - low)) + SURROUNDINGS * float(far)
        report("surface", 0.0)
        pictures = [p.pixels for p in self.photographs]
        self.cloud = cloud = surface_cloud(self.cameras, self.depths, pictures, centre, radius, self.wanted)
        if cloud is None:
            raise BadInput("the views show no surface where the marks are")
        seeds = np.full(len(cloud.points), -1)
        seeds[np.linalg.norm(cloud.points - centre, axis=1) > RIM * radius] = 0
        behind = planes_behind(cloud, everything, np.random.default_rng(0))
        seeds[behind] = 0
        for k, strokes in self._strokes.items():
            for mask in (mask for label, mask in strokes if label == 0):
                y, x = np.nonzero(mask & (self.depths[k] > 0))
                seeds[self._nearest(self.cameras[k].points_at(self.depths[k], x, y))] = 0
        for label, points in enumerate(places.values(), 1):
            seeds[self._nearest(points)] = label
        report("surface", 0.5)
        self.labels = spread(cloud, seeds, len(self.names) + 1, behind)
        self._apply_boxes()
        report("surface", 1.0)

    def ids_of(self, k: int) -> np.ndarray:
        """Ids (H, W) uint8 of the objects in the undistorted photograph of view `k`, by the surfaces alone."""
        likely = self._with_strokes(k, self._likely(k))
        band = self._pixels(BAND) * (COARSE_BAND if self.coarse else 1)
        unsure = border_band(likely.argmax(axis=2).astype(np.uint8), band) | silhouettes(self.depths[k])
        return self._cut(k, likely, unsure | _disputed(likely), band)

    def _pixels(self, part: float) -> int:
        """A part of a picture's diagonal [px]."""
        return max(2, round(part * float(np.hypot(*self.depths[0].shape))))

    def _with_strokes(self, k: int, likely: np.ndarray) -> np.ndarray:
        """Probabilities (H, W, K + 1), set to 1 under strokes in view `k`."""
        for label, strokes in self._strokes.get(k, ()):
            likely[strokes] = 0.0
            likely[strokes, label] = 1.0
        return likely

    def _cut(self, k: int, likely: np.ndarray, unsure: np.ndarray, reach: int) -> np.ndarray:
        """Ids (H, W) uint8 in view `k`, of the labels' probabilities (H, W, K + 1), its colours and its marks."""
        photograph = self.photographs[k]
        ids = cut_objects(photograph.pixels, likely, unsure, reach, self.cut)
        for label, strokes in self._strokes.get(k, ()):
            ids[strokes] = label
        for label, outside in self._forbidden.get(k, {}).items():
            ids[outside & (ids == label)] = 0
        ids[~photograph.mask] = 0
        return ids

    def voted(self, k: int, ids: Sequence[np.ndarray]) -> np.ndarray:
        """Probability (H, W, K + 1) of the labels in view `k` by a vote of its mask and those of its neighbours."""
        depth, own, camera = self.depths[k], ids[k], self.cameras[k]
        labels = len(self.names) + 1
        side = 2 * round(VOTE_REACH * float(np.hypot(*depth.shape))) + 1
        around = cv2.dilate((own > 0).astype(np.uint8), np.ones((side, side), np.uint8)) > 0
        y, x = np.nonzero(around & (depth > 0))
        points = camera.points_at(depth, x, y)
        votes = np.eye(labels)[own[y, x]]
        away = [np.linalg.norm(c.position - camera.position) for c in self.cameras]
        for j in np.argsort(away)[1 : VOTERS + 1]:
            seen, row, column = self._visible(j, points)
            votes[seen, ids[j][row, column]] += 1.0
        likely = np.eye(labels)[own]
        likely[y, x] = votes / votes.sum(axis=1, keepdims=True)
        return likely

    def _visible(self, k: int, points: np.ndarray, slack: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices of the points (N, 3) that view `k` shows, and the rows and columns of its pixels there."""
        x, y, z = self.cameras[k].projected(points)
        height, width = self.depths[k].shape
        there = np.flatnonzero((z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height))
        row, column = y[there].astype(int), x[there].astype(int)
        seen = np.abs(self.depths[k][row, column] - z[there]) < DEPTH_TOLERANCE * z[there] + slack
        return there[seen], row[seen], column[seen]

    def masks(self, report: Progress = no_progress) -> Masks:
        """The masks of all views, in the photographs' own size and lens. Raises BadInput if an object is in none."""
        ids = self._of_all_views(self.ids_of, "masks", report)
        found = self._of_all_views(lambda k: self._as_taken(k, self._agreed(k, ids)), "votes", report)
        masks = Masks(self.names, object_colors(len(self.names)), found)
        for name in self.names:
            if not masks.pixels(name):
                raise BadInput(f"{name!r}: found in no view; mark it with longer strokes, or in another view")
        return masks

    def _of_all_views(self, made: Callable[[int], np.ndarray], step: str, report: Progress) -> list[np.ndarray]:
        """Ids of the objects in all views, made on all cores."""
        views, done = range(len(self.cameras)), []

        def make(k: int) -> np.ndarray:
            ids = made(k)
            done.append(k)
            report(step, len(done) / len(views))
            return ids

        return in_threads(make, views)

    def _agreed(self, k: int, ids: Sequence[np.ndarray]) -> np.ndarray:
        """Ids (H, W) uint8 in the undistorted photograph of view `k`, of all views' masks."""
        likely = self._with_strokes(k, self.voted(k, ids))
        unsure, band = _disputed(likely), self._pixels(BAND)
        if self.coarse:  # the views may agree on what is wrong
            unsure |= border_band(likely.argmax(axis=2).astype(np.uint8), band)
        return self._cut(k, likely, unsure, band)

    def _read(self, marks: Marks) -> None:
        """Strokes of each view as masks in its undistorted picture, and what lies outside of boxes."""
        self._strokes, self._forbidden = {}, {}
        for k, view in enumerate(self.capture.views):
            shape = self.depths[k].shape
            width = max(1, round(STROKE_WIDTH * np.hypot(*shape)))
            for name, own in marks.in_view(view.name).items():
                label = self.names.index(name) + 1
                for which, strokes in ((0, own.outside), (label, own.inside)):
                    if strokes:
                        drawn = drawn_strokes([self._straight(k, s) for s in strokes], shape, width)
                        self._strokes.setdefault(k, []).append((which, drawn))
                if own.boxes:
                    corners = [self._straight(k, b.reshape(2, 2)).reshape(4) for b in own.boxes]
                    self._forbidden.setdefault(k, {})[label] = ~drawn_boxes(corners, shape)

    def _straight(self, k: int, points: np.ndarray) -> np.ndarray:
        """Places in the undistorted picture of view `k` of places in its photograph."""
        view, camera = self.capture.views[k], self.cameras[k]
        width, height = image_size(view.image)
        lens = view.lens.resized(width, height, str(view.image))
        return lens.undistort_points(points) * (camera.width / width, camera.height / height)

    def _marked_points(self) -> dict[str, np.ndarray]:
        """Points (N, 3) of each object: under its strokes, or where GrabCut finds it in its boxes."""
        places: dict[str, list] = {name: [] for name in self.names}
        for k in range(len(self.cameras)):
            drawn = {label: mask for label, mask in self._strokes.get(k, ()) if label}
            for label, outside in self._forbidden.get(k, {}).items():
                if label not in drawn:
                    drawn[label] = self._cut_in_box(k, ~outside)
            for label, mask in drawn.items():
                y, x = np.nonzero(mask & (self.depths[k] > 0))
                own = _one_surface(self.depths[k][y, x])
                places[self.names[label - 1]].append(self.cameras[k].points_at(self.depths[k], x[own], y[own]))
        found = {name: np.concatenate(p) if p else np.zeros((0, 3)) for name, p in places.items()}
        for name, points in found.items():
            if not len(points):
                raise BadInput(f"{name!r}: its marks lie where the views show no surface")
        return found

    def _cut_in_box(self, k: int, box: np.ndarray) -> np.ndarray:
        """Sure pixels (H, W) bool of an object in a box: GrabCut, away from the border."""
        picture = self.photographs[k].pixels
        inside = grab_cut(picture, box.astype(float), np.zeros_like(box), ~box)
        side = max(1, round(0.1 * np.sqrt(box.sum())))
        core = cv2.erode((inside & box).astype(np.uint8), np.ones((side, side), np.uint8)) > 0
        return core if core.any() else inside & box

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        """Indices of the cloud's points at given points."""
        distance, index = self.cloud.tree.query(points, distance_upper_bound=2 * self.cloud.spacing)
        return np.unique(index[np.isfinite(distance)])

    def _apply_boxes(self) -> None:
        """Remove an object from all surfaces that a view shows outside of its boxes."""
        for k, boxes in self._forbidden.items():
            seen, row, column = self._visible(k, self.cloud.points, self.cloud.spacing)
            for label, outside in boxes.items():
                gone = seen[outside[row, column]]
                self.labels[gone, 0] += self.labels[gone, label]
                self.labels[gone, label] = 0.0

    def _likely(self, k: int) -> np.ndarray:
        """Probability (H, W, K + 1) of the labels at the pixels of a view, interpolated in the cloud."""
        depth, cloud = self.depths[k], self.cloud
        likely = np.zeros((*depth.shape, self.labels.shape[1]))
        likely[..., 0] = 1.0
        y, x = np.nonzero(depth > 0)
        p = self.cameras[k].points_at(depth, x, y)
        low, high = cloud.points.min(axis=0) - cloud.spacing, cloud.points.max(axis=0) + cloud.spacing
        near = np.flatnonzero(((p > low) & (p < high)).all(axis=1))
        distance, index = cloud.tree.query(p[near], k=4, distance_upper_bound=REACH * cloud.spacing)
        weight = np.exp(-((distance / cloud.spacing) ** 2))  # 0 where there is none
        total = weight.sum(axis=1)
        hit = total > 0
        labels = np.concatenate([self.labels, np.zeros((1, self.labels.shape[1]))])
        mixed = np.einsum("nk,nkl->nl", weight[hit], labels[index[hit]]) / total[hit, None]
        likely[y[near[hit]], x[near[hit]]] = mixed
        return likely

    def _as_taken(self, k: int, ids: np.ndarray) -> np.ndarray:
        """Ids of an undistorted picture in the photograph's own size and lens."""
        view = self.capture.views[k]
        width, height = image_size(view.image)
        if ids.shape != (height, width):
            scores = [
                cv2.resize((ids == label).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
                for label in range(len(self.names) + 1)
            ]
            ids = np.argmax(scores, axis=0).astype(np.uint8)
        return view.lens.resized(width, height, str(view.image)).distort_labels(ids)


def _one_surface(depth: np.ndarray) -> np.ndarray:
    """Mask (N,) bool of the largest group of depths (N,) without a gap: a stroke may slip off the object."""
    order = np.argsort(depth)
    group = np.zeros(len(depth), int)
    group[order[1:]] = np.cumsum(depth[order[1:]] > GAP * depth[order[:-1]])
    return group == np.bincount(group, minlength=1).argmax()


def _disputed(likely: np.ndarray) -> np.ndarray:
    """Mask (H, W) bool of pixels that two labels share."""
    return np.sort(likely, axis=2)[..., -2] > SURE


def view_depths(
    capture: Capture, cameras: list[Camera], splats: Gaussians | None, report: Progress = no_progress
) -> list[np.ndarray]:
    """Depths (H, W) of the views: of splats if there are some, else of the capture's points. Raises BadInput."""
    if splats is not None:
        return depths_of_splats(splats, cameras, report)
    if not len(capture.points):
        raise BadInput(f"{capture.folder}: has no points; train it first and give the splat with --splats")
    return depths_of_points(capture.points, cameras, report)


def propagate_marks(
    capture: Capture,
    photographs: Sequence[Photograph],
    marks: Marks,
    splats: Gaussians | None,
    report: Progress = no_progress,
    *,
    cut: Cut = grab_cut,
) -> Masks:
    """Masks of the marked objects in all views; see MarkPropagation. Raises BadInput.

    splats  trained on the capture, in its world (Taichi must be running); None: use the capture's sparse points
    """
    depths = view_depths(capture, [p.camera for p in photographs], splats, report)
    propagation = MarkPropagation(capture, photographs, depths, coarse=splats is None, cut=cut)
    propagation.mark(marks, report)
    return propagation.masks(report)
