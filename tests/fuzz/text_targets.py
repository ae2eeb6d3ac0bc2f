"""Readers of JSON and of captures, with sound samples."""

import contextlib
import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.vocabulary import Light
from display.preferences import Bookmarks, PathText, Preferences
from display.web.page_messages import read_message
from prepare.train.capture_files import read_capture
from prepare.train.photographs import load_photograph
from tests.fuzz.mutations import BYTES, TEXT, Files, mutated_json, several
from tests.prepare.test_captures import binary_model, text_model, transforms, write_images
from tests.support.splat_encoders import ply_bytes


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


def inside_capture(rng: np.random.Generator, files: Files) -> Files:
    if "transforms.json" in files:
        return files | {"transforms.json": mutated_json(rng, files["transforms.json"])}
    return several(BYTES + TEXT)(rng, files)


def read_whole_capture(path: Path) -> None:
    capture = read_capture(path if path.suffix == ".json" else path.parents[2])
    load_photograph(capture.views[0])
    assert np.isfinite([*capture.middle, capture.extent, *capture.up, *capture.upright().points.ravel()]).all()
