"""Every demo in Monado, its scripted player leading the controllers (tests/support/played_headset.py)."""

import json
import os
import subprocess
import sys

import pytest

from scenes import registry
from tests.support.remote_headset import monado, surroundings
from tests.support.watched import SUPPORT

pytestmark = pytest.mark.skipif(monado() is None, reason="no OpenXR runtime: `sh tests/support/monado.sh` builds it")
DEMOS = registry.names()
FRAMES = 150
OFF = 1e-4  # [m] of a controller that rests from where the script's hand is: float32 on the way


@pytest.mark.long
@pytest.mark.parametrize("name", DEMOS)
def test_every_demo_plays_in_a_headset(name, tmp_path):
    """It is played to the end, and what the script takes is held by the controllers."""
    log = tmp_path / "log.jsonl"
    with surroundings() as environment:
        environment = {**os.environ, **environment, "XRT_COMPOSITOR_NULL": "1", "LIBGL_ALWAYS_SOFTWARE": "1"}
        environment.pop("DISPLAY", None)
        words = [sys.executable, SUPPORT / "played_headset.py", log, FRAMES, name]
        done = subprocess.run([str(w) for w in words], env=environment, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr[-2000:]
    row = json.loads(log.read_text())
    assert row["status"] == 0 and row["finite"]
    assert (row["held"] >= 3 and row["off"] < OFF) if row["scripted"] else row["frames"] == FRAMES
    assert row["contrast"] > 100  # a picture
