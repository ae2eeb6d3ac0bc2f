"""`vrgs.py render`: the files it writes and what it refuses."""

import json
import re

import cv2
import numpy as np
import pytest

from assets.splat_files import write_gaussians
from core.errors import BadInput
from tests.support.hard_pictures import round_ones


def test_the_command_writes_pictures_and_arrays(ti_cpu, tmp_path):
    from commands.viewing import RenderOptions, draw_pictures

    write_gaussians(tmp_path / "g.ply", round_ones((0.0, 0.0, 1.0)))
    view = {"width": 16, "height": 8, "fx": 20, "fy": 20, "cx": 8, "cy": 4, "world_to_camera": np.eye(4).tolist()}
    (tmp_path / "one.json").write_text(json.dumps(view))
    (tmp_path / "two.json").write_text(json.dumps([view, view]))

    def command(camera, out):
        draw_pictures(RenderOptions(splats=tmp_path / "g.ply", camera=tmp_path / camera, out=tmp_path / out, sort="z"))

    command("two.json", "a.npz")
    arrays = np.load(tmp_path / "a.npz")
    assert {k: (arrays[k].shape, arrays[k].dtype) for k in arrays} == {
        "rgb": ((2, 8, 16, 3), np.float32),
        "alpha": ((2, 8, 16), np.float32),
        "depth": ((2, 8, 16), np.float32),
    }
    command("one.json", "a.png")
    command("two.json", "b.png")
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["a.png", "b_000.png", "b_001.png"]
    picture = cv2.imread(str(tmp_path / "a.png"))[..., ::-1] / 255
    np.testing.assert_allclose(picture, arrays["rgb"][0], atol=0.51 / 255)
    for out in ("a.jpg", "nowhere/a.png"):
        with pytest.raises(BadInput, match=re.escape(out)):
            command("one.json", out)
