"""Readers of files from users, with sound samples of what they read and mutations of these.

A case is a target, a seed and a number: `mutated(target, seed, number, folder)` is always the same file.
"""

import contextlib
import functools
import io
import json
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import trimesh

from assets.asset import Asset
from assets.camera_file import read_cameras
from assets.environment import Environment
from assets.formats.gltf import PIXELS_MAX, read_mesh, read_rig
from assets.images import decode_image, read_image_header
from assets.library import animated_height, asset_material, cage_vertices, default_material
from assets.mesh_gaussians import read_triangle_mesh, texture_colours
from assets.room_folder import read_room
from assets.splat_files import read_gaussians, write_gaussians
from commands.play import PlayOptions, take_options
from core.errors import BadInput
from core.vocabulary import Light
from display.keep.scene_state import game_values
from display.keep.state_file import read_state, write_state
from display.preferences import Bookmarks, PathText, Preferences
from display.record.recording import Replay
from display.study.study_file import Study, compare_study, overview, read_study, table, write_study
from display.study.trial import read_answers_file
from display.web.page_messages import read_message
from prepare.onnx_network import LamaNetwork
from prepare.progress import Checkpoints, arrays_of, gaussians_of
from prepare.rig.landmarks import read_landmarks
from prepare.segment.marks import drawn_boxes, drawn_strokes, read_marks, read_splat_marks
from prepare.segment.mask_files import read_masks
from prepare.train.capture import Lens, View
from prepare.train.capture_files import read_capture
from prepare.train.photographs import load_photograph
from prepare.train.trainer import read_checkpoint, write_checkpoint
from tests.display.test_recording import as_version_3, record, some_frames
from tests.display.test_study import some_study
from tests.fuzz.hdf5_mutations import claim_text, inside_hdf5
from tests.fuzz.mutations import (
    BYTES,
    JSON,
    TEXT,
    Files,
    Mutation,
    change_byte,
    inside_gzip,
    inside_zip,
    mutated_json,
    one_file,
    saved,
    several,
)
from tests.fuzz.sample_files import SomeGame, moving_body, record_some, some_stage, some_state
from tests.prepare.test_captures import binary_model, text_model, transforms, write_images
from tests.prepare.test_picture_inpainting import write_lama
from tests.support import splat_encoders as encode
from tests.support.glb import bar, packed
from tests.support.samples import some_gaussians
from tests.support.splat_encoders import ply_bytes, sog_files


def silent(line: str) -> None:
    """Take a report."""


def splat_samples(suffix: str) -> Callable[[Path], list[Files]]:
    def samples(folder: Path) -> list[Files]:
        g = some_gaussians(14, 1)
        match suffix:
            case ".ply":
                text = np.array(list(encode.properties(g).values())).T
                forms = [encode.ply_bytes(encode.properties(some_gaussians(9, d))) for d in (0, 3)]
                forms += [encode.compressed_bytes(some_gaussians(270, 1)), encode.compressed_bytes(g, order=">")]
                names = encode.properties(g)
                head = ["ply", "format ascii 1.0", f"element vertex {len(g)}", *(f"property float {n}" for n in names)]
                lines = [" ".join(f"{v:.5g}" for v in row) for row in text]
                forms.append("\n".join([*head, "end_header", *lines, ""]).encode())
            case ".splat":
                forms = [encode.splat_bytes(g)]
            case ".ksplat":
                forms = [encode.ksplat_bytes([some_gaussians(20, 1)], level) for level in (0, 1, 2)]
            case ".spz":
                version_3 = saved(folder, "s.spz", lambda path: write_gaussians(path, g))["s.spz"]
                forms = [version_3, encode.spz_4_bytes(version_3)]
                forms.append(encode.spz_bytes(1, b"\0\0\0\x3c\0\0", rotation=b"\x80" * 3))
            case _:
                forms = [encode.zipped(encode.sog_files(g, version)) for version in (1, 2)]
        return [{f"splat{suffix}": data} for data in forms]

    return samples


def read_splat(path: Path) -> None:
    read_gaussians(path, silent).check(str(path))


def inside_sog(rng: np.random.Generator, files: Files) -> Files:
    if "meta.json" in files and rng.random() < 0.5:
        return files | {"meta.json": mutated_json(rng, files["meta.json"])}
    return several(BYTES)(rng, files)


def mesh_samples(folder: Path) -> list[Files]:
    """A box in each of the formats of triangle meshes, one of them with a texture."""
    box = trimesh.creation.box()
    kinds = ("obj", "stl", "off", "ply", "glb")
    made = [box.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {})) for kind in kinds]
    texts = [text.encode() if isinstance(text, str) else text for text in made]
    found = [{f"mesh.{kind}": text} for kind, text in zip(kinds, texts, strict=True)]
    uv = b"".join(b"vt %.2f %.2f\n" % (k / 8, 1 - k / 8) for k in range(8))
    faces = b"".join(b"f " + b" ".join(b"%d/%d" % (v + 1, v + 1) for v in face) + b"\n" for face in box.faces.tolist())
    points = b"".join(b"v %.2f %.2f %.2f\n" % tuple(v) for v in box.vertices.tolist())
    material = b"newmtl m\nKd 0.5 0.4 0.3\nmap_Kd image.png\n"
    textured = b"mtllib mesh.mtl\nusemtl m\n" + points + uv + faces
    found.append({"mesh.obj": textured, "mesh.mtl": material, "image.png": image_samples(folder)[0]["image.png"]})
    return found


def read_mesh_file(path: Path) -> None:
    for part in read_triangle_mesh(path):
        with np.errstate(all="ignore"):
            texture_colours(part, np.zeros(3, int), np.full((3, 3), 1 / 3), 0.01)


def glb_samples(folder: Path) -> list[Files]:
    builder, scene = bar()
    return [{"rig.glb": packed(json.dumps(scene).encode(), builder.binary)}]


def splat_glb_samples(folder: Path) -> list[Files]:
    """Splats with objects, and a chain of nodes of which one stretches."""
    g = some_gaussians(14, 1)
    g = replace(g, object_id=np.arange(14).astype(np.uint16) % 2, objects=("bear",), sort="pixel", antialias=True)
    written = saved(folder, "s.glb", lambda path: write_gaussians(path, g))["s.glb"]
    size = int.from_bytes(written[12:16], "little")
    scene = json.loads(written[20 : 20 + size])
    turned = {"rotation": [0, 0.6, 0, 0.8], "scale": [1, 2, -1], "children": [1], "translation": [1, 2, 3]}
    scene["nodes"] = [turned, {"mesh": 0, "matrix": np.eye(4).ravel().tolist()}, {"mesh": 1, "name": "cup"}]
    return [{"s.glb": written}, {"s.glb": packed(json.dumps(scene).encode(), written[28 + size :])}]


def inside_glb(rng: np.random.Generator, files: Files) -> Files:
    """The JSON or the buffer of a .glb mutated, in a sound container."""
    ((name, data),) = files.items()
    size = int.from_bytes(data[12:16], "little")
    text, binary = data[20 : 20 + size], data[28 + size :]
    if rng.random() < 0.7:
        text = mutated_json(rng, text)
    else:
        binary = several(BYTES)(rng, {"": binary})[""]
    return {name: packed(text, binary)}


def read_skinned_glb(path: Path) -> None:
    rig, file = read_rig(path)
    read_mesh(file, len(rig.joints))


def image_samples(folder: Path) -> list[Files]:
    pixels = np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)
    kinds = (".png", ".jpg", ".webp")
    return [{f"image{kind}": cv2.imencode(kind, pixels)[1].tobytes()} for kind in kinds]


def read_image(path: Path) -> None:
    data = path.read_bytes()
    header = read_image_header(data)
    if header is not None and 0 < header.width * header.height <= PIXELS_MAX:
        decode_image(data)


def json_samples(name: str, *values) -> Callable[[Path], list[Files]]:
    return lambda folder: [{name: json.dumps(value).encode()} for value in values]


CAMERA = {"width": 16, "height": 8, "fx": 20, "fy": 20.5, "cx": 8, "cy": -4, "world_to_camera": np.eye(4).tolist()}
ANSWERS = {"format": "vrgs-answers", "participant": "Ida", "setting": "physics", "answers": {"realism": 6, "ease": 0}}
LANDMARKS = {
    "head_top": [0, 1.7, 0.0],
    "held": [{"by": "left_hand", "center": [0.3, 1, 0], "radius": 0.1}],
    "joints": {"Hips": "pelvis"},
}


PREFERENCES = {
    "window.size": [800, 600],
    "window.place": [0, -20],
    "panel.open": True,
    "panel.sections": {"Light": False},
    "light.ring_toss": {"position": [1, 2, 3], "strength": 0.5},
    "bookmarks.ring_toss": {"1": [[0, 1.6, 1], [0, 0.8, 0]]},
    "folder": "/films",
}


def read_preferences(path: Path) -> None:
    """Read settings, and one of each kind; what is damaged is told and set aside, and the program goes on."""
    with contextlib.redirect_stderr(io.StringIO()) as said:
        preferences = Preferences(path)
        for key, kind in (
            ("window.size", tuple[float, float]),
            ("panel.open", bool),
            ("folder", PathText),
            ("panel.sections", dict[str, bool]),
            ("light.ring_toss", Light),
            ("bookmarks.ring_toss", Bookmarks),
        ):
            preferences.get(key, kind)
        preferences.set("sound", False)
    assert said.getvalue().count("\n") <= 1 and Preferences(path).get("sound", bool, True) is False
    for aside in path.parent.glob("*.broken*"):
        aside.unlink()


MESSAGES = (
    ["move", 0.5, 0.4, 1000],
    ["button", "left", True, 0.5, 0.5, 1000],
    ["panel", "Light", "shadow", 0.5, False],
    ["panel", "Play", "Pause", True, False],
    ["open", "manipulation", {"animal": "fox"}],
    ["key", "KeyP", "p", True, False, 10],
    ["shown", 4, None],
)


def read_page_message(path: Path) -> None:
    try:
        read_message(path.read_bytes().decode("utf-8", "surrogatepass"))
    except (BadInput, UnicodeDecodeError) as e:  # the server closes the connection
        raise BadInput(f"{path}: {type(e).__name__}") from e


def capture_samples(folder: Path) -> list[Files]:
    """Photographs with a transforms.json, and COLMAP models as text and binary."""
    found = []
    for make in (None, text_model, binary_model):
        with tempfile.TemporaryDirectory() as place:
            root = Path(place)
            write_images(root)
            if make is None:
                (root / "transforms.json").write_text(json.dumps(transforms(ply_file_path="points.ply")))
                points = {name: np.arange(6, dtype=np.float32) for name in ("x", "y", "z")}
                (root / "points.ply").write_bytes(ply_bytes(points))
            else:
                make(root)
            files = {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}
        first = next(name for name in files if "transforms" in name or "cameras" in name)
        found.append({first: files.pop(first), **files})
    return found


def inside_first(rng: np.random.Generator, files: Files) -> Files:
    name = next(iter(files))
    if name.endswith(".json"):
        return files | {name: mutated_json(rng, files[name])}
    return several(BYTES + TEXT)(rng, files)


def first_json(folder: Path) -> list[Mutation]:
    return [inside_first]


def read_whole_capture(path: Path) -> None:
    capture = read_capture(path if path.suffix == ".json" else path.parents[2])
    load_photograph(capture.views[0])
    assert np.isfinite([*capture.middle, capture.extent, *capture.up, *capture.upright().points.ravel()]).all()


def read_network(path: Path) -> None:
    LamaNetwork(path)(np.full((16, 16, 3), 0.5, np.float32), np.eye(16) > 0)


def room_samples(folder: Path) -> list[Files]:
    """A captured room; only that its assets are there is checked."""
    toy = {"name": "toy", "asset": "objects/toy.h5", "position": [0, 0, 1.5], "rotation": [1, 0, 0, 0]}
    room = {"format": "vrgs-room", "version": 1, "background": "room.h5", "objects": [toy | {"fixed_below": 0.1}]}
    room |= {"eye": [0, 1.6, 0], "target": [0, 0.8, 1], "fov_y": 1.2, "floor": 0.1, "metres_per_unit": 0.5}
    room |= {"room_from_capture": np.eye(4).tolist(), "cameras": [CAMERA]}
    return [{"room.json": json.dumps(room).encode(), "room.h5": b"1", "objects/toy.h5": b"1"}]


MARKED = {"bear": {"v": {"inside": [[[1, 2.5], [3, 4]]], "outside": [[[5, 6]]], "boxes": [[1, 1, 5, 5.5]]}}}
MARKS = {"views": {"v": CAMERA}, "objects": MARKED, "grow": {"bear": 1}}


def read_marks_file(path: Path) -> None:
    """As marks on photographs, and on pictures of a splat; draw them."""
    for marks in (read_marks(path, {"v": (16, 8)}), read_splat_marks(path).marks):
        for view in marks.objects["bear"].values() if "bear" in marks.objects else ():
            drawn_strokes(view.inside + view.outside, (8, 16))
            drawn_boxes(view.boxes, (8, 16))


def masks_samples(folder: Path) -> list[Files]:
    """Masks of three photographs with the names of their objects."""
    grey, mask = np.full((8, 16, 3), 90, np.uint8), np.zeros((8, 16, 3), np.uint8)
    mask[:4, :8], mask[5:] = (30, 20, 10), (3, 2, 1)
    files = {"objects.json": json.dumps({"bear": [10, 20, 30], "cup": [1, 2, 3]}).encode()}
    for k in range(3):
        files[f"{k}.png"] = cv2.imencode(".png", mask)[1].tobytes()
        files[f"images/{k}.png"] = cv2.imencode(".png", grey)[1].tobytes()
    return [files]


def read_mask_folder(path: Path) -> None:
    lens = Lens(16, 8, 20.0, 20.0, 8.0, 4.0)
    read_masks(path.parent, [View(path.parent / f"images/{k}.png", lens, np.eye(4)) for k in range(3)])


def samples(name: str, *save: Callable[[Path], object]) -> Callable[[Path], list[Files]]:
    """A sample from each of the functions, which write a file."""
    return lambda folder: [saved(folder, name, write) for write in save]


def with_variable_texts(path: Path) -> None:
    """An asset whose texts are of variable length, as in files before 2026."""
    moving_body().save(path)
    with h5py.File(path, "r+") as file:
        for node in (file, *(file[name] for name in file)):
            for key, value in node.attrs.items():
                if isinstance(value, bytes):
                    node.attrs[key] = value.decode()


ASSETS = [lambda path, m=m, q=q: m().save(path, quantised=q) for m in (moving_body, some_stage) for q in (0, 1)]


def read_asset(path: Path) -> None:
    """Load an asset in each of the ways of the program."""
    for look in (asset_material, animated_height, cage_vertices, default_material, Environment.load):
        try:
            look(str(path))
        except BadInput as e:
            assert "\n" not in str(e)
    asset = Asset.load(path)
    if asset.animation is not None:
        asset.animation.matrices(0.3)


def interrupted(path: Path) -> None:
    """The journal of a recording, as an interrupted session leaves it."""
    recording = record(path.with_name("other.h5"), some_frames(24), close=False)
    recording.flush()
    path.write_bytes(recording.part.read_bytes())
    recording.close()
    recording.path.unlink()


def read_recording(path: Path) -> None:
    """Load a recording, and take over its options."""
    replay = Replay.load(path)
    take_options(PlayOptions(scene=str(replay.about.get("scene"))), replay.about, path, "recording was made")
    replay.world_options({})


STUDIES = [lambda path: write_study(path, some_study()), lambda path: write_study(path, Study())]


def read_and_compare_study(path: Path) -> None:
    study = read_study(path)
    overview(study)
    list(table(compare_study(study)))


def read_saved_state(path: Path) -> None:
    """Read a state, and what its game was."""
    state = read_state(path)
    with contextlib.suppress(BadInput):
        if state.settings.game is not None:
            game_values(SomeGame(), state.settings.game)


def training_state() -> dict[str, np.ndarray]:
    """The state of a training with poses."""
    shapes = {"mean": (5, 3), "logit": (5,), "first": (5, 11), "sh": (5, 4, 3)}
    state = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    state |= {"pose": np.zeros((4, 3, 6)), "pose_steps": np.zeros(4, np.int64), "done": np.array([7])}
    return state | {"queue": np.arange(3, dtype=np.int32), "rng": np.arange(4, dtype=np.uint64)}


def write_training(path: Path) -> None:
    write_checkpoint(path, training_state(), {"degree": 1})


def read_training(path: Path) -> None:
    read_checkpoint(path, {"degree": 1}, training_state(), 4)


def write_step(path: Path) -> None:
    """A kept step of a preparation."""
    with open(path, "wb") as file:
        np.savez(file, **arrays_of(some_gaussians(20, 1), up="+y", counts={"read": 20}))


def read_step(path: Path) -> None:
    """Take up a kept step: its arrays, or it is made again; the pipeline bears these errors of what they hold."""
    checkpoints = Checkpoints()
    checkpoints.folder = path.parent
    arrays = checkpoints.step(path.stem, lambda: {})
    with contextlib.suppress(LookupError, TypeError, ValueError):  # then the pipeline begins anew
        gaussians_of(arrays)[0].check(str(path))


@dataclass(frozen=True)
class Target:
    """A reader.

    samples  sound files, made in a folder; the first name of each is what is read
    read     read a file and use it as the program would; raises BadInput, and nothing else
    inside   mutations of what the file holds, tried as often as those of its bytes; made in a folder
    """

    name: str
    samples: Callable[[Path], list[Files]]
    read: Callable[[Path], object]
    inside: Callable[[Path], list[Mutation]] = lambda folder: []


def mutated(target: Target, seed: int, number: int, folder: Path) -> Files:
    """The files of a case."""
    rng = np.random.default_rng([seed, zlib.crc32(target.name.encode()), number])
    samples = sound_samples(target.name, folder)
    files = dict(samples[rng.integers(len(samples))])
    inside = target.inside(folder)
    outside = BYTES + (TEXT if rng.random() < 0.5 else []) + ([claim_text] if target.inside is in_hdf5 else [])
    return several(inside if inside and rng.random() < 0.6 else outside)(rng, files)


@functools.cache
def sound_samples(name: str, folder: Path) -> list[Files]:
    """The samples of a target, made once a process; all of them are read without an error."""
    target, found = TARGETS[name], []
    for files in target.samples(folder):
        write(folder, files)
        target.read(folder / next(iter(files)))
        found.append(files)
        for entry in files:
            (folder / entry).unlink()
    return found


def write(folder: Path, files: Files) -> None:
    """Write the files, with the folders that they name."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def in_hdf5(folder: Path) -> list[Mutation]:
    return [inside_hdf5(folder)]


def in_json(folder: Path) -> list[Mutation]:
    return JSON


TARGETS = {
    target.name: target
    for target in (
        Target("ply", splat_samples(".ply"), read_splat),
        Target("splat", splat_samples(".splat"), read_splat),
        Target("ksplat", splat_samples(".ksplat"), read_splat),
        Target("spz", splat_samples(".spz"), read_splat, lambda folder: [inside_gzip]),
        Target("sog", splat_samples(".sog"), read_splat, lambda folder: [inside_zip(inside_sog)]),
        Target(
            "meta.json",
            lambda _: [sog_files(some_gaussians(14, 1), k) for k in (1, 2)],
            read_splat,
            lambda folder: [inside_sog],
        ),
        Target("asset", samples("asset.h5", *ASSETS), read_asset, in_hdf5),
        Target("old asset", samples("asset.h5", with_variable_texts), read_asset, in_hdf5),
        Target("recording", samples("play.h5", record_some), read_recording, in_hdf5),
        Target(
            "old recording", samples("play.h5", lambda p: (record_some(p), as_version_3(p))), read_recording, in_hdf5
        ),
        Target("journal", samples("play.h5.part", interrupted), read_recording, lambda folder: BYTES + TEXT),
        Target("study", samples("study.h5", *STUDIES), read_and_compare_study, in_hdf5),
        Target("camera", json_samples("cam.json", CAMERA, [CAMERA, CAMERA]), read_cameras, in_json),
        Target("answers", json_samples("answers.json", ANSWERS), lambda path: read_answers_file(path, "now"), in_json),
        Target("landmarks", json_samples("l.json", LANDMARKS), read_landmarks, in_json),
        Target(
            "state", samples("scene.state.h5", lambda path: write_state(path, some_state())), read_saved_state, in_hdf5
        ),
        Target("preferences", json_samples("p.json", PREFERENCES, {}), read_preferences, in_json),
        Target("message", json_samples("m.json", *MESSAGES), read_page_message, in_json),
        Target("glb", glb_samples, read_skinned_glb, lambda folder: [inside_glb]),
        Target("splat glb", splat_glb_samples, read_splat, lambda folder: [inside_glb]),
        Target("mesh", mesh_samples, read_mesh_file, lambda folder: BYTES + TEXT),
        Target("capture", capture_samples, read_whole_capture, first_json),
        Target("training", samples("training.h5", write_training), read_training, in_hdf5),
        Target("image", image_samples, read_image),
        Target("network", samples("lama.onnx", write_lama), read_network, lambda folder: [one_file(change_byte)]),
        Target(
            "room", room_samples, lambda path: read_room(path.parent).transformed(np.eye(3), np.ones(3)), first_json
        ),
        Target("marks", json_samples("marks.json", MARKS), read_marks_file, in_json),
        Target("masks", masks_samples, read_mask_folder, first_json),
        Target("checkpoint", samples("step.npz", write_step), read_step, lambda folder: [inside_zip(several(BYTES))]),
    )
}
