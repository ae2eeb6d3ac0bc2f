"""Captures of few, many, grey, deep and unlike photographs, and without points: they train, or it is said why not."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from assets.splat_files import read_gaussians
from commands.train import TrainOptions, _lowering, _photographs
from core.errors import BadInput
from prepare.train.capture_files import read_capture
from prepare.train.photographs import kept_for_test, load_photographs
from prepare.train.seeds import RANDOM_COUNT, first_count
from tests.support.painted_capture import VIEWS, write_capture
from vrgs import main

OPTIONS = TrainOptions(capture=Path("room"), out=Path("room.ply"), reduce=2)


def changed(folder, change):
    """A painted capture whose frames `change(number, image, frame, data)` gives other images."""
    write_capture(folder)
    path = folder / "transforms.json"
    data = json.loads(path.read_text())
    for k, frame in enumerate(data["frames"]):
        file = str(folder / frame["file_path"])
        cv2.imwrite(file, change(k, cv2.imread(file), frame, data))
    path.write_text(json.dumps(data))
    return folder


def unlike(k: int, image: np.ndarray, frame: dict, data: dict) -> np.ndarray:
    """Every other photograph larger, with 16 bits, or a cut-out, grey; all from their own cameras."""
    if k % 3 == 1:
        sides = {"w": 96, "h": 96, "cx": 48, "cy": 48}
        frame.update(sides, fl_x=1.5 * data["fl_x"], fl_y=1.5 * data["fl_y"])
        return cv2.resize(image, (96, 96)).astype(np.uint16) * 257
    if k % 3 == 2:
        frame.update(w=64, h=40, cx=32, cy=20)
        return cv2.cvtColor(image[12:52], cv2.COLOR_BGR2GRAY)
    return image


def test_photographs_of_all_kinds_train_together_without_points(ti_cpu, tmp_path, capsys):
    folder = changed(tmp_path / "unlike", unlike)
    (folder / "sparse_pc.ply").unlink()
    data = json.loads((folder / "transforms.json").read_text())
    del data["ply_file_path"]
    (folder / "transforms.json").write_text(json.dumps(data))
    words = ["--steps", "30", "--cap", "400", "--degree", "0", "--arch", "cpu", "--checkpoint-every", "0"]
    assert main(["train", str(folder), "--out", str(tmp_path / "a.ply"), *words]) == 0
    said = capsys.readouterr()
    assert (
        "3 sizes up to 96x96 take 0.2" in said.err
        and "no points: starting with 100 Gaussians where cameras look" in said.err
    )
    assert "2 held-out photographs" in said.out
    assert len(read_gaussians(tmp_path / "a.ply")) >= 20  # the others no photograph needs, or they hang beside a camera


def test_all_of_few_photographs_are_learned_from():
    assert kept_for_test([1, 2, 3], 8) == ([1, 2, 3], [])
    assert kept_for_test(list(range(9)), 8) == ([1, 2, 3, 4, 5, 6, 7], [0, 8])
    assert kept_for_test([1, 2], 0) == ([1, 2], [])


def test_what_500_photographs_take_is_said_and_what_to_lower(tmp_path):
    folder = changed(tmp_path / "many", lambda k, image, frame, data: image)
    data = json.loads((folder / "transforms.json").read_text())
    frames = []
    for k in range(500):
        frame = data["frames"][k % VIEWS]
        name = f"images/again_{k:03}.png"
        shutil.copy(folder / frame["file_path"], folder / name)
        frames.append({**frame, "file_path": name})
    (folder / "transforms.json").write_text(json.dumps({**data, "frames": frames}))
    photographs = load_photographs(read_capture(folder).views)
    assert _photographs(photographs).startswith("500 photographs of 64x64 take 8.19 MB")
    told = pytest.raises(BadInput, match=r"500 photographs of 64x64 take 8.19 MB.*--reduce 4 .*--cap")
    with told, _lowering(photographs, OPTIONS):
        raise RuntimeError("CUDA_ERROR_OUT_OF_MEMORY: out of memory while allocating")
    with pytest.raises(RuntimeError, match="something else"), _lowering(photographs, OPTIONS):
        raise RuntimeError("something else")


def test_a_random_start_leaves_room_to_grow(tmp_path):
    given = SimpleNamespace(points=np.zeros((0, 3)))
    assert first_count(given, 400) == 100 and first_count(given, 10**7) == RANDOM_COUNT
    assert first_count(SimpleNamespace(points=np.zeros((9, 3))), 400) == 400
