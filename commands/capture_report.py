"""The report of `vrgs.py capture`: the room beside its photographs, its objects, seconds of each stage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import atomic_write
from assets.gaussians import Gaussians
from assets.room_folder import PICTURE, RoomObject
from commands.viewing import draw_rgba8
from core.camera import Camera, look_at, perspective
from core.report import Section, Table, html_page
from display.picture import save_picture
from prepare.report_pictures import camera_for
from prepare.room_capture.captured_background import view_of
from prepare.room_capture.room_pipeline import PlacedRoom, with_objects

WIDTH = 360  # [px] of a picture
MENU = (256, 144)  # [px] of the picture in the menu of scenes
VIEWS = 3  # photographs compared with the room
WORK = {
    "frames": "the sharpest frames of the video",
    "poses": "where each photograph was taken",
    "train": "Gaussians",
    "cameras": "what each photograph needs of them",
    "objects": "masks from marks; the object of each Gaussian",
    "cages": "a body for each object",
    "inpaint": "what the objects hid",
    "room": "the collider",
}


def write_report(out: Path, room: PlacedRoom, rest: Asset, things: list, photographs: list, about: dict) -> None:
    """Write report.html, and the picture for the menu of scenes, to a room's folder. Raises BadInput.

    rest         the background, `things` (asset, place) of each object
    photographs  files of the photographs, in the order of the room's cameras
    about        "seconds" by stage, "training" (its report) and "notes", lines
    """
    import cv2

    whole = with_objects(rest.gaussians, things)
    eye, target, fov = view_of(room.view)
    menu = perspective(*MENU, fov, look_at(eye, target))
    save_picture(out / PICTURE, drawn(whole, menu))

    def photograph(k: int) -> np.ndarray:
        camera = narrowed(room.view.cameras[k])
        seen = cv2.imread(str(photographs[k]))[..., ::-1]
        return cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA)

    k = room.view.photographer()
    first = drawn(whole, perspective(round(1.5 * WIDTH), WIDTH, fov, look_at(eye, target)))
    pictures = {"at the start": first, f"the photograph taken there: {photographs[k].name}": photograph(k)}
    sections = [Section("The room", "As the player sees it at the start.", pictures, items=tuple(about["notes"]))]
    for k in np.unique(np.linspace(0, len(photographs) - 1, VIEWS).round().astype(int)):
        camera = narrowed(room.view.cameras[k])
        pictures = {"photograph": photograph(k), "room": drawn(whole, camera)}
        pictures |= {"without its objects": drawn(rest.gaussians, camera)} if things else {}
        sections.append(Section(f"Photograph {k + 1} of {len(photographs)}", photographs[k].name, pictures))
    for asset, thing in things:
        picture = drawn(asset.gaussians, camera_for(asset.cage.vertices, WIDTH, WIDTH))
        sections.append(Section(thing.name, described(asset, thing, eye), {"by itself": picture}))
    sections += [played(out, rest, eye), spent(about["seconds"])]
    count = f"{len(things)} object{'' if len(things) == 1 else 's'}"
    text = f"{len(rest.gaussians):,} Gaussians, {count}."
    if test := about["training"].get("test"):
        text += f" Unseen photographs: PSNR {test['psnr']:.2f} dB, SSIM {test['ssim']:.3f}."
    with atomic_write(out / "report.html") as beside:
        beside.write_text(html_page(out.absolute().name, text, sections), encoding="utf-8")


def described(asset: Asset, thing: RoomObject, eye: tuple) -> str:
    """An object in words: how it is held, how large and heavy it is, how far away."""
    holds = "It stands free." if thing.fixed_below is None else "It hangs, held fast where it touches what is behind."
    size = " × ".join(f"{100 * s:.0f}" for s in np.ptp(asset.cage.vertices, axis=0))
    f, young = asset.provenance["figures"], asset.material.young
    away = np.linalg.norm(np.subtract(eye, thing.position))
    return (
        f"{holds} {size} cm, {asset.material.density * f['volume']:.2g} kg, {young / 1e3:.3g} kPa, {away:.1f} m from "
        f"the eye at the start. Cage of {f['vertices']} vertices, smallest angle {f['min_dihedral']} degrees."
    )


def played(out: Path, rest: Asset, eye: tuple) -> Section:
    """Section on playing the room: its free place."""
    place, on = rest.environment, rest.provenance["drop_on"]
    away = np.linalg.norm(np.subtract(eye, place.drop_point))
    free = f"A body of yours falls {away:.1f} m from the eye, "
    if on == "nothing":
        free += "where the photographs look: no level place was captured."
    else:
        kind = on if on == "floor" else f"{on} at a height of {100 * (place.drop_point[1] - place.floor_height):.0f} cm"
        free += f"onto the {kind}, with {100 * place.clear_radius:.0f} cm free around it."
    name = out.absolute().name
    commands = (f"python vrgs.py --scene {name}/", f"python vrgs.py --scene sandbox --stage {name}/ --body FILE")
    return Section("To play", free, items=commands)


def spent(seconds: dict[str, float]) -> Section:
    """Seconds of each stage."""
    rows = [(name, WORK[name], f"{s:.1f}") for name, s in seconds.items()]
    table = Table(("stage", "", "seconds"), [*rows, ("in all", "", f"{sum(seconds.values()):.1f}")])
    text = "Of each stage; a stage that was kept from an earlier run took this long then."
    return Section("Time", text, table=table, note="The authors of the paper prepared a scene in 150 minutes.")


def narrowed(camera: Camera) -> Camera:
    """The camera with a picture WIDTH pixels wide."""
    return camera.resized(WIDTH, max(1, round(WIDTH / camera.width * camera.height)))


def drawn(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """A picture (H, W, 3) uint8 on black."""
    (picture,) = draw_rgba8(gaussians, [camera])
    return picture[..., :3]
