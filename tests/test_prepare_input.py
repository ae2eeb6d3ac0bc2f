"""vrgs.py prepare, given what cannot be used: one line, exit status 2, and no file where there was none."""

from dataclasses import replace

import numpy as np
import pytest

import vrgs
from assets.asset import Asset
from assets.files import write_gaussians
from assets.gaussians import concatenate
from tests.shells import ball
from tests.test_prepare import BAD, PLANE, some

COLUMNS = [
    *"xyz",
    "opacity",
    *(f"{k}_{i}" for k in ("f_dc", "scale") for i in range(3)),
    *map("rot_{}".format, range(4)),
]
EMPTY = b"ply\nformat binary_little_endian 1.0\nelement vertex 0\n" + b"".join(
    b"property float %s\n" % name.encode() for name in COLUMNS
)
NAMES = ("transparent", "plane", "few", "mist")
SPLATS = {
    "transparent": BAD["all transparent"][0],
    "plane": some(500, means=PLANE),
    "few": some(12),
    "mist": BAD["mist"][0],
}
SAID = {"transparent": "all 500 Gaussians are transparent", "plane": "plane or a line", "few": "12", "mist": "opaque"}


@pytest.fixture
def prepared(ti_cpu, tmp_path, capfd, monkeypatch):
    """Runs the command in an empty folder; gives the status, the lines that were said, and what files are new."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))

    def run(name: str, *options: str):
        there = set(tmp_path.iterdir())
        status = vrgs.main(["prepare", str(tmp_path / name), "--out", str(tmp_path / "out.h5"), *options])
        said = capfd.readouterr()
        new = sorted(p.name for p in set(tmp_path.iterdir()) - there if p.name != "cache")
        assert not any((tmp_path / "cache").rglob("*.npz"))
        return status, said, new

    return run


def assert_refused(found, message: str) -> None:
    status, said, new = found
    complaints = [line for line in said.err.splitlines() if line.startswith("vrgs:")]
    assert status == 2 and new == []
    assert len(complaints) == 1 and message in complaints[0]
    assert "Traceback" not in said.err and "wrote" not in said.out


@pytest.mark.parametrize("name", NAMES)
def test_a_splat_without_a_solid_body(prepared, tmp_path, name):
    write_gaussians(tmp_path / f"{name}.ply", SPLATS[name])
    assert_refused(prepared(f"{name}.ply"), SAID[name])


@pytest.mark.parametrize("content, message", [(EMPTY + b"end_header\n", "no Gaussians"), (b"", "is empty")])
def test_an_empty_splat(prepared, tmp_path, content, message):
    (tmp_path / "empty.ply").write_bytes(content)
    assert_refused(prepared("empty.ply"), message)


@pytest.mark.parametrize("vertices", ["50000000", "49", "100001"])
def test_a_cage_of_fifty_million_vertices(prepared, tmp_path, vertices):
    write_gaussians(tmp_path / "ball.ply", ball())
    assert_refused(prepared("ball.ply", "--vertices", vertices), f"a cage of {vertices} vertices")


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_a_splat_of_impossible_size(prepared, tmp_path, factor):
    body = ball(500)
    body = replace(body, means=(body.means * factor).astype(np.float32))
    write_gaussians(tmp_path / "ball.ply", body)
    assert_refused(prepared("ball.ply"), "extent is")


def test_of_two_bodies_far_apart_the_larger_is_taken_and_that_is_said(prepared, tmp_path):
    body = ball()
    other = body.select(np.arange(len(body)) < len(body) // 3)
    far = replace(other, means=other.means + np.float32(40))
    write_gaussians(tmp_path / "two.ply", concatenate([far, body]))
    status, said, new = prepared("two.ply", "--vertices", "300", "--no-report", "--up", "+y")
    assert status == 0 and new == ["out.h5"]
    line = next(line for line in said.out.splitlines() if "apart: the largest" in line)
    assert f"{len(other)} Gaussians left out" in line
    assert abs(len(Asset.load(tmp_path / "out.h5").gaussians) - len(body)) < 0.02 * len(body)
