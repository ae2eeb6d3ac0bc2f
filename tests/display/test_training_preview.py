"""The window of a training: it shows what is learned, and when it is closed the training continues."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.painted_capture import write_capture
from tests.support.xvfb import NEEDS_XVFB, XServer

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [*NEEDS_XVFB, pytest.mark.long]


def test_a_training_is_watched_and_outlives_its_window(tmp_path):
    write_capture(tmp_path / "painted")
    out = tmp_path / "out.ply"
    line = [sys.executable, ROOT / "vrgs.py", "train", tmp_path / "painted", "--out", out, "--arch", "cpu"]
    line += ["--steps", "800", "--cap", "500", "--degree", "1", "--preview"]
    with XServer(640, 400) as screen:
        program = subprocess.Popen(
            [str(w) for w in line], env=screen.env, cwd=tmp_path, stderr=subprocess.PIPE, text=True
        )
        window = screen.wait_for_window("VR-GS: training painted", seconds=120)
        said = ""
        while "step 1/" not in said:  # the first one compiles
            said += program.stderr.readline()
            assert program.poll() is None, said
        colours = 0.0
        while colours < 20.0:  # Gaussians of all colours before grey
            picture = screen.pixels().astype(float)[150:350, 250:]
            colours = np.ptp(picture, axis=2).mean()
            assert program.poll() is None
        screen.close_window(window)
        said += program.stderr.read()
        assert program.wait(120) == 0 and out.is_file()
    assert "the window was closed; training continues" in said and "step 800/800" in said
