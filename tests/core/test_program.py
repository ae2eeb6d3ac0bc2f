"""The program's version, how it names itself, an interrupt of its start; work in threads and batches."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import nullcontext
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import core.program as program
import vrgs
from core.errors import BadInput
from core.program import VERSION, as_called, batches, find_home, in_threads, temporary_folder
from tests.support.fake_world import fake_scene

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("started", "one_file", "words"),
    [
        ("vrgs.py", False, "python vrgs.py"),
        ("/usr/local/bin/vrgs", False, "vrgs"),
        (r"vrgs.exe", False, "vrgs"),
        ("/home/me/vrgs-0.1", True, "vrgs"),
        ("/usr/lib/python3/site-packages/pytest/__main__.py", False, "python vrgs.py"),
    ],
)
def test_texts_begin_commands_as_the_user_does(monkeypatch, started, one_file, words):
    monkeypatch.setattr(sys, "argv", [started])
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)
    monkeypatch.setattr(program, "ONE_FILE", one_file)
    assert as_called("python vrgs.py --scene ring_toss") == f"{words} --scene ring_toss"
    assert as_called("see vrgs.py scenes") == f"see {words.removeprefix('python ')} scenes"


def test_as_a_module_its_help_begins_every_line_with_that(tmp_path):
    command = [sys.executable, "-m", "vrgs", "convert", "--help"]
    run = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert run.stdout.startswith("usage: python -m vrgs convert") and "vrgs.py" not in run.stdout


def test_version_and_errors(monkeypatch, capsys):
    monkeypatch.setattr(program, "ONE_FILE", True)
    with pytest.raises(SystemExit):
        vrgs.main(["--version"])
    assert capsys.readouterr().out == f"vrgs {VERSION}\n"
    assert vrgs.main(["--scene"]) == 2
    said = capsys.readouterr().err
    assert "see vrgs --help" in said and "vrgs.py" not in said
    assert vrgs.main(["build", "ring_red"]) == 2
    assert "are built by python -m studio" in capsys.readouterr().err


def test_a_python_without_the_packages_is_told_in_a_line():
    """Without site, Python has none of them."""
    run = subprocess.run([sys.executable, "-S", ROOT / "vrgs.py", "scenes"], capture_output=True, text=True)
    assert run.returncode == 2 and run.stderr.count("\n") == 1
    assert "has no package" in run.stderr and ".venv/bin/python" in run.stderr


@pytest.mark.parametrize("kind", ["SIGINT", "SIGTERM"])
def test_an_interrupt_while_it_imports_is_told_in_a_line(kind):
    """Every import is preceded by an interrupt; the first is met where the program imports its own modules."""
    code = (
        "import os, signal, sys, vrgs\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        signal.raise_signal(signal.{kind})\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "sys.exit(vrgs.main(['scenes']))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (128 + signal.SIGINT, "", "vrgs: interrupted\n")


@pytest.mark.skipif(os.name == "nt", reason="Windows knows no HOME")
def test_without_a_home_taichi_starts():
    """It would end with a core dump at its import."""
    code = "import vrgs; vrgs.run(['scenes']); import taichi"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env={}, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")


@pytest.mark.skipif(os.name == "nt", reason="Windows knows no HOME")
@pytest.mark.parametrize("known", ["~", "/nonexistent"])
def test_a_user_without_a_home_gets_a_temporary_one_that_nobody_else_writes_to(tmp_path, monkeypatch, known):
    monkeypatch.setattr(program.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(program.os.path, "expanduser", lambda name: known)
    monkeypatch.setenv("HOME", "")
    find_home()
    home = Path(os.environ["HOME"])
    assert home.parent == tmp_path and home.stat().st_mode & 0o777 == 0o700
    assert temporary_folder() == home  # the same each time
    home.chmod(0o777)
    assert temporary_folder() != home
    monkeypatch.setattr(program.tempfile, "tempdir", str(tmp_path / "none"))
    with pytest.raises(BadInput, match="TMPDIR"):
        temporary_folder()


@pytest.mark.parametrize(
    "words", [["export", "--out", "toy.usdz"], ["prepare", "cat.ply", "--cage", "cat.usda", "--out", "cat.h5"]]
)
def test_without_openusd_its_installation_is_told_in_a_line(tmp_path, monkeypatch, capsys, words):
    monkeypatch.setattr(program, "find_spec", lambda name: None if name == "pxr" else find_spec(name))
    monkeypatch.chdir(tmp_path)
    for name in ("cat.ply", "cat.usda"):
        (tmp_path / name).write_text("anything")
    assert vrgs.main(words) == 2
    said = capsys.readouterr().err
    assert said.endswith("needs the package usd-core: pip install -r requirements-usd.txt\n") and said.count("\n") == 1


def test_small_problems_are_solved_by_one_thread():
    """Asked of the libraries themselves."""
    code = """if True:
        import ctypes, numpy, scipy.linalg
        from pathlib import Path
        from core.program import use_one_blas_thread
        site, asked = Path(numpy.__file__).parents[1], []
        for of, ending in (("numpy", "64_"), ("scipy", "")):
            for path in site.glob(f"{of}.libs/*openblas*"):
                asked.append(getattr(ctypes.CDLL(str(path)), f"scipy_openblas_get_num_threads{ending}"))
        before = [ask() for ask in asked]
        use_one_blas_thread()
        print(*before, *(ask() for ask in asked))
    """
    env = os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    at_first = str(min(2, os.cpu_count()))
    assert run.stdout.split() == [at_first, at_first, "1", "1"]


def test_a_play_that_is_interrupted_still_writes_its_results(monkeypatch, capsys):
    """In a headset, Ctrl-C is the only way to end."""
    done = []
    session = SimpleNamespace(display=0, film=0, recording=0, frames=lambda: signal.raise_signal(signal.SIGINT))
    session.report = lambda: done.append("report")
    monkeypatch.setattr("commands.play.open_session", lambda options: nullcontext(session))
    assert vrgs.main(["--xr"]) == 130 and done == ["report"]


def test_a_play_without_a_display_overwrites_nothing(tmp_path, monkeypatch):
    from commands import play
    from commands.play_options import PlayOptions

    monkeypatch.chdir(tmp_path)
    (tmp_path / "ring_toss.mp4").touch()
    monkeypatch.setattr("display.window.gl_window.has_display", lambda: False)
    options = PlayOptions()
    play.open_display(options, replace(fake_scene(), game=None))
    assert (options.record, options.snapshot) == (Path("ring_toss_2.mp4"), Path("ring_toss.png"))


def test_results_come_in_the_items_order():
    first = threading.Event()

    def wait_for_the_last(k: int) -> int:
        if k == 0:
            first.wait(5)
        if k == 1:
            first.set()
        return k * k

    assert in_threads(wait_for_the_last, range(2)) == [0, 1]
    assert in_threads(wait_for_the_last, []) == []


def test_an_error_in_a_thread_is_raised():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 // k, [1, 0])


@pytest.mark.parametrize("count", [0, 1, 4, 9])
def test_batches_cover_all_items_once(count):
    items = np.arange(count)
    parts = [items[s] for s in batches(count, 4)]
    assert all(0 < len(part) <= 4 for part in parts) and np.array_equal(np.concatenate([[], *parts]), items)
