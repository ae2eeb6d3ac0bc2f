"""A splat file that is viewed: read, turned upright, cropped by a box, written; and cameras that show all of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians
from assets.orientation import alternatives, rotation_to_up, up_probabilities
from assets.splat_files import kind_to_write, read_gaussians, write_gaussians
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.morton import morton_order
from scenes.scene import Scene

UP_AXES = ("+y", "-y", "+z", "-z", "+x", "-x")  # in the order in which they are tried
FOV_Y = 0.9  # [rad]
FAINT_OPACITY = 0.02  # of the most opaque Gaussian; fainter ones do not count for the size
ELEVATION = np.radians(15.0)  # [rad] of the first view
DISTANCE_MARGIN = 1.08  # of the distance at which a ball around the splats fills the picture
BACKGROUND = (0.12, 0.13, 0.14)
FINE = 1e-4  # of a side of the crop: ends that lie so near to the sides cut nothing


@dataclass(frozen=True)
class Box:
    """An axis-aligned box: its lower and upper corner [m], (3,)."""

    low: np.ndarray
    high: np.ndarray

    def holds(self, points: np.ndarray) -> np.ndarray:
        """True for the points (N, 3) within it, (N,)."""
        return ((points >= self.low) & (points <= self.high)).all(axis=1)

    def edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Its twelve edges, start and end [m]."""
        corners = np.where(np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool), self.high, self.low)
        pairs = [(k, k | bit) for k in range(8) for bit in (1, 2, 4) if not k & bit]
        return [(corners[a], corners[b]) for a, b in pairs]


@dataclass(frozen=True)
class ViewedFile:
    """A file's Gaussians as they are shown: `up` is the file's axis that now points to +y, `note` how it was found.

    chances the probability of each axis that may point up, from the guess; {}: the user has said
    turn, factor   rotation (3, 3) and scale since the file was read or kept
    crop    what lies outside is left out; None: nothing is
    """

    path: Path
    gaussians: Gaussians
    up: str
    note: str
    crop: Box | None = None
    chances: dict[str, float] = field(default_factory=dict)
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    factor: float = 1.0

    @classmethod
    def read(cls, path: str | Path, up: str | None) -> ViewedFile:
        """Read a file and turn it so that its axis `up` is +y. Raises BadInput.

        None: the most probable axis is guessed, but +y is up in a prepared asset, a .glb and what was trained.
        """
        gaussians, chances = read_gaussians(path), {}
        if up is None and not str(path).lower().endswith((".h5", ".glb")) and not gaussians.view:
            chances = up_probabilities(gaussians)
        up = max(chances, key=chances.get) if chances else up or "+y"
        note = f"{up} is up"
        if chances:
            others = ", ".join(f"{other} {chances[other]:.0%}" for other in alternatives(chances)[1:])
            note += f" (guessed, {chances[up]:.0%} sure{f'; else {others}' if others else ''}; --up overrides)"
        turn = rotation_to_up(up)
        if up != "+y":
            gaussians = gaussians.transformed(turn, (0.0, 0.0, 0.0), 1.0)
        gaussians = gaussians.select(morton_order(gaussians.means))
        return cls(Path(path), gaussians, up, note, chances=chances, turn=turn)

    @cached_property
    def bounds(self) -> Box:
        """The box of all means."""
        means = self.gaussians.means
        return Box(means.min(0).astype(np.float64), means.max(0).astype(np.float64))

    @property
    def size(self) -> float:
        """Largest extent [m]."""
        return float((self.bounds.high - self.bounds.low).max())

    @property
    def shown(self) -> np.ndarray:
        """True for the Gaussians within the crop, (N,)."""
        everything = np.ones(len(self.gaussians), bool)
        return everything if self.crop is None else self.crop.holds(self.gaussians.means)

    def turned(self, up: str = "") -> ViewedFile:
        """An axis of the file points up, "": the next one, the most probable first. Raises BadInput."""
        if not up:
            order = sorted(UP_AXES, key=lambda axis: -self.chances.get(axis, 0.0))
            up = order[(order.index(self.up) + 1) % len(order)]
        found = self.changed(rotation_to_up(up) @ rotation_to_up(self.up).T)
        return replace(found, up=up, note=f"{up} is up")

    def changed(self, rotation: np.ndarray, factor: float = 1.0) -> ViewedFile:
        """Turned and scaled about the middle of its bounds; nothing is cropped."""
        middle = 0.5 * (self.bounds.low + self.bounds.high)
        gaussians = self.gaussians.transformed(rotation, middle - factor * rotation @ middle, factor)
        return replace(self, gaussians=gaussians, crop=None, turn=rotation @ self.turn, factor=factor * self.factor)

    def kept(self, turn: np.ndarray, factor: float) -> ViewedFile:
        """The same after the file has been turned and scaled by that much."""
        return replace(self, turn=self.turn @ turn.T, factor=self.factor / factor)

    def cropped(self, low, high) -> ViewedFile:
        """Only what lies between these corners [m] is shown; corners at the bounds' crop nothing."""
        slack = FINE * (self.bounds.high - self.bounds.low)
        whole = (low <= self.bounds.low + slack).all() and (high >= self.bounds.high - slack).all()
        return replace(self, crop=None if whole else Box(np.asarray(low, float), np.asarray(high, float)))

    def write(self, out: Path) -> int:
        """Write what is shown, as it stands, +y up; returns the number of Gaussians. Raises BadInput."""
        kind_to_write(out)
        kept = self.gaussians.select(np.flatnonzero(self.shown))
        if not len(kept):
            raise BadInput("nothing is left to write: the crop holds no Gaussians")
        write_gaussians(out, kept)
        return len(kept)

    @cached_property
    def facts(self) -> list[tuple[str, str]]:
        """Its statistics: (name, value)."""
        g, size = self.gaussians, self.bounds.high - self.bounds.low
        widths = np.exp(np.median(g.log_scales, axis=0).max())
        facts = [
            ("Gaussians", f"{len(g):,}"),
            ("harmonics", f"degree {g.sh_degree}"),
            ("file", f"{self.path.stat().st_size / 1e6:.1f} MB" if self.path.is_file() else "gone"),
            ("extents", " x ".join(f"{s:.3g}" for s in size) + " m"),
            ("width, median", f"{1000 * widths:.2g} mm"),
            ("faint ones", f"{np.mean(g.opacities < 0.1):.0%}"),
            ("up", self.up + (", guessed" if "guessed" in self.note else "")),
        ]
        if self.crop is not None:
            facts.insert(1, ("within the crop", f"{int(self.shown.sum()):,}"))
        return facts


# Views to start from


def middle_and_radius(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Middle (3,) and radius [m] of the Gaussians, without the outermost hundredth on each side."""
    seen = gaussians.opacities > FAINT_OPACITY * gaussians.opacities.max(initial=0.0)
    points = gaussians.means[seen].astype(np.float64)
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    middle = 0.5 * (low + high)
    largest = float(np.exp(gaussians.log_scales[seen].astype(np.float64)).max(initial=1e-6))
    radius = float(np.percentile(np.linalg.norm(points - middle, axis=1), 98.0))
    return middle, radius if radius > 0.0 else 3.0 * largest


def view_around(
    gaussians: Gaussians, aspect: float, yaw: float = 0.0, elevation: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target (3,) [m] that show all Gaussians, from `yaw` right of and `elevation` above them [rad].

    Those from photographs are seen from where they were photographed, and orbit what was looked at.
    """
    if gaussians.view:
        eye, middle = np.reshape(gaussians.view[:6], (2, 3))
        x, y, z = eye - middle
        away, yaw = np.linalg.norm(eye - middle), yaw + np.arctan2(x, z)
        elevation = np.arcsin(y / away) if elevation is None else elevation
        return middle + away * _direction(yaw, elevation), middle
    middle, radius = middle_and_radius(gaussians)
    narrow = np.arctan(np.tan(0.5 * FOV_Y) * min(aspect, 1.0))
    direction = _direction(yaw, ELEVATION if elevation is None else elevation)
    return middle + DISTANCE_MARGIN * radius / np.sin(narrow) * direction, middle


def _direction(yaw: float, elevation: float) -> np.ndarray:
    return np.array([np.sin(yaw) * np.cos(elevation), np.sin(elevation), np.cos(yaw) * np.cos(elevation)])


def camera_around(
    gaussians: Gaussians, width: int, height: int, yaw: float, *, elevation: float | None = None
) -> Camera:
    """A camera that shows all Gaussians from `yaw` [rad]."""
    return perspective(width, height, FOV_Y, look_at(*view_around(gaussians, width / height, yaw, elevation)))


def film_yaws(gaussians: Gaussians, count: int) -> np.ndarray:
    """Yaw [rad] of each picture of a film that can be repeated, (count,): one turn, or as far as cameras have been."""
    turns = 2 * np.pi * np.arange(count) / count
    return gaussians.view[6] * np.sin(turns) if gaussians.view and gaussians.view[6] < np.pi else turns


def scene_around(gaussians: Gaussians, aspect: float) -> Scene:
    """A scene without bodies: only where to look from."""
    eye, target = map(tuple, view_around(gaussians, aspect))
    return Scene(bodies=[], light=None, eye=eye, target=target, fov_y=FOV_Y, background=BACKGROUND)
