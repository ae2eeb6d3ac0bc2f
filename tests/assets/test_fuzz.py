"""Absurd cameras and splats through the command line: a clean picture, or one line that names what is wrong."""

import json

import numpy as np
import pytest

import vrgs
from assets.gaussians import LOG_SCALE_MAX, MAGNITUDE_MAX, Gaussians, concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.camera import Camera, look_at
from tests.support.drawing import Drawing
from tests.support.hard_pictures import DEGREE, cloud

CAMERA = {"width": 16, "height": 8, "fx": 20, "fy": 20.5, "cx": 8, "cy": -4, "world_to_camera": np.eye(4).tolist()}
SIDE = 24  # [px]
NAN, INF = float("nan"), float("inf")


def matrix(row: int, column: int, value) -> list:
    m = np.eye(4).tolist()
    m[row][column] = value
    return m


BAD_CAMERAS = {
    '{"width": 1': "not a JSON file",
    "": "is empty",
    "[" * 100_000: "not a JSON file",
    "[]": "holds no camera",
    "3": "camera 0: it is 3, not an object with width, ",
    "[null]": "camera 0: it is None, not an object with width, ",
    json.dumps([CAMERA, CAMERA | {"width": 17}]): "the cameras differ in size",
    json.dumps([CAMERA, {k: v for k, v in CAMERA.items() if k != "cy"}]): "camera 1: cy is missing",
}
BAD_NUMBERS = [
    *[(n, v, "not a number from 0.001 to 1e+09") for n in ("fx", "fy") for v in (NAN, INF, 0, -5, 1e-310, 1e300)],
    *[(n, v, "not a number from -1e+09 to 1e+09") for n in ("cx", "cy") for v in (NAN, -INF, 1e300, -1e10)],
    *[(n, v, "not a whole number from 1 to 16384") for n in ("width", "height") for v in (NAN, INF, 0, -1, 16385)],
    *[("width", v, "not a whole number") for v in (1e300, 10**400, 16.5)],
    *[("height", v, "not a whole number") for v in ("8", None, True, [8], {})],
    *[("world_to_camera", m, "not 4x4 finite numbers") for m in ("abc", None, [[1, 2], [3]], np.eye(3).tolist())],
    *[("world_to_camera", matrix(0, 3, v), "not 4x4 finite numbers") for v in (NAN, INF, 10**400)],
    *[("world_to_camera", matrix(2, 3, v), "translation in world_to_camera is beyond") for v in (1e16, -1e300)],
    *[("world_to_camera", matrix(3, k, 7.0), "last row of world_to_camera is not 0 0 0 1") for k in (0, 3)],
    *[("world_to_camera", matrix(1, 1, v), "rotation in world_to_camera is not orthonormal") for v in (1.01, -1, 0)],
]


def command(folder, camera) -> int:
    """Exit status of `vrgs.py render` with a camera file of this content."""
    (folder / "camera.json").write_text(camera if isinstance(camera, str) else json.dumps(camera))
    words = ["render", str(folder / "g.ply"), "--camera", str(folder / "camera.json"), "--out", str(folder / "out.npz")]
    return vrgs.main([*words, "--arch", "cpu"])


def said_in_one_line(capsys, folder) -> str:
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and not said.out and not list(folder.glob("*out*"))
    return said.err


def test_a_camera_file_that_is_none_is_refused_in_one_line(ti_cpu, tmp_path, capsys):
    for content, what in BAD_CAMERAS.items():
        assert command(tmp_path, content) == 2
        assert what in said_in_one_line(capsys, tmp_path)
    for name, value, what in BAD_NUMBERS:
        assert command(tmp_path, CAMERA | {name: value}) == 2
        line = said_in_one_line(capsys, tmp_path)
        assert "camera.json: camera 0: " in line and name in line and what in line


def absurd(rng, count: int) -> Gaussians:
    """As far off, as large, as small and as bright as a file may be, each in some of its numbers."""

    def some(shape, largest, share=0.3):
        wild = rng.choice([-1, 1], shape) * 10.0 ** rng.uniform(-45, np.log10(largest), shape)
        return np.where(rng.random(shape) < share, wild, rng.normal(0, 1, shape))

    most = 0.99 * MAGNITUDE_MAX
    scales = np.where(rng.random((count, 3)) < 0.3, rng.uniform(-300, LOG_SCALE_MAX, (count, 3)), -3.0)
    logits = some(count, most)
    return Gaussians.of(some((count, 3), most), rng.normal(size=(count, 4)), scales, logits, some((count, 1, 3), most))


def absurd_camera(rng, side: int) -> Camera:
    """Any lens and place that a file may name."""

    def wild(low, high):
        return 10.0 ** rng.uniform(np.log10(low), np.log10(high))

    pose = look_at(rng.normal(size=3), rng.normal(size=3))
    if rng.random() < 0.3:
        pose[:3, 3] += rng.choice([-1, 1], 3) * [wild(1e-40, MAGNITUDE_MAX) for _ in range(3)]
    fx, fy = (wild(1e-3, 1e9) if rng.random() < 0.5 else wild(1, 100) for _ in range(2))
    cx, cy = (rng.choice([-1, 1]) * wild(1e-40, 1e9) if rng.random() < 0.3 else 0.5 * side for _ in range(2))
    return Camera(*rng.integers(1, side + 1, 2), fx, fy, cx, cy, pose)


@pytest.fixture(scope="module")
def drawing(ti_cpu) -> Drawing:
    return Drawing(600, 1, SIDE, degree=DEGREE)


def test_whatever_a_file_may_hold_is_drawn_clean(drawing, tmp_path):
    """Finite pictures of 60 absurd cameras, of Gaussians that went through a file."""
    rng = np.random.default_rng(8)
    seen = 0
    for k in range(60):
        if k % 6 == 0:
            write_gaussians(tmp_path / "g.ply", concatenate([absurd(rng, 200), cloud(rng, 50, spread=1.0, degree=0)]))
            g = read_gaussians(tmp_path / "g.ply").with_sh_degree(DEGREE)
            assert len(g) == 250
        rgb, alpha, depth = drawing.draw(g, [absurd_camera(rng, SIDE)])
        assert np.isfinite(rgb).all() and np.isfinite(depth).all() and rgb.min() >= 0.0 and depth.min() >= 0.0
        assert alpha.min() >= 0.0 and alpha.max() <= 1.0
        seen += alpha.max() > 0.5
    assert seen > 12


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 3.00 GiB for an array"),
        RuntimeError("[host_memory_pool.cpp:allocate_raw_memory@62] Virtual memory allocation (5368709120 B) failed."),
        RuntimeError("CUDA Error CUDA_ERROR_OUT_OF_MEMORY: out of memory while calling malloc_async_impl"),
    ],
)
def test_a_picture_that_does_not_fit_is_refused_in_one_line(ti_cpu, tmp_path, capsys, monkeypatch, error):
    from commands import viewing

    def fail(options):
        raise error

    monkeypatch.setattr(viewing, "draw_pictures", fail)
    assert command(tmp_path, CAMERA) == 2
    assert "not enough memory" in said_in_one_line(capsys, tmp_path)
    error = RuntimeError("something else")
    with pytest.raises(RuntimeError, match="else"):
        command(tmp_path, CAMERA)
