"""`vrgs.py capture`: photographs become a room to play in, with objects that can be grabbed.

Objects are asked for first: poses and training take minutes, and marks are drawn on photographs, which need neither.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import atomic_write, locked_folder, make_folder
from assets.gaussians import Gaussians
from assets.room_folder import MANIFEST, PICTURE, RoomObject, write_room
from assets.splat_files import read_gaussians, write_gaussians
from commands import options as cli
from commands import train
from commands.segment import marked_photographs
from commands.train import is_posed, photographs_of, read_posed, stages_before, with_poses
from commands.viewing import draw_rgba8
from core.camera import Camera, look_at, perspective
from core.errors import BadInput
from core.material import MATERIALS
from core.report import Section, Table, html_page
from core.rotation import rotation_between
from core.runtime import end_taichi, running_arch, start_taichi
from core.typed import from_plain, to_plain
from display.picture import save_picture
from prepare.onnx_network import LamaNetwork
from prepare.prepared_files import device_vertices
from prepare.report_pictures import camera_for
from prepare.room_capture import room_pipeline
from prepare.room_capture.captured_background import view_of
from prepare.room_capture.contributions import Contributions, contributions
from prepare.room_capture.objects import Support
from prepare.room_capture.room_pipeline import MeasuredLength, PlacedRoom
from prepare.room_capture.stages import Stages, file_key, source_digest
from prepare.segment.marks import Marks, marks_json, read_marks
from prepare.segment.mask_files import read_masks
from prepare.segment.mask_propagation import propagate_marks
from prepare.segment.object_ids import background_around, learned_objects, masks_beside, masks_of, trained_alone
from prepare.train.capture import Capture
from prepare.train.photographs import image_size, load_photographs

STAGES = ("train", "objects", "cameras", "cages", "inpaint", "room")
MARKS = "marks.json"  # beside the photographs
Say = Callable[[str], None]
Bodies = list[tuple[Asset, RoomObject]]
STEPS = {"cuda": 10_000, "cpu": 3_000}
CPU_SIDE = 400  # [px] longest side of photographs on a CPU: 3,000 steps take minutes then
OBJECTS = cli.OneOf()
WIDTH = 360  # [px] of a picture in the report
MENU = (256, 144)  # [px] of the picture in the menu of scenes
VIEWS = 3  # photographs compared with the room
WORK = {
    "frames": "the sharpest frames of the video",
    "poses": "where each photograph was taken",
    "train": "Gaussians",
    "objects": "masks from marks; the object of each Gaussian",
    "cameras": "what each photograph needs of them",
    "cages": "a body for each object",
    "inpaint": "what the objects hid",
    "room": "the collider",
}


@dataclass(kw_only=True)
class CaptureOptions(cli.Options):
    EXAMPLES = (
        "capture bear/ --marks marks.json --out bear_room/          then: python vrgs.py --scene bear_room/",
        "capture kitchen.mp4 --no-objects --out kitchen/            only the room; needs pycolmap",
        "capture toys/ --masks toys/masks --out room/ --steps 2000 --reduce 2",
        "capture bear/ --marks m.json --out r/ --scale-points frame_00001.jpg:210,380 frame_00001.jpg:310,385 0.46",
    )
    CONDITIONS = (
        cli.Condition(("--lama", "--vertices", "--material"), lambda o: not o.no_objects, "is not for --no-objects"),
    )

    capture: Path = cli.argument("CAPTURE", f"{cli.CAPTURES}, folder of photographs, or a video")
    out: Path = cli.option("ROOM/", "folder of the room; an interrupted run resumes there", cli.REQUIRED)
    marks: Path | None = cli.option(
        "MARKS.json",
        "marks of objects (default: CAPTURE/marks.json, else CAPTURE/masks, else a window opens)",
        one_of=OBJECTS,
    )
    masks: Path | None = cli.option("FOLDER", "folder of masks, one colour per object", one_of=OBJECTS)
    no_objects: bool = cli.switch("make only the room, with nothing to grab", one_of=OBJECTS)
    scale_points: tuple[str, str, str] | None = cli.option(
        ("A", "B", "M"),
        "two points, each PHOTOGRAPH:x,y [px] or x,y,z in the capture, and their distance, as 0.46 or 46cm (default: "
        "guessed scale)",
    )
    steps: cli.Count | None = cli.option("N", f"training steps (default {cli.by_device(STEPS)})")
    reduce: cli.Count | None = cli.option(
        "N",
        f"divide the width and height of the photographs by N (default: on a CPU so that they have at most {CPU_SIDE} "
        "pixels, on a GPU 1)",
    )
    cap: cli.Count | None = cli.option("N", f"upper limit of Gaussians (default {cli.by_device(train.CAPS)})")
    vertices: cli.Count | None = cli.option("N", "vertices of each object's cage (default: as suits the device)")
    material: str | None = cli.option("NAME", "material of all objects (default plush; see: vrgs.py materials)")
    lama: Path | None = cli.option("FILE.onnx", "LaMa network that fills the holes (default: patch synthesis)")
    cell: cli.Amount | None = cli.option("M", "spacing of the room's distance grid (default: by size)")
    seed: int = cli.seed_option()
    arch: cli.Arch | None = cli.arch_option()


def capture(options: CaptureOptions) -> None:
    """Make the room, stage by stage. Raises BadInput, for bad input before anything takes long."""
    make_room(options)
    print(f"{options.out}: play it with: python vrgs.py --scene {options.out}")


def make_room(options: CaptureOptions) -> None:
    """Make the room of a capture in the folder --out. Raises BadInput, also if another run writes there."""
    check(options)
    with locked_folder(options.out):  # two runs would remove each other's stages
        start_taichi(options.arch, options.seed)
        stages = Stages(options.out / "work", (*stages_before(options.capture), *STAGES))
        RoomMaking(options, stages).make()


def check(options: CaptureOptions) -> None:
    """Check what can be checked before anything long. Raises BadInput."""
    if not options.capture.exists():
        raise BadInput(f"{options.capture}: no such file or folder")
    if options.out.exists() and not options.out.is_dir():
        raise BadInput(f"{options.out}: is a file; a room is a folder")
    if options.material is not None and options.material not in MATERIALS:
        raise BadInput(f"no material named {options.material!r}; see: vrgs.py materials")
    for path in filter(None, (options.marks, options.masks, options.lama)):
        if not path.exists():
            raise BadInput(f"{path}: no such file or folder")
    if options.lama:
        LamaNetwork(options.lama)  # needed in an hour, perhaps
    if options.scale_points:
        MeasuredLength.of(options.scale_points)


class RoomMaking:
    """The stages of a room, each with what it needs of those before it."""

    def __init__(self, options: CaptureOptions, stages: Stages):
        self.options, self.stages, self.notes = options, stages, []
        self.length = MeasuredLength.of(options.scale_points) if options.scale_points else None
        self.source = source_digest("commands.capture_room")

    def say(self, text: str) -> None:
        """Tell the user, and note it for the report."""
        self.notes.append(text)
        print(text, file=sys.stderr, flush=True)

    def make(self) -> None:
        """All stages. Raises BadInput."""
        self.train()
        self.segment()
        found = self.look()
        scale = self.length and self.length.scale(self.gaussians, self.capture, self.turn)
        room = room_pipeline.placed_room(self.gaussians, self.capture, found, scale)
        for line in room.orientation.described():
            self.say(line)
        room, held = room_pipeline.held_objects(room, self.say)
        self.say(f"{len(room.gaussians):,} of {len(self.gaussians):,} Gaussians are needed by the photographs")
        room, things = self.cages(room, held)  # before what they hid: an object without a cage is not taken away
        self.say(f"objects: {', '.join(room.names) or 'none'}")
        rest = self.inpaint(room)
        self.finish(room, rest, things)

    def train(self) -> None:
        """Poses, if there are none, and Gaussians."""
        o = self.options
        steps = o.steps or STEPS[running_arch()]
        capture, self.marks, self.masks = photographed(o, self.stages, self.say, self.length)
        self.reduce = o.reduce or default_reduction(capture)
        if running_arch() == "cpu":
            width, height = image_size(capture.views[0].image)
            small = f"{steps:,} steps on photographs of {width // self.reduce}x{height // self.reduce} pixels"
            gpu = (
                f"a GPU takes {STEPS['cuda']:,} steps on all {width}x{height} pixels, in about 4 minutes for everything"
            )
            self.say(f"on this CPU: {small} (--steps, --reduce); {gpu}")

        def make(folder: Path) -> None:
            training = train.TrainOptions(
                capture=o.capture,
                out=folder / "trained.ply",
                report=folder / "trained.json",
                fast=True,
                steps=steps,
                reduce=self.reduce,
                cap=o.cap,
                masks=self.masks or train.NO_MASKS,
                seed=o.seed,
                arch=o.arch,
            )
            train.train(training, capture)
            end_taichi()  # and with it the memory of the training
            start_taichi(o.arch, o.seed)

        inputs = {"steps": steps, "reduce": self.reduce, "cap": o.cap, "seed": o.seed, **capture_key(capture)}
        if self.masks is not None:
            inputs["masks"] = [file_key(p) for p in sorted(self.masks.iterdir())]
        done = self.stages.run("train", inputs, make, source_digest("commands.train"))
        self.turn, self.capture = rotation_between(capture.up, (0.0, 1.0, 0.0)), capture.upright()
        self.gaussians = read_gaussians(done / "trained.ply", self.say)
        self.training = json.loads((done / "trained.json").read_text(encoding="utf-8"))

    def look(self) -> Contributions:
        """Contributions of the Gaussians to the photographs."""

        def make(folder: Path) -> None:
            found = contributions(self.gaussians, self.capture.cameras(), self.stages.progress)
            np.savez(folder / "seen.npz", weight=found.weight, depth=found.depth)

        done = self.stages.run("cameras", {}, make, self.source)
        with np.load(done / "seen.npz", allow_pickle=False) as file:
            return Contributions(file["weight"], file["depth"])

    def segment(self) -> None:
        """Objects of the Gaussians: learned from given masks, or from masks that marks spread to, or none."""
        g, progress = self.gaussians, self.stages.progress
        if self.options.no_objects:
            self.stages.run("objects", {"none": True}, lambda folder: None, self.source)
            self.gaussians = replace(g, object_id=np.zeros_like(g.object_id), objects=())
            return

        def make(folder: Path) -> None:
            known, capture, reduce = g, self.capture, self.reduce
            if self.marks is None:
                capture, masks = masks_of(capture, self.masks, self.say)
                photographs = load_photographs(capture.views, reduce, masks.ids)
            else:
                masks = propagate_marks(capture, load_photographs(capture.views, reduce), self.marks, g, progress)
                photographs = load_photographs(capture.views, reduce, masks.ids)
                known = learned_objects(g, capture, photographs, masks.names, progress)
            known = room_pipeline.without_supports(known, capture, progress)
            known = trained_alone(known, capture, photographs, progress)
            write_gaussians(folder / "objects.ply", background_around(known, capture, photographs, progress))

        inputs = {"marks": None if self.marks is None else marks_json(self.marks)}
        done = self.stages.run("objects", inputs, make, self.source)
        self.gaussians = read_gaussians(done / "objects.ply", self.say)

    def cages(self, room: PlacedRoom, held: list[Support]) -> tuple[PlacedRoom, Bodies]:
        """The room with the objects that have a body, and these."""
        o = self.options
        vertices = (o.vertices,) if o.vertices else device_vertices(animated=False)
        inputs = {"vertices": vertices, "material": o.material, "scale_points": o.scale_points}

        def make(folder: Path) -> None:
            found, lost = room_pipeline.bodies(
                room, held, vertices=vertices, material=o.material, progress=self.stages.part, say=self.say
            )
            make_folder(folder / "objects")
            for asset, thing in found:
                asset.save(folder / thing.asset)
            made = {"objects": [to_plain(thing) for _, thing in found], "lost": lost}
            (folder / "objects.json").write_text(json.dumps(made), encoding="utf-8")

        done = self.stages.run("cages", inputs, make, self.source)
        made = json.loads((done / "objects.json").read_text(encoding="utf-8"))
        things = from_plain(list[RoomObject], made["objects"], str(done))
        room = room_pipeline.without_objects(room, made["lost"], self.say)
        return room, [(Asset.load(done / thing.asset), thing) for thing in things]

    def inpaint(self, room: PlacedRoom) -> Gaussians:
        """The background, closed where objects stood."""
        lama = self.options.lama

        def make(folder: Path) -> None:
            painter = LamaNetwork(lama) if lama else None
            rest = room_pipeline.inpainted(room, self.stages.part, self.say, painter)
            write_gaussians(folder / "background.ply", rest)

        done = self.stages.run("inpaint", {"lama": str(lama) if lama else None}, make, self.source)
        return read_gaussians(done / "background.ply", self.say)

    def finish(self, room: PlacedRoom, rest: Gaussians, things: Bodies) -> None:
        """The collider, the report, and the folder as it is played; its manifest is written last."""

        def make(folder: Path) -> None:
            made = room_pipeline.background(room, rest, things, cell=self.options.cell, progress=self.stages.progress)
            made.save(folder / "room.h5")

        done, out = self.stages.run("room", {"cell": self.options.cell}, make, self.source), self.options.out
        (out / MANIFEST).unlink(missing_ok=True)  # until all parts are there this is no room
        shutil.rmtree(out / "objects", ignore_errors=True)
        make_folder(out / "objects")
        copies = {"room.h5": done / "room.h5"} | {t.asset: self.stages.folder / "cages" / t.asset for _, t in things}
        for name, source in copies.items():
            with atomic_write(out / name) as beside:
                shutil.copyfile(source, beside)
        about = {"seconds": self.stages.seconds, "training": self.training, "notes": self.notes}
        images = [view.image for view in self.capture.views]
        write_report(out, room, Asset.load(out / "room.h5"), things, images, about)
        write_room(out, room_pipeline.manifest(room, [thing for _, thing in things]))


def photographed(
    options: CaptureOptions, stages: Stages, say: Say, length: MeasuredLength | None
) -> tuple[Capture, Marks | None, Path | None]:
    """The capture with poses, in the frame of its files, and its objects as of `objects_of`. Raises BadInput.

    What is wrong with the objects, or with a measured length, is said before poses are found.
    """
    posed, is_video = is_posed(options.capture), options.capture.is_file()
    if posed:
        capture = read_posed(options.capture, say)
        place = capture.folder / MARKS
    else:
        capture = Capture(*photographs_of(options.capture, stages, say))
        place = (options.out if is_video else options.capture) / MARKS
    sizes = {view.name: image_size(view.image) for view in capture.views}
    if length:
        length.check(sizes)
    marks, masks = objects_of(options, capture, sizes, place, say)
    if not posed:
        capture = with_poses(capture.folder, capture.views, stages, say, in_order=is_video)
        marks = marks and marks_in(marks, [view.name for view in capture.views], say)
    return capture, marks, masks


def default_reduction(capture: Capture) -> int:
    """By how much the sides of the photographs are divided where the user does not say it."""
    longest = max(max(image_size(view.image)) for view in capture.views)
    return -(-longest // CPU_SIDE) if running_arch() == "cpu" else 1


def objects_of(
    options: CaptureOptions, capture: Capture, sizes: dict[str, tuple[int, int]], place: Path, say: Say
) -> tuple[Marks | None, Path | None]:
    """Marks of objects, or the folder of their masks, checked against the photographs; neither for --no-objects.

    Without any the user is asked, and `place` receives the marks. Raises BadInput.
    """
    if options.no_objects:
        return None, None
    marks = options.marks or (place if options.masks is None and place.is_file() else None)
    if marks is not None:
        return read_marks(marks, sizes), None
    masks = options.masks or masks_beside(capture, say)
    if masks is not None:
        read_masks(masks, capture.views)
        return None, masks
    from display.window.gl_window import has_display

    if not has_display():
        raise BadInput(
            "no marked objects, and no display to mark them on: give --marks MARKS.json or --masks FOLDER, or "
            "--no-objects for the room alone"
        )
    return marked_photographs(capture, sizes, place), None


def marks_in(marks: Marks, names: list[str], say: Say) -> Marks:
    """The marks in photographs with these names, those whose poses were found. Raises BadInput if an object has none
    left."""
    kept = {}
    for name, views in marks.objects.items():
        lost = sorted(set(views) - set(names))
        kept[name] = {view: m for view, m in views.items() if view in names}
        where = f"{', '.join(lost[:3])}{' and others' if len(lost) > 3 else ''}"
        if not any(m.inside or m.boxes for m in kept[name].values()):
            other = f"mark it in another photograph, such as {names[0]}"
            raise BadInput(f"{name!r} is marked only in {where}, whose pose was not found; {other}")
        if lost:
            say(f"{name}: its marks in {where} are not used: no pose was found")
    return Marks(kept)


def capture_key(capture: Capture) -> dict:
    """All that a training takes from a capture, as JSON: if any of it changes, it is made anew."""
    views = []
    for view in capture.views:
        files = [file_key(path) for path in (view.image, view.mask) if path is not None]
        views.append([files, asdict(view.lens), view.world_to_camera.tolist()])
    points = hashlib.sha256(capture.points.tobytes() + capture.colors.tobytes()).hexdigest()
    return {"views": views, "points": points}


def write_report(out: Path, room: PlacedRoom, rest: Asset, things: list, photographs: list, about: dict) -> None:
    """Write report.html, and the picture for the menu of scenes, to a room's folder. Raises BadInput.

    rest         the background, `things` (asset, place) of each object
    photographs  files of the photographs, in the order of the room's cameras
    about        "seconds" by stage, "training" (its report) and "notes", lines
    """
    import cv2

    whole = room_pipeline.with_objects(rest.gaussians, things)
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
