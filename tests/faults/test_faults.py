"""Writers whose program is killed, whose disk is full, or who are not alone: nothing that was finished is lost."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from assets.file_access import STALE_AGE, atomic_write, locked, locked_folder
from core.errors import BadInput
from display.headless.video import Video
from display.record.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")

SHORT = """
from tests.faults.run import main
few = ["--writer=asset", "--writer=study", "--writer=preferences"]
more = ["--writer=film", "--writer=recording", "--writer=checkpoint", "--writer=training", "--writer=spz"]
status = main(["full", *few, *more])
status |= main(["kill", "--count=1", "--seed=1", *few, "--writer=film", "--writer=long recording"])
status |= main(["together", "--count=1", *few])
raise SystemExit(status)
"""


def test_nothing_is_lost(tmp_path):
    """Some writers, once each, in a program of their own, which forks; `make nightly` takes all of them, often."""
    done = subprocess.run([sys.executable, "-c", SHORT], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert done.stdout.count("0 failures") == 16


def test_what_a_killed_program_left_goes_with_the_next_writing(tmp_path):
    path, other = tmp_path / "a.txt", tmp_path / ".b.txt.0123abcd.part"
    parts = [tmp_path / f".a.txt.{end}" for end in ("0123abcd.part", "0123abcd.part.mp4", "89abcdef.part")]
    for part in (*parts, other):
        part.touch()
    for part in (*parts[:2], other):
        os.utime(part, (0, time.time() - 2 * STALE_AGE))
    with atomic_write(path) as beside:
        beside.write_text("whole")
    left = sorted(p.name for p in tmp_path.iterdir())
    assert left == sorted(["a.txt", parts[2].name, other.name]), "what is young may be another program's"


def test_a_lock_is_waited_for_and_given_back(tmp_path):
    path = tmp_path / "a.json"
    with locked(path):
        told = rf"another program \(process {os.getpid()}\) has been writing it"
        with pytest.raises(BadInput, match=told), locked(path, patience=0.05):
            pass
        assert path.with_name(".a.json.lock").exists()
    with locked(path, patience=0.0):
        pass
    assert list(tmp_path.iterdir()) == []


HOLDS = """
import sys, time
from pathlib import Path
from assets.file_access import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""


def test_one_run_at_a_time_writes_to_a_folder(tmp_path):
    """The second is told which process has it; once that one is killed, nothing is locked."""
    folder = tmp_path / "made" / "room"
    with subprocess.Popen([sys.executable, "-c", HOLDS, folder], cwd=ROOT, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout.readline() == "locked\n"
            told = f"{folder} is being written by another run of vrgs (process {other.pid})"
            with pytest.raises(BadInput, match=re.escape(told)), locked_folder(folder):
                pass
        finally:
            other.send_signal(signal.SIGKILL)
    with locked_folder(folder), pytest.raises(BadInput, match=rf"\(process {os.getpid()}\)"), locked_folder(folder):
        pass
    assert folder.is_dir() and not list(folder.iterdir()), "it was there before"


def test_a_new_folder_that_stays_empty_goes_with_its_lock(tmp_path):
    with pytest.raises(BadInput), locked_folder(tmp_path / "a" / "b"):
        raise BadInput("the input is at fault")
    assert not list(tmp_path.iterdir())
    with locked_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "made.txt").touch()
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["made.txt"]


def test_two_sessions_do_not_record_into_the_same_file(tmp_path):
    """HDF5 holds this lock of the system while it writes."""
    import fcntl

    with Recording(tmp_path / "other.h5") as recording:
        part = tmp_path / "play.h5.part"
        shutil.copy(recording.part, part)
    with open(part, "rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match=r"play\.h5\.part is being written by another session"):
            Recording(tmp_path / "play.h5")
    with pytest.raises(BadInput, match=r"play\.h5\.part was left by an interrupted session"):
        Recording(tmp_path / "play.h5")
    assert part.exists()


def test_two_films_of_one_name_are_both_whole(tmp_path, monkeypatch):
    import numpy as np

    from display.headless.video import frame_count

    films = [Video(tmp_path / "film.mp4", 64, 48) for _ in range(2)]
    for k, film in enumerate(films):
        for _ in range(3 + k):
            film.write(np.zeros((48, 64, 3), np.uint8))
    for k, film in enumerate(films):
        film.close()
        assert frame_count(tmp_path / "film.mp4") == 3 + k
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]
