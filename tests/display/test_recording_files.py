"""Recordings as files: those that broke off, full disks, and files that are damaged or made to do harm."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from core.errors import BadInput
from display.record.recording import Recording
from display.record.recording_file import JOURNAL
from display.record.replay import Replay
from tests.display.test_recording import Ball, record, same, some_frames

ROOT = Path(__file__).resolve().parents[2]

DIES = """
import sys; sys.path.insert(0, {root!r})
from tests.display.test_recording import record, some_frames
recording = record({path!r}, some_frames(460), close=False)
recording.flush()
print("written", flush=True)
import time
while True: time.sleep(1)
"""


def test_a_session_that_is_killed_leaves_what_was_until_then(tmp_path):
    path = tmp_path / "play.h5"
    program = DIES.format(root=str(ROOT), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "written\n"
        process.send_signal(signal.SIGKILL)
    assert not path.exists()
    replay = Replay.load(tmp_path / "play.h5.part")
    assert len(replay) == 451 and all(same(a, b) for a, b in zip(some_frames(451), replay.recorded, strict=True))
    with pytest.raises(BadInput, match=r"play\.h5\.part was left by an interrupted session"):
        Recording(path)


def test_the_end_of_a_play_that_fails_is_kept(tmp_path):
    with pytest.raises(RuntimeError), Recording(tmp_path / "play.h5") as recording:
        recording.about = {"scene": "ring_toss"}
        world = Ball()
        for frame in some_frames(30):
            world.step(recording.note(frame))
            recording.after(world)
        raise RuntimeError("the runtime went away")
    assert len(Replay.load(tmp_path / "play.h5")) == 30


def test_a_play_that_never_began_leaves_nothing(tmp_path):
    with pytest.raises(BadInput), Recording(tmp_path / "play.h5"):
        raise BadInput("no headset")
    assert list(tmp_path.iterdir()) == []


def test_where_nothing_can_be_written_a_line_says_so_at_once(tmp_path):
    with pytest.raises(BadInput, match="cannot write"):
        Recording(tmp_path / "nowhere" / "play.h5")
    with pytest.raises(BadInput, match="is a folder"):
        Recording(tmp_path)


FILLS = """
import resource, sys
from core.errors import BadInput
from tests.display.test_recording import record, some_frames
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
try:
    print(record(sys.argv[1], some_frames(3000)).frames, "frames played")
except BadInput as e:
    sys.exit(str(e))
"""


def play_until_full(path: Path, limit: int) -> subprocess.CompletedProcess:
    """A recorded play of 3000 frames, where a limit of the size of files [bytes] stands for the full disk."""
    pytest.importorskip("resource")
    words = [sys.executable, "-c", FILLS, path, str(limit)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_disk_that_fills_up_ends_the_recording_and_not_the_play(tmp_path):
    """The frames until then are a complete recording."""
    path = tmp_path / "play.h5"
    done = play_until_full(path, 400_000)
    assert done.returncode == 0 and done.stdout.endswith("3000 frames played\n"), done.stderr
    assert done.stderr == f"{path}: the recording ends here (File too large)\n"
    replay = Replay.load(path)
    assert 1000 < len(replay) < 2900 and len(replay) % 90 == 1
    assert all(same(a, b) for a, b in zip(some_frames(len(replay)), replay.recorded, strict=True))
    assert [p.name for p in tmp_path.iterdir()] == ["play.h5"]


def test_a_journal_of_which_no_recording_can_be_written_stays(tmp_path, capsys, monkeypatch):
    def full(path, journal):
        raise BadInput(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr("display.record.recording.write_recording", full)
    path = tmp_path / "play.h5"
    record(path, some_frames(100))
    assert capsys.readouterr().err == (
        f"{path}: cannot be written (No space left on device);"
        f" all that was recorded is in {path}.part, and --replay plays it\n"
    )
    assert len(Replay.load(tmp_path / "play.h5.part")) == 100 and not path.exists()


def test_a_disk_that_is_full_at_once_leaves_nothing(tmp_path):
    """It is refused before the play where not even an empty journal has space, else a line tells of it."""
    path = tmp_path / "play.h5"
    done = play_until_full(path, 10)
    assert (done.returncode, done.stderr) == (1, f"{path}: cannot be written (File too large)\n")
    done = play_until_full(path, 100)
    assert (done.returncode, done.stderr) == (0, f"{path}: nothing is recorded (File too large)\n")
    assert list(tmp_path.iterdir()) == []


def test_a_journal_is_read_up_to_its_last_whole_block(tmp_path):
    """Whole, cut off anywhere, or damaged: what was recorded until then, or one line."""
    recording = record(tmp_path / "play.h5", some_frames(300), close=False)
    recording.flush()
    whole = recording.part.read_bytes()
    recording.close()
    path, counts, rng = tmp_path / "cut.part", [], np.random.default_rng(0)
    for size in np.linspace(len(JOURNAL), len(whole), 40).astype(int):
        path.write_bytes(whole[:size])
        try:
            counts.append(len(Replay.load(path)))
        except BadInput as e:
            assert str(e).startswith(f"{path}: ")
            counts.append(0)
    assert counts == sorted(counts) and counts[-1] == 271 and set(counts) == {0, 1, 91, 181, 271}
    for _ in range(100):
        data = bytearray(whole)
        data[rng.integers(len(JOURNAL), len(JOURNAL) + 400)] = rng.integers(256)
        path.write_bytes(data)
        try:
            Replay.load(path)
        except BadInput as e:
            assert str(e).startswith(f"{path}: ") and "\n" not in str(e)


def spoil(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def put(name, value, at=0):
    def change(file):
        file[name][at] = value

    return change


def attribute(key, value):
    return lambda file: file.attrs.__setitem__(key, value)


def about(**changes):
    return attribute("about", json.dumps({"scene": "ring_toss", **changes}))


def longer(name, rows=5):
    def change(file):
        values = file[name][()]
        del file[name]
        file[name] = np.concatenate([values, values[:rows]])

    return change


def huge(file):
    del file["frames/dt"]
    file.create_dataset("frames/dt", (10**12,), np.float64, chunks=(10**6,))


def linked(file):
    del file["hands/numbers"]
    file["hands/numbers"] = h5py.ExternalLink("/etc/passwd", "/x")


SPOILED = {
    "is not a recording": attribute("format", "vrgs-asset"),
    "of version 9": attribute("version", 9),
    "not JSON": attribute("about", "{"),
    "it is \\[\\], not an object": attribute("about", "[]"),
    "seed is 'x'": about(seed="x"),
    "arch is 'tpu', not one of cpu, cuda": about(arch="tpu"),
    "world.sort is \\[1\\]": about(world={"sort": [1]}),
    "frames/dt holds": put("frames/dt", np.nan, 3),
    "frames/step holds": put("frames/step", 1e9),
    "frames/hands holds": put("frames/hands", 1000),
    "hands/numbers holds": put("hands/numbers", np.nan),
    "hands/touches holds": put("hands/touches", 1001),
    "hands/numbers has shape": put("hands/touches", 7),
    "cameras/values holds a camera": put("cameras/values", np.zeros(22)),
    "frames/time has shape": longer("frames/dt"),
    "commands/text is no text": put("commands/text", 255),
    "a line of commands is not JSON": put("commands/text", ord("x")),
    "states/count holds": put("states/count", 10**7),
    "states/frame holds": put("states/frame", 10**9),
    "claims": huge,
    "is a link": linked,
}  # fmt: skip


@pytest.mark.parametrize("says", SPOILED)
def test_a_bad_file_is_refused_in_one_line(tmp_path, says):
    path = tmp_path / "play.h5"
    record(path, some_frames(12))
    spoil(path, SPOILED[says])
    with pytest.raises(BadInput, match=says) as raised:
        Replay.load(path)
    assert str(raised.value).startswith(f"{path}: ") and "\n" not in str(raised.value) and len(str(raised.value)) < 400
