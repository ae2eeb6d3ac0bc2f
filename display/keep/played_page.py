"""A play as one page: a file that opens in a browser without a server, and shows the play from all sides.

It holds the Gaussians as they were at first (an SPZ 3), and of each keyframe the vertices of the cages and how much of
the light reaches the Gaussians. played_page.js carries these by the two-level embedding. Bytes: docs/formats.md.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from string import Template

import numpy as np

from assets.file_access import atomic_write
from assets.formats.spz import spz_bytes
from assets.gaussians import Gaussians, concatenate
from display.keep.shown_scene import gaussians_of, moving_bodies
from display.viewed_file import view_around
from display.world import World
from display.xr.hand_joints import JOINT_COUNT
from render.skinned_props import HIDDEN_DISTANCE

FOLDER = Path(__file__).parent
LIGHT_LEVELS = 32  # of a visibility, above 0: a step of the brightest colour is 8 of 255
STEPS = 65535  # of a coordinate, between the least and the greatest of its body in the play
WEIGHT_STEPS = 32767  # of a barycentric weight, below the largest of its body
ASPECT = 16 / 9  # of the page for which the view of a single body is chosen
HAND_FRAME = 0.1 * np.eye(4, 3, -1)  # [m] in a hand's frame: the tet that carries it
LIGHT_TOLERANCE = 0.75  # levels, from which a visibility counts as changed: half a level would flicker


@dataclass(frozen=True)
class Look:
    """An appearance, held by its first track: Gaussians as they are then, and their embedding in its shape then.

    tets, host, weights  as in `EmbeddedBody` (sim/embedding.py)
    """

    gaussians: Gaussians
    tets: np.ndarray
    host: np.ndarray
    weights: np.ndarray


@dataclass
class Track:
    """A body, or a scripted hand, in successive keyframes.

    first     its first keyframe
    count     of its Gaussians
    owner     number of the track whose look it has
    scale     size of the body relative to its source
    look      None if another track has it
    vertices  [m] at each keyframe, (V, 3)
    """

    first: int
    count: int
    owner: int
    scale: float
    look: Look | None
    vertices: list[np.ndarray] = field(default_factory=list)

    def packed(self, owner: Track) -> tuple[dict, list[np.ndarray]]:
        """Its entry in the page's header, and its arrays."""
        x = np.stack(self.vertices)
        low, step = x.min((0, 1)), np.maximum(np.ptp(x, axis=(0, 1)), 1e-6) / STEPS
        fixed = np.round((x - low) / step).astype("<u2")
        change = np.diff(fixed, axis=0, prepend=np.zeros_like(fixed[:1]))  # modulo 2^16
        about = {"first": self.first, "frames": len(x), "vertices": x.shape[1], "count": self.count}
        about |= {"look": self.owner, "scale": self.scale / owner.scale, "low": low.tolist(), "step": step.tolist()}
        arrays = [(change & 255).astype(np.uint8), (change >> 8).astype(np.uint8)]
        if self.look is None:
            return about, arrays
        look = self.look
        unit = max(float(np.abs(look.weights).max(initial=0.0)), 1e-6) / WEIGHT_STEPS
        weights = np.round(look.weights[:, :, :3] / unit).astype("<i2")  # the fourth completes them to 1
        about |= {"tets": len(look.tets), "unit": unit}
        return about, [look.tets.astype("<u4"), look.host.astype("<u4"), weights, *arrays]


def stiff(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tets, hosts and weights of Gaussians that all follow a single tet."""
    return np.array([[0, 1, 2, 3]]), np.zeros((count, 4), int), np.tile(np.eye(4), (count, 1, 1))


class PlayedPage:
    """Gathers keyframes of a running world, then writes the page.

    title    of the page
    body     only this one; None: all, the room, and the scripted player's hands
    shadows  let colours be as dark as they are shown
    """

    def __init__(self, world: World, title: str, *, body: int | None = None, shadows: bool = True):
        self.world, self.title, self.body, self.shadows = world, title, body, shadows
        self._still = world.device.still if body is None else 0  # Gaussians of the room
        self._times: list[float] = []
        self._tracks: list[Track] = []
        self._owners: dict[object, int] = {}  # the track that has the look of a body's source, or of a hand
        self._live: dict[object, tuple[Track, int]] = {}  # with its first slot
        self._members: tuple | None = None
        self._light = np.full(self._still, LIGHT_LEVELS, np.uint8)  # of the slots: the room's, then each track's
        self._changes: list[tuple[np.ndarray, np.ndarray]] = []  # slots and their new levels

    def take(self, time: float) -> None:
        """Add the world as it is now, `time` [s] after the start, as a keyframe."""
        registry = self.world.registry
        if registry.members != self._members:  # indices of bodies mean others from now on
            self._members, self._live = registry.members, {}
        shown = {}  # of each Gaussian span that is shown now: its first slot
        for moving in moving_bodies(self.world, self.body):
            span = registry.gaussian_span(moving.index)
            source, scale = registry.members[moving.index].source, moving.model.shape.factor
            shown[span] = self._follow(moving.index, source, span, moving.x, scale)
        for side, span, pose in self._hands():
            x = HAND_FRAME @ pose[:, :3].T + pose[:, 3]
            shown[span] = self._follow(f"hand {side}", f"hand {side}", span, x, 1.0)
        self._times.append(time)
        self._live = {key: entry for key, entry in self._live.items() if entry[1] in shown.values()}  # a hand may go
        if self.shadows:
            self._take_light({(0, self._still): 0, **shown})

    def _follow(self, key: object, source: object, span: tuple[int, int], x: np.ndarray, scale: float) -> int:
        """Add vertices [m] to the track of a key, or to a new one; returns its first slot."""
        if key not in self._live:
            count, look = span[1] - span[0], None
            if source not in self._owners:
                self._owners[source] = len(self._tracks)
                g = gaussians_of(self.world, [span], shadows=False)()
                part = self.world.device.parts[source] if isinstance(source, int) else None
                look = Look(g, part.tets, part.host, part.weights) if part else Look(g, *stiff(count))
            track = Track(len(self._times), count, self._owners[source], scale, look)
            self._tracks.append(track)
            self._live[key] = track, len(self._light)
            self._light = np.append(self._light, np.full(count, LIGHT_LEVELS, np.uint8))
        track, slot = self._live[key]
        track.vertices.append(np.asarray(x, np.float64))
        return slot

    def _hands(self) -> list[tuple[int, tuple[int, int], np.ndarray]]:
        """Side, Gaussians and pose (3, 4) of each scripted hand that is shown: it is as stiff as its wrist."""
        props, found = self.world.device.props, []
        if props is None or self.body is not None or props.parts > 2 * JOINT_COUNT:
            return found
        side_of = props.part.to_numpy()[:, 0] // JOINT_COUNT
        for side in (0, 1):
            pose = props.placed.reshape(-1, 3, 4)[side * JOINT_COUNT]
            of_side = np.flatnonzero(side_of == side)
            if len(of_side) and np.abs(pose).max() < HIDDEN_DISTANCE:
                first = self.world.device.still + int(of_side[0])
                found.append((side, (first, first + len(of_side)), pose.astype(np.float64)))
        return found

    def _take_light(self, shown: dict[tuple[int, int], int]) -> None:
        """Note the levels that differ from the last keyframe's by more than rounding; `shown`: first slot of spans."""
        visibility, slots, levels = self.world.device.splats.visibility.to_numpy(), [], []
        for (begin, end), slot in shown.items():
            now, before = LIGHT_LEVELS * visibility[begin:end], self._light[slot : slot + end - begin]
            changed = np.flatnonzero(np.abs(now - before) > LIGHT_TOLERANCE)
            before[changed] = np.round(now[changed])
            slots.append(slot + changed)
            levels.append(before[changed])
        self._changes.append((np.concatenate(slots), np.concatenate(levels)))

    def write(self, path: Path) -> None:
        """Write the page. Raises BadInput."""
        self.writer(path)()

    def writer(self, path: Path) -> Callable[[], None]:
        """Read the room, as it is now: the user may have turned it; returns what writes the page. Raises BadInput."""
        room = None
        if self._still or not self._tracks:
            room = gaussians_of(self.world, [(0, self._still)], shadows=False)
        return lambda: self._write(path, [room()] if room else [])

    def _write(self, path: Path, room: list[Gaussians]) -> None:
        gaussians = concatenate(room + [track.look.gaussians for track in self._tracks if track.look])
        scene, eye, target = self.world.scene, self.world.scene.eye, self.world.scene.target
        if self.body is not None:
            eye, target = view_around(gaussians, ASPECT)
        tracks, arrays = [], []
        for track in self._tracks:
            about, own = track.packed(self._tracks[track.owner])
            tracks.append(about)
            arrays += own
        for slots, levels in self._changes:
            mask, order = np.zeros(len(self._light), bool), np.argsort(slots)
            mask[slots] = True
            arrays += [np.packbits(mask), np.round(levels[order] * (255 / LIGHT_LEVELS)).astype(np.uint8)]
        header = {
            "times": np.round(np.subtract(self._times, self._times[0]), 4).tolist(),
            "eye": list(map(float, eye)),
            "target": list(map(float, target)),
            "fov_y": scene.fov_y,
            "background": list(scene.background),
            "antialias": bool(self.world.device.renderer.rasterizer.projection.antialias),
            "still": self._still,
            "tracks": tracks,
            "changes": [len(slots) for slots, _ in self._changes],
        }
        text = json.dumps(header, allow_nan=False).encode()
        motion = b"".join([len(text).to_bytes(4, "little"), text, *(array.tobytes() for array in arrays)])
        script = FOLDER.joinpath("played_page.js").read_text(encoding="utf-8")
        page = Template(FOLDER.joinpath("played_page.html").read_text(encoding="utf-8")).substitute(
            title=escape(self.title),
            script=script,
            hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
            scene=base64.b64encode(spz_bytes(path, gaussians)).decode(),
            motion=base64.b64encode(gzip.compress(motion, 9, mtime=0)).decode(),
        )
        with atomic_write(path) as beside:
            beside.write_bytes(page.encode())
