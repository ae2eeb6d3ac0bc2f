"""Pictures of a preparation's report, each (H, W, 3) uint8, all from one camera, drawn without a GPU: painter's
algorithm, flat shading, 2x supersampling."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from assets.asset import Asset
from assets.gaussians import OPAQUE, Gaussians, robust_bounds
from assets.orientation import alternatives, rotation_to_up
from core.camera import Camera, look_at, perspective
from core.tetmesh import boundary_surface, face_components
from prepare.cage.level_set import ComponentSolid

WIDTH, HEIGHT = 560, 480  # [px]
FOV = 0.5  # [rad]
ELEVATION, AZIMUTH = 0.35, 0.6  # [rad] of the camera above the floor, and from +z to +x
FRAME_MARGIN = 1.06  # of the body's half diagonal, shown to each side
MAX_DRAWN_CELLS = 56  # drawn on the longest side; more cannot be told apart
MAX_DOTS = 15_000  # Gaussians in the picture of the enclosure

STRIP_WIDTH, STRIP_HEIGHT, STRIP_FOOT = 240, 220, 34  # [px] of a picture in the strip, and of the line under it

CLAY, BLUE, GREY, RED = (214, 142, 108), (132, 172, 214), (206, 203, 198), (200, 40, 40)
SKIN, FLESH, WIRE = (226, 196, 150), (120, 166, 172), (70, 66, 62)
DEEP, SHALLOW = np.array((44, 84, 140)), np.array((170, 200, 226))


def camera_for(points: np.ndarray, width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """Camera that frames points (N, 3) [m] from the front, slightly from the side and above."""
    low, high = points.min(0), points.max(0)
    middle, half = (low + high) / 2, np.linalg.norm(high - low) / 2
    towards = np.array([np.sin(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION), np.cos(AZIMUTH) * np.cos(ELEVATION)])
    side = min(1.0, width / height)
    eye = middle + towards * FRAME_MARGIN * half / (np.sin(FOV / 2) * side)
    near = perspective(width, height, FOV, look_at(eye, middle))
    # The box's diagonal is a loose bound: come closer until the points fill the picture.
    p = points @ near.world_to_camera[:3, :3].T + near.world_to_camera[:3, 3]
    filled = np.abs(p[:, :2] / p[:, 2:] * near.fx / (0.5 * np.array([width, height]))).max()
    zoom = 0.92 / filled
    return Camera(width, height, near.fx * zoom, near.fy * zoom, near.cx, near.cy, near.world_to_camera)


def splat_picture(asset: Asset, camera: Camera) -> np.ndarray:
    """The Gaussians as the program's renderer draws them. Taichi must be running."""
    from render.renderer import Renderer
    from render.splats import Splats

    background = tuple(c / 255 for c in PAPER)
    renderer = Renderer(
        Splats(asset.gaussians), camera.width, camera.height, background=background, antialias=asset.gaussians.antialias
    )
    renderer.render([camera])
    return renderer.pixels()[0][..., :3].copy()


def strip_name(out: Path) -> Path:
    """Path of the orientation strip of the asset `out`: ASSET.up.png."""
    return out.with_suffix(".up.png")


def orientation_strip(gaussians: Gaussians, up: str, probabilities: dict[str, float]) -> np.ndarray:
    """Pictures (H, W, 3) uint8 of each axis that may point up with its option, most probable first.

    up  the axis of the file that points to +y in `gaussians`
    Taichi must be running.
    """
    pages = []
    for other in alternatives(probabilities):
        turned = gaussians.transformed(rotation_to_up(other) @ rotation_to_up(up).T)
        opaque = turned.opacities > OPAQUE
        seen = (turned.means[opaque] if opaque.any() else turned.means).astype(np.float64)
        camera = camera_for(seen.clip(*robust_bounds(seen)), STRIP_WIDTH, STRIP_HEIGHT)
        page = np.full((STRIP_HEIGHT + STRIP_FOOT, STRIP_WIDTH, 3), PAPER, np.uint8)
        page[:STRIP_HEIGHT] = splat_picture(Asset(turned), camera)
        text, ink = f"--up {other}   {probabilities[other]:.0%}", (40, 38, 36)
        cv2.putText(page, text, (12, STRIP_HEIGHT + 22), ink, cv2.FontFace("sans"), 17, 500)
        pages.append(page)
    return np.concatenate(pages, axis=1)


def cells_picture(solids: list[ComponentSolid], camera: Camera) -> np.ndarray:
    """Filled cells without the half towards the camera: the shell in one colour, its interior in another."""
    x, faces, colours, first = [], [], [], 0
    for m in solids:
        grid = m.distance
        step = max(1, round(max(np.ptp(np.argwhere(m.solid), axis=0) + 1) / MAX_DRAWN_CELLS))
        solid, shell = coarsened(m.solid, step), coarsened(m.shell, step)
        centre = grid.origin + grid.spacing * (np.indices(solid.shape).reshape(3, -1).T * step + (step - 1) / 2)
        mass_centre = grid.origin + grid.spacing * np.argwhere(grid.values < 0).mean(0)  # shows more than the middle
        keep = behind(centre, camera, mass_centre).reshape(solid.shape)
        corners, quads, owner = cubes(solid & keep)
        x.append(grid.origin + grid.spacing * (corners * step - 0.5))
        faces.append(quads + first)
        colours.append(np.where(shell[tuple(owner.T)][:, None], CLAY, BLUE))
        first += len(corners)
    canvas = Canvas(camera)
    canvas.polygons(np.concatenate(x), np.concatenate(faces), np.concatenate(colours))
    return canvas.picture()


def coarsened(cells: np.ndarray, step: int) -> np.ndarray:
    """Blocks of step^3 cells, set where at least half of the cells are."""
    n = [-(-k // step) for k in cells.shape]
    padded = np.zeros([k * step for k in n], np.float32)
    padded[tuple(map(slice, cells.shape))] = cells
    return padded.reshape(n[0], step, n[1], step, n[2], step).mean((1, 3, 5)) >= 0.5


def behind(points: np.ndarray, camera: Camera, middle: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points behind a plane through `middle`, (3,) or (N, 3), normal to x or z as the camera faces."""
    to = camera.position - middle
    axis = 0 if np.abs(to[..., 0]).max() > np.abs(to[..., 2]).max() else 2
    return (points[:, axis] - middle[..., axis]) * to[..., axis] < 0


def surface_picture(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """Surface of the level set."""
    canvas = Canvas(camera)
    canvas.polygons(vertices, faces, np.tile(SKIN, (len(faces), 1)))
    return canvas.picture()


def cage_picture(asset: Asset, camera: Camera) -> np.ndarray:
    """Cage cut open by a plane through the centre of each component; the cut in another colour than the surface."""
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    middles, volumes, part = x[tets].mean(1), asset.cage.volumes(), face_components(tets)
    centres = np.stack([np.bincount(part, volumes * m) for m in middles.T], 1) / np.bincount(part, volumes)[:, None]
    kept = tets[behind(middles, camera, centres[part])]
    canvas = Canvas(camera)
    if len(kept):
        faces = boundary_surface(kept)
        outer = set(map(tuple, np.sort(asset.cage.surface, axis=1).tolist()))
        on_surface = np.array([f in outer for f in map(tuple, np.sort(faces, axis=1).tolist())])
        canvas.polygons(x, faces, np.where(on_surface[:, None], SKIN, FLESH), lines=WIRE)
    return canvas.picture()


def enclosure_picture(asset: Asset, points: np.ndarray, inside: np.ndarray, depth: np.ndarray, camera: Camera):
    """Opaque Gaussians over the outline of the cage, darker the deeper they lie; those outside in red.

    points (N, 3) [m]; inside (N,); depth below the cage's surface (N,) [m]
    """
    canvas = Canvas(camera)
    cage = asset.cage
    canvas.polygons(
        cage.vertices, cage.surface, np.tile((244, 241, 236), (len(cage.surface), 1)), lines=GREY, flat=True
    )
    relative = (depth / max(float(np.percentile(depth, 98)), 1e-12)).clip(0, 1)[:, None] ** 0.5
    colours = SHALLOW + relative * (DEEP - SHALLOW)
    chosen = np.flatnonzero(inside)[:: max(1, int(inside.sum()) // MAX_DOTS)]
    canvas.dots(points[chosen], colours[chosen], 1.0)
    canvas.dots(points[~inside], np.tile(RED, (int((~inside).sum()), 1)), 2.5)
    return canvas.picture()


PAPER = (250, 249, 247)
LIGHT = np.array([-0.5, -0.65, -0.6]) / np.linalg.norm([-0.5, -0.65, -0.6])  # towards the lamp, in the camera's frame
AMBIENT = 0.35
SUPERSAMPLING = 2
SHIFT = 4  # fractional bits of a pixel: OpenCV's fixed point


class Canvas:
    """Picture seen by `camera`; each call draws over the last, far to near."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.page = np.full((SUPERSAMPLING * camera.height, SUPERSAMPLING * camera.width, 3), PAPER, np.uint8)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions [px of the supersampled page] (N, 2) and depths [m] (N,) of points (N, 3) [m]."""
        c, w = self.camera, self.camera.world_to_camera
        p = np.asarray(points, np.float64) @ w[:3, :3].T + w[:3, 3]
        z = np.maximum(p[:, 2:], 1e-9)
        return SUPERSAMPLING * (p[:, :2] / z * [c.fx, c.fy] + [c.cx, c.cy]), p[:, 2]

    def polygons(self, vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, *, lines=None, flat=False) -> None:
        """Draw flat faces (F, 3 or 4) of vertices (V, 3) [m], counter-clockwise from outside; colours (F, 3) 0..255.

        lines  colour of their edges, or None; flat: without shading. Back faces are culled.
        """
        x = np.asarray(vertices, np.float64)
        place, depth = self.project(x)
        normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        middle = x[faces].mean(1)
        towards = np.einsum("ni,ni->n", normal, self.camera.position - middle) > 0
        lit = 0.5 + 0.5 * normal @ (self.camera.world_to_camera[:3, :3].T @ LIGHT)  # wrapped diffuse: no face is black
        shade = np.ones(len(faces)) if flat else AMBIENT + (1 - AMBIENT) * lit
        order = np.argsort(-depth[faces].mean(1), kind="stable")
        order = order[towards[order]]
        fixed = np.round(place * (1 << SHIFT)).clip(-(1 << 24), 1 << 24).astype(np.int32)[faces]
        colour = (np.asarray(colours, np.float64) * shade[:, None]).clip(0, 255)
        for f in order:
            paint = tuple(colour[f].tolist())
            cv2.fillConvexPoly(self.page, fixed[f], paint, cv2.LINE_8, SHIFT)
            cv2.polylines(self.page, [fixed[f]], True, paint if lines is None else lines, 1, cv2.LINE_AA, SHIFT)

    def dots(self, points: np.ndarray, colours: np.ndarray, radius: float) -> None:
        """Draw discs of `radius` [px] at points (N, 3) [m], colours (N, 3)."""
        place, depth = self.project(points)
        fixed = np.round(place * (1 << SHIFT)).clip(-(1 << 24), 1 << 24).astype(np.int64)
        size = round(SUPERSAMPLING * radius * (1 << SHIFT))
        for i in np.argsort(-depth, kind="stable"):
            cv2.circle(self.page, tuple(fixed[i].tolist()), size, tuple(colours[i].tolist()), -1, cv2.LINE_AA, SHIFT)

    def picture(self) -> np.ndarray:
        """The finished picture, (H, W, 3) uint8."""
        return cv2.resize(self.page, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)


def cubes(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces between set and unset cells (X, Y, Z) bool: corners (V, 3) [cells], faces (F, 4), cell of each (F, 3).

    Faces are counter-clockwise from outside.
    """
    padded = np.pad(cells, 1)
    corners, owner = [], []
    for axis in range(3):
        for side, step in ((0, -1), (1, 1)):
            free = ~np.roll(padded, -step, axis)[1:-1, 1:-1, 1:-1]
            at = np.argwhere(cells & free)
            around = np.insert([[0, 0], [1, 0], [1, 1], [0, 1]][::step], 0, side, axis=1)
            corners.append(at[:, None] + np.roll(around, axis, axis=1))
            owner.append(at)
    corners, owner = np.concatenate(corners).reshape(-1, 3), np.concatenate(owner)
    return corners.astype(np.float64), np.arange(len(corners)).reshape(-1, 4), owner
