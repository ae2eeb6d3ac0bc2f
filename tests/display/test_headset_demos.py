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
FEW = ("box_moving", "manipulation", "toy_collection")  # played in every run of the tests; the ring toss is elsewhere
FRAMES = 150
OFF = 1e-4  # [m] of a controller that rests from where the script's hand is: float32 on the way


def played(folder, *names: str) -> dict[str, dict]:
    """Play demos one after another, without a screen; how each went."""
    log = folder / "log.jsonl"
    with surroundings() as environment:
        environment = {**os.environ, **environment, "XRT_COMPOSITOR_NULL": "1", "LIBGL_ALWAYS_SOFTWARE": "1"}
        environment.pop("DISPLAY", None)
        words = [sys.executable, SUPPORT / "played_headset.py", log, FRAMES, *names]
        done = subprocess.run([str(w) for w in words], env=environment, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr[-2000:]
    return {row["scene"]: row for row in map(json.loads, log.read_text().splitlines())}


def check(row: dict) -> None:
    """It was played to the end, and what the script took was held by the controllers."""
    assert row["status"] == 0 and row["finite"]
    assert (row["held"] >= 3 and row["off"] < OFF) if row["scripted"] else row["frames"] == FRAMES


def check_placed(folder, names) -> None:
    """Without physics: the player stands where the hands reach, and takes what the script takes."""
    rows = played(folder, "--placed", *names)
    assert list(rows) == list(names)
    for row in rows.values():
        check(row)


def test_the_player_of_a_demo_plays_in_a_headset(tmp_path):
    check_placed(tmp_path, FEW)


@pytest.mark.long
def test_the_player_of_every_demo_stands_where_its_hands_reach(tmp_path):
    check_placed(tmp_path, [name for name in DEMOS if name not in FEW])


@pytest.mark.long
@pytest.mark.parametrize("name", DEMOS)
def test_every_demo_plays_in_a_headset(name, tmp_path):
    (row,) = played(tmp_path, name).values()
    check(row)
    assert row["contrast"] > 100  # a picture
