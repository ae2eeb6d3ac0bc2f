"""Each scene plays itself through the command line, and a fixed seed repeats exactly."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def vrgs(*args, cwd=ROOT, timeout=400, **env) -> subprocess.CompletedProcess:
    """Run the program as a user would."""
    command = [sys.executable, str(ROOT / "vrgs.py"), *map(str, args)]
    return subprocess.run(
        command, cwd=cwd, env=os.environ | env, capture_output=True, text=True, timeout=timeout, check=False
    )


def play(tmp_path, *args, name="run") -> dict:
    """Play headless on the CPU in a small picture; returns the statistics."""
    stats = tmp_path / f"{name}.json"
    done = vrgs("--headless", "--arch", "cpu", "--size", "160x90", "--stats", stats, *args)
    assert done.returncode == 0, done.stderr
    return json.loads(stats.read_text())


def test_the_scripted_hand_wins_the_ring_toss(tmp_path):
    film, picture = tmp_path / "toss.mp4", tmp_path / "toss.png"
    stats = play(tmp_path, "--scene", "ring_toss", "--record", film, "--snapshot", picture)
    assert stats["score"] >= 2
    assert stats["finite"] is True
    assert stats["gaussians"] > 50_000 and stats["vertices"] > 300 and stats["substeps"] > 0 and stats["dt"] > 0
    assert {"simulate", "embed", "shadow", "render"} <= set(stats["stages"])
    assert stats["peak_memory_mb"] > 0
    import cv2

    capture = cv2.VideoCapture(str(film))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) >= stats["frames"] // 2
    assert cv2.imread(str(picture)).std() > 20  # a picture, not a flat colour


@pytest.mark.long
def test_a_fixed_seed_repeats_a_cpu_run_exactly(tmp_path):
    films = []
    for i in range(2):
        picture = tmp_path / f"{i}.png"
        play(tmp_path, "--frames", 30, "--seed", 7, "--snapshot", picture, name=str(i))
        films.append(picture.read_bytes())
    assert films[0] == films[1]


def test_sandbox_takes_a_splat_that_stands_on_its_head(tmp_path, shared):
    """The real input: prepared on the way, cached, dropped on the table, lifted and lobbed."""
    stats = tmp_path / "cat.json"
    done = vrgs(
        *("--scene", "sandbox", "--body", shared / "data" / "splats" / "toy_cat.ply", "--vertices", 600),
        *("--headless", "--arch", "cpu", "--size", "160x90", "--frames", 60, "--stats", stats),
        VRGS_CACHE=str(tmp_path / "cache"),
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(stats.read_text())
    assert result["finite"] is True
    assert 480 <= result["vertices"] <= 720
    assert len(list((tmp_path / "cache").glob("*.h5"))) == 1


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["--scene", "nowhere"], "no scene named 'nowhere'"),
        (["--scene", "ring_toss", "--body", "cat.ply"], "cat.ply: no such file"),
        (["--scene", "sandbox", "--body", "README.md", "--headless"], "README.md"),
        (["--up", "+y"], "--up"),
        (["--headless", "--record", "/nonexistent/film.mp4"], "/nonexistent"),
        (["render", "nothing.ply", "--camera", "c.json", "--out", "a.png"], "c.json"),
        (["convert", "nothing.ply", "b.spz"], "nothing.ply"),
        (["prepare", "nothing.ply", "--out", "b.h5"], "nothing.ply"),
    ],
)
def test_bad_input_gives_one_line_and_status_2(args, says):
    done = vrgs(*args, timeout=60)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr


def test_up_may_be_given_as_two_words():
    """argparse takes a lone -y for an option."""
    done = vrgs("--scene", "sandbox", "--body", "nothing.ply", "--up", "-y", timeout=60)
    assert done.returncode == 2 and "nothing.ply: no such file" in done.stderr
    done = vrgs("prepare", "nothing.ply", "--out", "nothing.h5", "--up", "-y", timeout=60)
    assert done.returncode == 2 and "nothing.ply" in done.stderr and "--up" not in done.stderr


def test_cuda_without_a_gpu_is_an_error():
    import taichi as ti
    from taichi.lang.misc import is_arch_supported

    if is_arch_supported(ti.cuda):
        pytest.skip("this machine has a CUDA GPU")
    done = vrgs("--arch", "cuda", "--headless", timeout=60)
    assert done.returncode == 2 and "no CUDA GPU" in done.stderr


def test_help_shows_examples_for_every_command():
    assert "examples:" in vrgs("--help").stdout
    for command in ("scenes", "render", "prepare", "convert", "build"):
        assert "example:" in vrgs(command, "--help").stdout
    assert "ring_toss" in vrgs("scenes").stdout
