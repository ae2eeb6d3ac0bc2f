"""The pictures of a preparation's report, each (H, W, 3) uint8, all from one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets.asset import Asset
from core.camera import Camera, look_at, perspective
from core.tetmesh import boundary_surface, face_components
from prepare.mesh_drawing import PAPER, Canvas, cubes

WIDTH, HEIGHT = 560, 480  # [px]
FOV = 0.5  # [rad]
ELEVATION, AZIMUTH = 0.35, 0.6  # [rad] of the camera above the floor, and from +z to +x
ROOM = 1.06  # of the body's half diagonal, what the picture shows to each side
CELLS = 56  # of the picture of filled cells, on the longest side: more cannot be told apart
DOTS = 15_000  # Gaussians in the picture of what is enclosed

CLAY, BLUE, GREY, RED = (214, 142, 108), (132, 172, 214), (206, 203, 198), (200, 40, 40)
SKIN, FLESH, WIRE = (226, 196, 150), (120, 166, 172), (70, 66, 62)
DEEP, SHALLOW = np.array((44, 84, 140)), np.array((170, 200, 226))


@dataclass(frozen=True)
class Made:
    """What the stages before the cage made of a piece, in the asset's frame.

    shell, solid  cells (X, Y, Z) bool: dense ones, and these with what they enclose
    phi           signed distance [m], (X, Y, Z) float32; node (i, j, k) lies at origin + spacing (i, j, k)
    """

    shell: np.ndarray
    solid: np.ndarray
    phi: np.ndarray
    origin: np.ndarray
    spacing: float


def camera_for(points: np.ndarray, width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """Camera that frames points (N, 3) [m] from the front, a little to the side and above."""
    low, high = points.min(0), points.max(0)
    middle, half = (low + high) / 2, np.linalg.norm(high - low) / 2
    towards = np.array([np.sin(AZIMUTH) * np.cos(ELEVATION), np.sin(ELEVATION), np.cos(AZIMUTH) * np.cos(ELEVATION)])
    side = min(1.0, width / height)
    eye = middle + towards * ROOM * half / (np.sin(FOV / 2) * side)
    near = perspective(width, height, FOV, look_at(eye, middle))
    # The box's diagonal is a loose bound: come closer until the points fill the picture.
    p = points @ near.world_to_camera[:3, :3].T + near.world_to_camera[:3, 3]
    share = np.abs(p[:, :2] / p[:, 2:] * near.fx / (0.5 * np.array([width, height]))).max()
    zoom = 0.92 / share
    return Camera(width, height, near.fx * zoom, near.fy * zoom, near.cx, near.cy, near.world_to_camera)


def splat_picture(asset: Asset, camera: Camera) -> np.ndarray:
    """The Gaussians as the program draws them. Taichi must be running."""
    from render.renderer import Renderer
    from render.splats import Splats

    background = tuple(c / 255 for c in PAPER)
    renderer = Renderer(Splats(asset.gaussians), camera.width, camera.height, background=background)
    renderer.render([camera])
    return renderer.pixels()[0][..., :3].copy()


def cells_picture(made: list[Made], camera: Camera) -> np.ndarray:
    """Filled cells, the half towards the camera taken away: the shell in one colour, what it encloses in another."""
    x, faces, colours, first = [], [], [], 0
    for m in made:
        step = max(1, round(max(np.ptp(np.argwhere(m.solid), axis=0) + 1) / CELLS))
        solid, shell = coarse(m.solid, step), coarse(m.shell, step)
        centre = m.origin + m.spacing * (np.indices(solid.shape).reshape(3, -1).T * step + (step - 1) / 2)
        keep = behind(centre, camera, _middle(m)).reshape(solid.shape)
        corners, quads, owner = cubes(solid & keep)
        x.append(m.origin + m.spacing * (corners * step - 0.5))
        faces.append(quads + first)
        colours.append(np.where(shell[tuple(owner.T)][:, None], CLAY, BLUE))
        first += len(corners)
    canvas = Canvas(camera)
    canvas.polygons(np.concatenate(x), np.concatenate(faces), np.concatenate(colours))
    return canvas.picture()


def coarse(cells: np.ndarray, step: int) -> np.ndarray:
    """Blocks of step^3 cells, set where at least half of the cells are."""
    n = [-(-k // step) for k in cells.shape]
    padded = np.zeros([k * step for k in n], np.float32)
    padded[tuple(map(slice, cells.shape))] = cells
    return padded.reshape(n[0], step, n[1], step, n[2], step).mean((1, 3, 5)) >= 0.5


def behind(points: np.ndarray, camera: Camera, middle: np.ndarray) -> np.ndarray:
    """Mask (N,) of the points on the far side of a plane through `middle`, (3,) or (N, 3): the one of x and z that the
    camera faces."""
    to = camera.position - middle
    axis = 0 if np.abs(to[..., 0]).max() > np.abs(to[..., 2]).max() else 2
    return (points[:, axis] - middle[..., axis]) * to[..., axis] < 0


def _middle(made: Made) -> np.ndarray:
    """Centre of mass [m] of what is within the surface: a cut through it shows more than one through the box's."""
    return made.origin + made.spacing * np.argwhere(made.phi < 0).mean(0)


def surface_picture(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """The level set's surface."""
    canvas = Canvas(camera)
    canvas.polygons(vertices, faces, np.tile(SKIN, (len(faces), 1)))
    return canvas.picture()


def cage_picture(asset: Asset, camera: Camera) -> np.ndarray:
    """The cage cut open: tets in front of a plane are taken away; the cut in another colour than the surface."""
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    middles, volumes, piece = x[tets].mean(1), asset.cage.volumes(), face_components(tets)
    centres = np.stack([np.bincount(piece, volumes * m) for m in middles.T], 1) / np.bincount(piece, volumes)[:, None]
    kept = tets[behind(middles, camera, centres[piece])]
    canvas = Canvas(camera)
    if len(kept):
        faces = boundary_surface(kept)
        outer = set(map(tuple, np.sort(asset.cage.surface, axis=1).tolist()))
        skin = np.array([f in outer for f in map(tuple, np.sort(faces, axis=1).tolist())])
        canvas.polygons(x, faces, np.where(skin[:, None], SKIN, FLESH), lines=WIRE)
    return canvas.picture()


def enclosure_picture(asset: Asset, points: np.ndarray, inside: np.ndarray, depth: np.ndarray, camera: Camera):
    """Opaque Gaussians in the cage, the deeper the darker, over its outline; those outside in red.

    points (N, 3) [m]; inside (N,); depth below the cage's surface (N,) [m]
    """
    canvas = Canvas(camera)
    cage = asset.cage
    canvas.polygons(
        cage.vertices, cage.surface, np.tile((244, 241, 236), (len(cage.surface), 1)), lines=GREY, flat=True
    )
    share = (depth / max(float(np.percentile(depth, 98)), 1e-12)).clip(0, 1)[:, None] ** 0.5
    colours = SHALLOW + share * (DEEP - SHALLOW)
    chosen = np.flatnonzero(inside)[:: max(1, int(inside.sum()) // DOTS)]
    canvas.dots(points[chosen], colours[chosen], 1.0)
    canvas.dots(points[~inside], np.tile(RED, (int((~inside).sum()), 1)), 2.5)
    return canvas.picture()
