"""`vrgs.py capture`: photographs become a room to play in, with objects that can be grabbed."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, locked_folder, make_folder
from commands import train
from commands.capture_input import capture_key, photographed, stages_before
from commands.conditions import Condition
from commands.options import add_arch, positive
from core.errors import BadInput
from core.material import MATERIALS
from core.rotation import rotation_between
from core.runtime import end_taichi, start_taichi
from prepare.room_capture.stages import Stages, file_key, source_digest
from prepare.segment.marks import marks_json
from prepare.segment.mask_files import photograph_size

HELP = "turn photographs into a room to play in: its objects can be grabbed, and what they hid is filled in"
EXAMPLES = (
    "capture bear/ --marks marks.json --out bear_room/          then: python vrgs.py --scene bear_room/",
    "capture kitchen.mp4 --no-objects --out kitchen/            only the room; needs pycolmap",
    "capture toys/ --masks toys/masks --out room/ --steps 2000 --reduce 2",
    "capture bear/ --marks m.json --out r/ --scale-points frame_00001.jpg:210,380 frame_00001.jpg:310,385 0.46",
)
STAGES = ("train", "cameras", "objects", "cages", "inpaint", "room")
TRAINED = "trained.ply"
STEPS = {"cuda": 10_000, "cpu": 3_000}
CONDITIONS = (
    Condition(("--lama", "--vertices", "--material"), lambda args: not args.no_objects, "is not for --no-objects"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "folder with transforms.json or a COLMAP model, a transforms.json, folder of photographs, or a video"
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help=text)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="ROOM/", help="folder of the room; an interrupted run resumes there"
    )
    which = parser.add_mutually_exclusive_group()
    text = "marks of objects in some photographs (default: CAPTURE/marks.json, else CAPTURE/masks, else a window opens)"
    which.add_argument("--marks", type=Path, metavar="MARKS.json", help=text)
    text = "folder of masks, one colour per object"
    which.add_argument("--masks", type=Path, metavar="FOLDER", help=text)
    which.add_argument("--no-objects", action="store_true", help="only the room; nothing in it can be grabbed")
    text = (
        "two points, each PHOTOGRAPH:x,y [px] or x,y,z in the capture, and their distance [m] (default: guessed scale)"
    )
    parser.add_argument("--scale-points", nargs=3, metavar=("A", "B", "M"), help=text)
    text = f"steps of the training (default {STEPS['cuda']} on a GPU, {STEPS['cpu']} on a CPU)"
    parser.add_argument("--steps", type=positive(int), metavar="N", help=text)
    text = "divide width and height of the photographs by N"
    parser.add_argument("--reduce", type=positive(int), default=1, metavar="N", help=text)
    text = f"upper limit of Gaussians (default {train.CAPS['cuda']:,} on a GPU, {train.CAPS['cpu']:,} on a CPU)"
    parser.add_argument("--cap", type=positive(int), metavar="N", help=text)
    text = "vertices of each object's cage (default: as suits the device)"
    parser.add_argument("--vertices", type=positive(int), metavar="N", help=text)
    text = "material of all objects (default: plush, light enough to lift; see: vrgs.py materials)"
    parser.add_argument("--material", metavar="NAME", help=text)
    text = "LaMa network that fills the holes behind objects (default: patch synthesis)"
    parser.add_argument("--lama", type=Path, metavar="FILE.onnx", help=text)
    text = "spacing of the room's distance grid (default: by size)"
    parser.add_argument("--cell", type=positive(float), metavar="M", help=text)
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of all random numbers (default 0)")
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Make the room, stage by stage. Raises BadInput before anything long where an input is at fault."""
    make_room(args)
    print(f"{args.out}: play it with: python vrgs.py --scene {args.out}")


def make_room(args: argparse.Namespace) -> None:
    """Make the room of a capture in the folder `args.out`. Raises BadInput, also if another run writes there."""
    check(args)
    with locked_folder(args.out):  # two runs would remove each other's stages
        start_taichi(args.arch, args.seed)
        stages = Stages(args.out / "work", (*stages_before(args.capture), *STAGES))
        RoomMaking(args, stages).make()


def room_arguments(capture: Path, room: Path, arch: str | None, seed: int) -> argparse.Namespace:
    """Arguments of the command for a capture and its room, all else as usual."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    words = [str(capture), "--out", str(room), "--seed", str(seed), *(["--arch", arch] if arch else [])]
    return parser.parse_args(words)


def check(args: argparse.Namespace) -> None:
    """Check what can be checked before anything long. Raises BadInput."""
    if not args.capture.exists():
        raise BadInput(f"{args.capture}: no such file or folder")
    if args.out.exists() and not args.out.is_dir():
        raise BadInput(f"{args.out}: is a file; a room is a folder")
    if args.material is not None and args.material not in MATERIALS:
        raise BadInput(f"no material named {args.material!r}; see: vrgs.py materials")
    for path in filter(None, (args.marks, args.masks, args.lama)):
        if not path.exists():
            raise BadInput(f"{path}: no such file or folder")
    if args.lama:
        from prepare.onnx_network import LamaNetwork

        LamaNetwork(args.lama)  # needed in an hour, perhaps
    if args.scale_points:
        for text in args.scale_points[:2]:
            parsed_point(text)
        parsed_length(args.scale_points[2])


def parsed_length(text: str) -> float:
    """A length [m]. Raises BadInput."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise BadInput(f"--scale-points: {text!r} is no length in metres")
    return value


def parsed_point(text: str) -> tuple[str, list[float]]:
    """A photograph's name and two numbers, or "" and three. Raises BadInput."""
    name, _, numbers = text.rpartition(":")
    try:
        values = [float(x) for x in numbers.split(",")]
    except ValueError:
        values = []
    if len(values) != (2 if name else 3) or not np.isfinite(values).all():
        raise BadInput(f"--scale-points: {text!r} is neither PHOTOGRAPH:x,y nor x,y,z")
    return name, values


def check_points(scale_points: list[str] | None, sizes: dict[str, tuple[int, int]]) -> None:
    """Check that points of --scale-points lie in their photographs, by name (width, height) [px]. Raises BadInput."""
    for text in (scale_points or [])[:2]:
        name, (x, y, *_) = parsed_point(text)
        if name and name not in sizes:
            raise BadInput(
                f"--scale-points: there is no photograph {name}; there are: {', '.join(list(sizes)[:5])} ..."
            )
        if name and not (0 <= x < sizes[name][0] and 0 <= y < sizes[name][1]):
            width, height = sizes[name]
            raise BadInput(f"--scale-points: {name} has {width}x{height} pixels: {x:g},{y:g} is none of them")


class RoomMaking:
    """The stages of a room, each with what it needs of those before it."""

    def __init__(self, args: argparse.Namespace, stages):
        self.args, self.stages, self.notes = args, stages, []
        self.source = source_digest("commands.capture_room")

    def say(self, text: str) -> None:
        """Tell the user, and note it for the report."""
        self.notes.append(text)
        print(text, file=sys.stderr, flush=True)

    def make(self) -> None:
        """All stages. Raises BadInput."""
        from prepare.room_capture.room_pipeline import held_objects, placed_room

        self.train()
        found = self.look()
        self.segment()
        room = placed_room(self.gaussians, self.capture, found, **self.measured())
        for line in room.orientation.described():
            self.say(line)
        room, held = held_objects(room, self.say)
        self.say(f"{len(room.gaussians):,} of {len(self.gaussians):,} Gaussians are needed by the photographs")
        room, things = self.cages(room, held)  # before what they hid: an object without a cage is not taken away
        self.say(f"objects: {', '.join(room.names) or 'none'}")
        rest = self.inpaint(room)
        self.finish(room, rest, things)

    def train(self) -> None:
        """Poses, if there are none, and Gaussians."""
        import taichi as ti

        from assets.splat_files import read_gaussians

        a = self.args
        steps = a.steps or STEPS["cuda" if ti.cfg.arch == ti.cuda else "cpu"]
        options = {"steps": steps, "reduce": a.reduce, "cap": a.cap, "seed": a.seed}
        given = photographed(a, self.stages, self.say, self.check_points)
        self.marks, self.masks = given.marks, given.masks

        def arguments(folder: Path) -> argparse.Namespace:
            parser = argparse.ArgumentParser()
            train.add_arguments(parser)
            words = [str(a.capture), "--fast", "--out", str(folder / TRAINED), "--report", str(folder / "trained.json")]
            for key, value in options.items():
                words += [f"--{key}", str(value)] if value is not None else []
            words += ["--masks", str(self.masks or train.NO_MASKS)]
            return parser.parse_args([*words, *(["--arch", a.arch] if a.arch else [])])

        def make(folder: Path) -> None:
            train.run(arguments(folder), given.capture)
            end_taichi()  # and with it the memory of the training
            start_taichi(a.arch, a.seed)

        inputs = {**options, **capture_key(given.capture)}
        if self.masks is not None:
            inputs["masks"] = [file_key(p) for p in sorted(self.masks.iterdir())]
        done = self.stages.run("train", inputs, make, source_digest("commands.train"))
        self.turn, self.capture = rotation_between(given.capture.up, (0.0, 1.0, 0.0)), given.capture.upright()
        self.gaussians = read_gaussians(done / TRAINED, self.say)
        self.training = json.loads((done / "trained.json").read_text(encoding="utf-8"))

    def check_points(self, views: list) -> None:
        """Check points of --scale-points. Raises BadInput."""
        check_points(self.args.scale_points, {view.name: photograph_size(view)[::-1] for view in views})

    def look(self):
        """Contributions of the Gaussians to the photographs."""
        from prepare.room_capture.contributions import Contributions
        from prepare.room_capture.room_pipeline import seen_by_cameras

        def make(folder: Path) -> None:
            found = seen_by_cameras(self.gaussians, self.capture, self.stages.progress)
            np.savez(folder / "seen.npz", weight=found.weight, views=found.views, depth=found.depth)

        done = self.stages.run("cameras", {}, make, self.source)
        with np.load(done / "seen.npz", allow_pickle=False) as file:
            return Contributions(file["weight"], file["views"], file["depth"])

    def segment(self) -> None:
        """Objects of the Gaussians: learned from given masks, or now from masks that marks spread to, or none."""
        from assets.splat_files import read_gaussians, write_gaussians
        from prepare.room_capture.room_pipeline import without_supports

        g, progress = self.gaussians, self.stages.progress
        if self.args.no_objects:
            self.stages.run("objects", {"none": True}, lambda folder: None, self.source)
            self.gaussians = replace(g, object_id=np.zeros_like(g.object_id), objects=())
            return

        def make(into: Path) -> None:
            known = g if self.marks is None else self.learned_from_marks()
            write_gaussians(into / "objects.ply", without_supports(known, self.capture, progress))

        inputs = {"marks": None if self.marks is None else marks_json(self.marks)}
        done = self.stages.run("objects", inputs, make, self.source)
        self.gaussians = read_gaussians(done / "objects.ply", self.say)

    def learned_from_marks(self):
        """The Gaussians with objects that they learn from masks of all photographs, which marks in some spread to."""
        from prepare.segment.mask_propagation import propagate_marks
        from prepare.segment.object_ids import learned_objects
        from prepare.train.photographs import load_photographs

        views, g, progress = self.capture.views, self.gaussians, self.stages.progress
        photographs = load_photographs(views, self.args.reduce)
        masks = propagate_marks(self.capture, photographs, self.marks, g, progress)
        photographs = load_photographs(views, self.args.reduce, masks.ids)
        return learned_objects(g, self.capture, photographs, masks.names, progress)

    def measured(self) -> dict:
        """Points and length of --scale-points."""
        from prepare.room_capture.room_pipeline import point_in_photograph

        if not self.args.scale_points:
            return {}
        points = []
        for text in self.args.scale_points[:2]:
            name, values = parsed_point(text)
            if name:
                points.append(point_in_photograph(self.gaussians, self.capture, name, *values))
            else:
                points.append(self.turn @ np.array(values))
        return {"measured": tuple(points), "length": parsed_length(self.args.scale_points[2])}

    def cages(self, room, held) -> tuple:
        """The room with the objects that have a body, and these."""
        from assets.asset import Asset
        from assets.room_folder import RoomObject
        from prepare.prepared_files import device_vertices
        from prepare.room_capture.room_pipeline import bodies, without_objects

        a = self.args
        vertices = (a.vertices,) if a.vertices else device_vertices(animated=False)
        inputs = {"vertices": vertices, "material": a.material, "scale_points": a.scale_points}

        def make(folder: Path) -> None:
            options = {"vertices": vertices, "material": a.material, "progress": self.stages.part, "say": self.say}
            found, lost = bodies(room, held, **options)
            make_folder(folder / "objects")
            for asset, thing in found:
                asset.save(folder / thing.asset)
            made = {"objects": [asdict(thing) for _, thing in found], "lost": lost}
            (folder / "objects.json").write_text(json.dumps(made), encoding="utf-8")

        done = self.stages.run("cages", inputs, make, self.source)
        made = json.loads((done / "objects.json").read_text(encoding="utf-8"))
        rows = [{k: tuple(v) if isinstance(v, list) else v for k, v in row.items()} for row in made["objects"]]
        things = [RoomObject(**row) for row in rows]
        room = without_objects(room, made["lost"], self.say)
        return room, [(Asset.load(done / thing.asset), thing) for thing in things]

    def inpaint(self, room):
        """The background, closed where objects stood."""
        from assets.splat_files import read_gaussians, write_gaussians
        from prepare.room_capture.room_pipeline import inpainted

        a = self.args
        inputs = {"lama": str(a.lama) if a.lama else None}

        def make(folder: Path) -> None:
            painter = None
            if a.lama:
                from prepare.onnx_network import LamaNetwork

                painter = LamaNetwork(a.lama)
            write_gaussians(folder / "background.ply", inpainted(room, self.stages.part, self.say, painter))

        done = self.stages.run("inpaint", inputs, make, self.source)
        return read_gaussians(done / "background.ply", self.say)

    def finish(self, room, rest, things: list) -> None:
        """The collider, the report, and the folder as it is played; its manifest is written last."""
        from assets.asset import Asset
        from assets.room_folder import MANIFEST, write_room
        from commands.capture_report import write_report
        from prepare.room_capture.room_pipeline import background, manifest

        def make(folder: Path) -> None:
            background(room, rest, things, cell=self.args.cell, progress=self.stages.progress).save(folder / "room.h5")

        done, out = self.stages.run("room", {"cell": self.args.cell}, make, self.source), self.args.out
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
        write_room(out, manifest(room, [thing for _, thing in things]))
