"""The report of `vrgs.py capture`: the room beside its photographs, its objects, seconds of each stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.file_access import atomic_write
from assets.gaussians import Gaussians
from assets.room_folder import PICTURE
from bench.html_page import Section, Table, html_page
from core.camera import Camera, look_at, perspective
from prepare.report_pictures import camera_for
from prepare.room_capture.captured_background import view_of
from prepare.room_capture.room_pipeline import PlacedRoom, with_objects

WIDTH = 360  # [px] of a picture
MENU = (256, 144)  # [px] of the picture in the menu of scenes
VIEWS = 3  # photographs compared with the room
PAPER_SECONDS = 2.5 * 3600  # the paper's time to prepare a scene


def write_report(out: Path, room: PlacedRoom, rest: Gaussians, things: list, photographs: list, about: dict) -> None:
    """Write report.html, and the picture for the menu of scenes, to a room's folder. Raises BadInput.

    rest         Gaussians of the background, `things` (asset, place) of each object
    photographs  files of the photographs, in the order of the room's cameras
    about        "seconds" by stage, "training" (its report) and "notes", lines
    """
    import cv2

    whole = with_objects(rest, things)
    eye, target, fov = view_of(room.view)
    menu = perspective(*MENU, fov, look_at(eye, target))
    with atomic_write(out / PICTURE) as beside:
        beside.write_bytes(cv2.imencode(".jpg", drawn(whole, [menu])[0][..., ::-1])[1].tobytes())
    first = drawn(whole, [perspective(2 * WIDTH, int(1.125 * WIDTH), fov, look_at(eye, target))])[0]
    sections = [Section("The room", "As the player sees it at the start.", {"at the start": first})]
    for k in np.unique(np.linspace(0, len(photographs) - 1, VIEWS).round().astype(int)):
        camera = narrowed(room.view.cameras[k])
        seen = cv2.imread(str(photographs[k]))[..., ::-1]
        pictures = {"photograph": cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA)}
        pictures["room"] = drawn(whole, [camera])[0]
        pictures |= {"without its objects": drawn(rest, [camera])[0]} if things else {}
        sections.append(Section(f"Photograph {k + 1}", photographs[k].name, pictures))
    for asset, thing in things:
        picture = drawn(asset.gaussians, [camera_for(asset.cage.vertices, WIDTH, WIDTH)])[0]
        holds = (
            "It stands free." if thing.fixed_below is None else "It hangs, held fast where it touches what is behind."
        )
        f = asset.provenance["figures"]
        text = f"{holds} Cage of {f['vertices']} vertices, smallest angle {f['min_dihedral']} degrees, "
        text += f"{asset.material.density * f['volume']:.2g} kg at {asset.material.young:.2g} Pa."
        sections.append(Section(thing.name, text, {"by itself": picture}))
    seconds = about["seconds"]
    rows = [(name, f"{s:.1f}") for name, s in seconds.items()] + [("in all", f"{sum(seconds.values()):.1f}")]
    note = f"The authors of the paper prepared a scene in {PAPER_SECONDS / 60:.0f} minutes."
    sections.append(Section("Time", "Of each stage.", table=Table(("stage", "seconds"), rows), note=note))
    test = about["training"].get("test")
    quality = f" Unseen photographs: PSNR {test['psnr']:.2f} dB, SSIM {test['ssim']:.3f}." if test else ""
    text = f"{len(rest):,} Gaussians, {len(things)} objects.{quality} " + " ".join(
        f"{line}." for line in about["notes"]
    )
    page = html_page(out.absolute().name, text, sections)
    with atomic_write(out / "report.html") as beside:
        beside.write_text(page, encoding="utf-8")


def narrowed(camera: Camera) -> Camera:
    """The camera with a picture WIDTH pixels wide."""
    s = WIDTH / camera.width
    height = max(1, round(s * camera.height))
    return Camera(WIDTH, height, s * camera.fx, s * camera.fy, s * camera.cx, s * camera.cy, camera.world_to_camera)


def drawn(gaussians: Gaussians, cameras: list[Camera]) -> list[np.ndarray]:
    """A picture (H, W, 3) uint8 for each camera, all of one size."""
    from render.renderer import Renderer
    from render.splats import Splats

    splats = Splats(gaussians)
    renderer = Renderer(splats, cameras[0].width, cameras[0].height, sort="radial")
    pictures = []
    for camera in cameras:
        renderer.render([camera])
        pictures.append(renderer.pixels()[0, ..., :3].copy())
    renderer.destroy()
    splats.destroy()
    return pictures
