"""A capture of a modelled place with its truth: toys on a table in a children's room, photographed by ray casting.

Nothing of it is made of Gaussians: poses, masks, depths, and what is behind each object are exact. Its marks are two
strokes an object, as a user would draw them.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from assets.file_access import make_folder, part_beside, reason_of
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from prepare.segment.marks import write_marks
from prepare.segment.mask_files import Masks, object_colors, write_masks
from prepare.train.capture import Lens, View
from prepare.train.capture_files import OPENGL_TO_OPENCV
from studio.attic.boxes import SIZES, parcel
from studio.ball import RADIUS, bands
from studio.childrens_room.bed_and_tent import furniture
from studio.childrens_room.painted_shell import openings, shell
from studio.childrens_room.play_things import play_things
from studio.creatures.toy_pets import toy_duck, toy_teddy
from studio.ring import RING_TUBE, torus_surfaces
from studio.shapes import Surface, beveled_box, box, join, rotation_about, superellipsoid
from studio.stroke_marks import two_strokes
from studio.textures import BEECH, wood
from studio.toy_meshes import creature_surfaces
from studio.traced_scene import OFFSET, Picture, Shape, TracedScene, camera_rays, take_alone, take_picture

TABLE_AT, TABLE_SIZE = (0.0, 0.52, -0.25), (1.16, 0.035, 0.74)  # [m] middle of its top, and the board
OBJECTS = ("teddy", "duck", "parcel", "ball", "ring")
PLACES = {  # of each object on the table [m]: to the right, towards the photographer; and its turn [degrees]
    "teddy": (0.02, -0.08, 8.0),
    "duck": (0.36, 0.02, -38.0),
    "parcel": (-0.25, -0.17, 24.0),
    "ball": (-0.21, 0.13, 0.0),
    "ring": (0.17, 0.21, 0.0),
}
JITTER, TURN = 0.012, 12.0  # [m], [degrees] by which a seed moves and turns an object
ARC = (-88.0, 80.0)  # [degrees] about the table, from which it is photographed; 0 is in front
RADII, HEIGHTS = (0.95, 1.35), (0.22, 0.85)  # [m] of the cameras: from the table's middle, above its top
AIM = (0.0, 0.06, 0.0)  # [m] from the middle of the table's top
FOV_Y = 50.0  # [degrees]
CUT_OUT_RADIUS = 1.3  # [m] of the hemisphere from which toys on transparent ground are seen
TURNS = ("x", "z")  # axes about which an object is turned by 90 degrees, to be looked at alone
TURNED_VIEWS, TURNED_HEIGHT = 4, 0.4  # of each turn: around it, and their height over their distance
SEEN_MIN, SEEN_COSINE = 3, 0.25  # least photographs that show what was photographed, and the cosine at which they do
FULL_HEIGHT = 360  # [px] of a picture for which models and light are as fine as they get
FINE_MIN = 0.15
SPARSE_POINTS = 6000
THREADS_MAX = 4  # pictures at a time: each takes 0.5 GB at 640x480
AXES = {"+y": np.eye(3)} | {
    name: rotation_about(axis, degrees)
    for name, axis, degrees in (("-y", "x", 180), ("+z", "x", 90), ("-z", "x", -90), ("+x", "z", -90), ("-x", "z", 90))
}


@dataclass(frozen=True)
class CaptureOptions:
    """Options of a procedural capture: the things and the photographs.

    views   number of photographs
    size    (width, height) [px]
    seed    of the objects' places and of the cameras
    up      axis of the capture's world that points up
    scale   units of the capture's world in a metre
    side    squared rays a pixel of a photograph
    cut_out the toys alone, on transparent ground, as a Blender dataset of `views` and a quarter as many to test
    """

    views: int = 40
    size: tuple[int, int] = (480, 360)
    seed: int = 0
    up: str = "+y"
    scale: float = 1.0
    side: int = 2
    cut_out: bool = False


def write_procedural_capture(folder: Path, options: CaptureOptions, report: Callable[[str], None] = print) -> None:
    """Write the capture into a new folder, whole or not at all. Raises BadInput."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(f"{folder}: exists already; choose another folder")
    make_folder(folder.parent)
    beside = part_beside(folder)
    try:
        beside.mkdir()
        (_write_cut_out if options.cut_out else _write)(beside, options, report)
        if folder.exists():
            folder.rmdir()
        beside.rename(folder)
    except OSError as e:
        raise BadInput(f"{folder}: cannot be written ({reason_of(e)})") from e
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def placed_objects(rng: np.random.Generator, fine: float) -> dict[str, tuple[list[Shape], np.ndarray, np.ndarray]]:
    """Shapes of each object on the table, with its rotation (3, 3) and position (3,) [m]."""
    nodes = round(32 + 56 * fine)
    height = SIZES["box_parcel"][1]
    models = {
        "teddy": creature_surfaces(toy_teddy(), nodes),
        "duck": creature_surfaces(toy_duck(), nodes),
        "parcel": [(s.placed(position=(0.0, height / 2, 0.0)), None) for s in parcel()],
        "ball": [(_ball(fine), None)],
        "ring": [(s.placed(position=(0.0, RING_TUBE, 0.0)), None) for s in torus_surfaces("ring_red")],
    }
    found = {}
    for k, name in enumerate(OBJECTS):
        x, z, degrees = PLACES[name]
        dx, dz, turn = rng.uniform(-1, 1, 3) * (JITTER, JITTER, TURN)
        rotation = rotation_about("y", degrees + turn)
        position = np.array(TABLE_AT) + (x + dx, 0.0, z + dz)
        shapes = [Shape(s.placed(rotation, position), k + 1, albedo) for s, albedo in models[name]]
        found[name] = (shapes, rotation, position)
    return found


def table() -> list[Surface]:
    """A low table of beech."""
    w, t, d = TABLE_SIZE
    x, y, z = TABLE_AT
    top = beveled_box(TABLE_SIZE, 0.004)
    legs = [
        box((x + i * (w / 2 - 0.05) - 0.025, 0.0, z + j * (d / 2 - 0.05) - 0.025),
            (x + i * (w / 2 - 0.05) + 0.025, y - t, z + j * (d / 2 - 0.05) + 0.025))
        for i in (-1, 1) for j in (-1, 1)
    ]  # fmt: skip
    board = Surface("table top", top, wood(BEECH, axis=0, board=0.123, across=2, seed=61), 0.0045, uniform=True)
    return [
        board.placed(position=(x, y - t / 2, z)),
        Surface("table legs", join(*legs), wood(BEECH, axis=1, across=0, seed=62), 0.03, uniform=True),
    ]


def cameras(options: CaptureOptions, rng: np.random.Generator) -> list[Camera]:
    """Cameras on an arc round the table, up and down, held upright."""
    width, height = options.size
    found, aim = [], np.array(TABLE_AT) + AIM
    for k in range(options.views):
        turn = np.radians(np.interp(k, (0, max(options.views - 1, 1)), ARC))
        a, b = (0.5 + 0.6180339887 * k) % 1, (0.5 + 0.7548776662 * k) % 1  # spread evenly, whatever the number
        r, y = np.interp(a, (0, 1), RADII), TABLE_AT[1] + np.interp(b, (0, 1), HEIGHTS)
        eye = (TABLE_AT[0] + r * np.sin(turn), y, TABLE_AT[2] + r * np.cos(turn))
        target = aim + rng.uniform(-1, 1, 3) * (0.08, 0.03, 0.05)
        found.append(perspective(width, height, np.radians(FOV_Y), look_at(eye, target)))
    return found


def _ball(fine: float) -> Surface:
    return Surface(
        "ball", superellipsoid((2 * RADIUS,) * 3, 1.0, round(16 + 32 * fine)), bands, 0.02, uniform=True
    ).placed(rotation_about("x", 35.0), (0.0, RADIUS, 0.0))


def _write(folder: Path, options: CaptureOptions, report: Callable[[str], None]) -> None:
    """Write all files."""
    rng = np.random.default_rng(options.seed)
    fine = float(np.clip(options.size[1] / FULL_HEIGHT, FINE_MIN, 1.0))
    objects = placed_objects(rng, fine)
    room = [*shell(), *furniture(), *play_things()]
    shapes = [Shape(s) for s in room] + [Shape(s, support=True) for s in table()]
    shapes += [s for parts, _, _ in objects.values() for s in parts]
    scene = TracedScene(shapes, openings()[0], fine=fine, rng=rng)
    report(f"{len(scene.faces):,} triangles, light at {len(scene.vertices):,} vertices")
    for name in ("images", "depth", *(f"behind/{name}" for name in OBJECTS)):
        (folder / name).mkdir(parents=True)
    without = range(1, len(OBJECTS) + 1)
    scene.prepare(without)
    views, ids, colors, start = cameras(options, rng), [], [], time.perf_counter()
    with ThreadPoolExecutor(min(os.cpu_count() or 1, THREADS_MAX)) as pool:
        pictures = pool.map(lambda camera: take_picture(scene, camera, options.side, without), views)
        for k, picture in enumerate(pictures):
            _write_pictures(folder, f"frame_{k + 1:05}.png", picture)
            ids.append(picture.ids)
            colors.append(picture.pixels)
            left = (time.perf_counter() - start) / (k + 1) * (len(views) - k - 1)
            report(f"view {k + 1} of {len(views)}, {left:.0f} s left")
    turn, scale = AXES[options.up], options.scale
    names = [f"images/frame_{k + 1:05}.png" for k in range(len(views))]
    frames = []
    for name, camera in zip(names, views, strict=True):
        frames.append({"file_path": name, "transform_matrix": _pose(camera, turn, scale)})
    c = views[0]
    lens = {"camera_model": "PINHOLE", "w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
    _write_json(folder / "transforms.json", lens | {"ply_file_path": "sparse_pc.ply", "frames": frames})
    masks = Masks(list(OBJECTS), object_colors(len(OBJECTS)), ids)
    flat = Lens(c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    write_masks(folder / "masks", [View(folder / n, flat, np.eye(4)) for n in names], masks)
    write_marks(folder / "marks.json", two_strokes(masks, [Path(n).name for n in names]))
    points, paint = _sparse_points(scene, views, colors, rng)
    _write_points(folder / "sparse_pc.ply", scale * points @ turn.T, paint)
    _write_json(folder / "truth.json", _truth(scene, objects, options, turn))
    for k, name in enumerate(OBJECTS, 1):
        _write_turned(folder / "turned" / name, k, scene, views, options)


def _write_turned(folder: Path, k: int, scene: TracedScene, views: list[Camera], options: CaptureOptions) -> None:
    """Write a Blender dataset of object k alone, in the light in which it was photographed, as it is seen when turned
    by each of TURNS; masks tell the pixels that photographs show.

    The cameras turn, the other way, and not the object: the pictures are the same.
    """
    (folder / "photographed").mkdir(parents=True)
    turn, scale = AXES[options.up], options.scale
    own = scene.vertices[scene.faces[scene.owner == k]].reshape(-1, 3)
    middle, distance = 0.5 * (own.min(axis=0) + own.max(axis=0)), float(np.mean(RADII))
    focal, frames = views[0].fy, []
    side = 2 * round(focal * np.linalg.norm(own - middle, axis=1).max() / distance) + 8
    for axis, j in product(TURNS, range(TURNED_VIEWS)):
        around, back = 2.0 * np.pi * (j + 0.5) / TURNED_VIEWS, np.eye(4)
        way = np.array([np.sin(around), TURNED_HEIGHT, np.cos(around)])
        back[:3, :3] = rotation_about(axis, 90.0)
        back[:3, 3] = middle - back[:3, :3] @ middle
        pose = look_at(middle + distance / np.linalg.norm(way) * way, middle) @ back
        camera, name = perspective(side, side, 2 * np.arctan(side / 2 / focal), pose), f"{axis}{j + 1}.png"
        _write_cut_out_picture(folder / name, *take_alone(scene, camera, options.side, k), options.side)
        _write_image(folder / "photographed" / name, 255 * _photographed(scene, camera, views, k).astype(np.uint8))
        files = {"file_path": name, "mask_path": f"photographed/{name}"}
        frames.append(files | {"transform_matrix": _pose(camera, turn, scale)})
    angle = 2.0 * float(np.arctan(side / 2 / focal))
    _write_json(folder / "transforms.json", {"camera_angle_x": angle, "frames": frames})


def _photographed(scene: TracedScene, camera: Camera, views: list[Camera], k: int) -> np.ndarray:
    """Mask (H, W) of the pixels of object k alone that SEEN_MIN of the photographs show, not from too far aside."""
    origins, d = camera_rays(camera)
    hits = scene.hits(origins, d, only=k)
    there = np.isfinite(hits.distance)
    points = (origins + np.where(there, hits.distance, 0.0)[:, None] * d)[there]
    normals = np.einsum("nk,nkc->nc", hits.weights, scene.normals[scene.faces[hits.face]])[there]
    count = np.zeros(len(points), int)
    for view in views:
        way = points - view.position
        far = np.linalg.norm(way, axis=1)
        way /= far[:, None]
        local = way @ view.world_to_camera[:3, :3].T
        x, y = (view.fx * local[:, 0] / local[:, 2] + view.cx, view.fy * local[:, 1] / local[:, 2] + view.cy)
        inside = (local[:, 2] > 0) & (x > 0) & (x < view.width) & (y > 0) & (y < view.height)
        clear = scene.hits(np.broadcast_to(view.position, way.shape), way).distance > far - OFFSET
        count += inside & clear & (-(way * normals).sum(axis=1) > SEEN_COSINE)
    shown = np.zeros(len(d), bool)
    shown[there] = count >= SEEN_MIN
    return shown.reshape(camera.height, camera.width)


def _write_cut_out(folder: Path, options: CaptureOptions, report: Callable[[str], None]) -> None:
    """Write the toys on transparent ground, seen from a hemisphere, in the layout of Blender's datasets."""
    rng = np.random.default_rng(options.seed)
    fine = float(np.clip(options.size[1] / FULL_HEIGHT, FINE_MIN, 1.0))
    shapes = [s for parts, _, _ in placed_objects(rng, fine).values() for s in parts]
    scene = TracedScene(shapes, openings()[0], fine=fine, rng=rng)
    scene.prepare(())
    turn, scale, (width, height) = AXES[options.up], options.scale, options.size
    for part, count in (("train", options.views), ("test", max(1, options.views // 4))):
        (folder / part).mkdir()
        frames = []
        for k in range(count):
            up, around = rng.uniform(0.05, 0.95), rng.uniform(0.0, 2.0 * np.pi)
            way = np.array([np.sqrt(1 - up**2) * np.cos(around), up, np.sqrt(1 - up**2) * np.sin(around)])
            target = np.array(TABLE_AT) + AIM
            camera = perspective(width, height, np.radians(FOV_Y), look_at(target + CUT_OUT_RADIUS * way, target))
            picture = take_picture(scene, camera, options.side)
            _write_cut_out_picture(folder / part / f"r_{k}.png", picture.pixels, picture.alpha, options.side)
            frames.append({"file_path": f"./{part}/r_{k}", "transform_matrix": _pose(camera, turn, scale)})
        angle = 2.0 * float(np.arctan(0.5 * width / camera.fx))
        _write_json(folder / f"transforms_{part}.json", {"camera_angle_x": angle, "frames": frames})
        report(f"{count} pictures to {part}")


def _write_cut_out_picture(path: Path, pixels: np.ndarray, alpha: np.ndarray, side: int) -> None:
    """Write a picture (H, W, 3) over black, 0..255, of `side` squared rays a pixel, with its opacity (H, W), 0..1."""
    color = pixels / np.maximum(alpha, 0.5 / side**2)[..., None]
    _write_image(path, np.dstack([color[..., ::-1], 255 * alpha]).round().clip(0, 255).astype(np.uint8))


def _write_image(path: Path, pixels: np.ndarray) -> None:
    import cv2

    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes())


def _pose(camera: Camera, turn: np.ndarray, scale: float) -> list:
    """The transform_matrix of a camera, in a world that is turned and scaled."""
    pose = np.eye(4)
    pose[:3, :3] = turn @ camera.world_to_camera[:3, :3].T
    pose[:3, 3] = scale * turn @ camera.position
    return (pose @ OPENGL_TO_OPENCV).tolist()


def _write_pictures(folder: Path, name: str, picture: Picture) -> None:
    depth = (1000.0 * np.where(np.isfinite(picture.depth), picture.depth, 0.0)).round().clip(0, 65535)
    files = {"images": picture.pixels[..., ::-1], "depth": depth.astype(np.uint16)}
    files |= {f"behind/{OBJECTS[k - 1]}": pixels[..., ::-1] for k, pixels in picture.without.items()}
    for place, pixels in files.items():
        _write_image(folder / place / name, pixels)


def _sparse_points(scene: TracedScene, views: list[Camera], colors, rng) -> tuple[np.ndarray, np.ndarray]:
    """Points of what the photographs show, (P, 3) [m], and their colours (P, 3) uint8."""
    points, paint = [], []
    for camera, pixels in zip(views, colors, strict=True):
        origins, d = camera_rays(camera)
        chosen = rng.choice(len(d), min(-(-SPARSE_POINTS // len(views)), len(d)), replace=False)
        hits = scene.hits(origins[chosen], d[chosen])
        there = np.isfinite(hits.distance)
        points.append((origins[chosen] + hits.distance[:, None] * d[chosen])[there])
        paint.append(pixels.reshape(-1, 3)[chosen][there])
    return np.concatenate(points), np.concatenate(paint)


def _write_points(path: Path, points: np.ndarray, colors: np.ndarray) -> None:
    """Write a binary .ply of points."""
    kinds = [(a, "<f4") for a in "xyz"] + [(a, "u1") for a in ("red", "green", "blue")]
    rows = np.empty(len(points), kinds)
    for k, a in enumerate("xyz"):
        rows[a] = points[:, k]
    for k, a in enumerate(("red", "green", "blue")):
        rows[a] = colors[:, k]
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property {'float' if kind == '<f4' else 'uchar'} {a}\n" for a, kind in kinds) + "end_header\n"
    path.write_bytes(head.encode() + rows.tobytes())


def _truth(scene: TracedScene, objects: dict, options: CaptureOptions, turn: np.ndarray) -> dict:
    """The truth about the capture's world, in its units but where metres are said."""
    scale, found = options.scale, {}
    for k, (name, (_, rotation, position)) in enumerate(objects.items()):
        own = scene.vertices[scene.faces[scene.owner == k + 1]].reshape(-1, 3)
        world = scale * own @ turn.T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn @ rotation, scale * turn @ position
        local = (own - position) @ rotation
        found[name] = {
            "world_from_object": pose.tolist(),
            "low": world.min(axis=0).tolist(),
            "high": world.max(axis=0).tolist(),
            "size_in_metres": np.ptp(local, axis=0).tolist(),
            "stands_on": "table",
        }
    (x, y, z), (w, _, d) = TABLE_AT, TABLE_SIZE
    corners = np.array([(x + i * w / 2, y, z + j * d / 2) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return {
        "up": (turn @ (0.0, 1.0, 0.0)).round(12).tolist(),
        "front": (turn @ (0.0, 0.0, 1.0)).round(12).tolist(),
        "metres_per_unit": 1.0 / scale,
        "depth": "16-bit millimetres along the camera's axis, at pixel centres; 0: nothing",
        "floor_height": 0.0,
        "table_top": (scale * corners @ turn.T).tolist(),
        "objects": found,
    }


def _write_json(path: Path, data: dict) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
