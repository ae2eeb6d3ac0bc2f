"""vrgs.py prepare, given what cannot be used: one line, exit status 2, and no file where there was none."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

import vrgs
from assets.asset import Asset
from assets.gaussians import concatenate, robust_bounds
from assets.library import with_sources
from assets.splat_files import write_gaussians
from commands.options import Preparation
from commands.prepared import cached_body, wanted_vertices
from core.errors import BadInput
from prepare.pipeline import Options
from prepare.prepared_files import DEVICE_VERTICES, device_vertices, prepare_file
from tests.prepare.test_pipeline import BAD, PLANE, some
from tests.support.cage_cases import case
from tests.support.sample_scenes import table_and_jug
from tests.support.shells import ball

COLUMNS = ["x", "y", "z", "opacity", *(f"{k}_{i}" for k in ("f_dc", "scale") for i in range(3))]
COLUMNS += [f"rot_{k}" for k in range(4)]
EMPTY = "\n".join([
    "ply", "format binary_little_endian 1.0", "element vertex 0", *(f"property float {c}" for c in COLUMNS),
    "end_header", "",
]).encode()  # fmt: skip


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


@pytest.mark.parametrize("name", ["all transparent", "a plane", "too few", "mist"])
def test_a_splat_without_a_solid_body(prepared, tmp_path, name):
    write_gaussians(tmp_path / "bad.ply", BAD[name][0])
    assert_refused(prepared("bad.ply"), BAD[name][1])


@pytest.mark.parametrize("options", [(), ("--static",)])
@pytest.mark.parametrize("content, message", [(EMPTY, "no Gaussians"), (b"", "is empty")])
def test_an_empty_splat(prepared, tmp_path, content, message, options):
    (tmp_path / "empty.ply").write_bytes(content)
    assert_refused(prepared("empty.ply", *options), message)


@pytest.mark.parametrize("vertices", ["50000000", "49", "100001"])
def test_a_cage_of_fifty_million_vertices(prepared, tmp_path, vertices):
    write_gaussians(tmp_path / "ball.ply", ball())
    assert_refused(prepared("ball.ply", "--vertices", vertices), f"a cage of {vertices} vertices")


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_a_splat_of_impossible_size(prepared, tmp_path, factor):
    body = ball(500)
    write_gaussians(tmp_path / "ball.ply", replace(body, means=(body.means * factor).astype(np.float32)))
    assert_refused(prepared("ball.ply"), "extent is")


def test_without_a_number_the_cage_suits_the_device_and_a_line_says_so(prepared, tmp_path):
    write_gaussians(tmp_path / "ball.ply", ball())
    status, said, _ = prepared("ball.ply", "--no-report")
    least = DEVICE_VERTICES["cpu"][0]
    assert status == 0 and f"a cage of {least} vertices, as suits a CPU (--vertices N)" in said.out
    found = Asset.load(tmp_path / "out.h5")
    assert abs(len(found.cage.vertices) / least - 1) < 0.15
    kept, vertices = cached_body(tmp_path / "ball.ply", Preparation(), "cpu")
    assert vertices == least and len(Asset.load(kept).cage.vertices) == len(found.cage.vertices)
    assert cached_body(tmp_path / "ball.ply", Preparation(), "cpu") == (kept, least)
    assert cached_body(tmp_path / "ball.ply", Preparation(vertices=least), "cpu") == (kept, least)  # as a state asks
    assert device_vertices(animated=True)[0] > least
    assert with_sources(f"{kept}: has no cage") == f"{tmp_path / 'ball.ply'}: has no cage"  # as the user named it


def test_a_shape_that_has_no_cage_of_so_few_vertices_gets_one_of_more(ti_cpu, tmp_path):
    write_gaussians(tmp_path / "ring.ply", case("ring"))
    said = []
    out = prepare_file(tmp_path / "ring.ply", tmp_path / "ring.h5", vertices=(50, 150), report=said.append)
    assert any("about 50 vertices" in line and "; trying 150 vertices" in line for line in said)
    assert wanted_vertices(out) == 150 and abs(len(Asset.load(out).cage.vertices) / 150 - 1) < 0.15
    with pytest.raises(BadInput, match=r"ring\.ply: no cage of about 60"):
        prepare_file(tmp_path / "ring.ply", tmp_path / "ring.h5", vertices=(50, 60), report=said.append)


def test_quantised_stores_a_smaller_asset(ti_cpu, tmp_path):
    write_gaussians(tmp_path / "ball.ply", ball(2000))
    words = ["prepare", str(tmp_path / "ball.ply"), "--out", str(tmp_path / "small.h5"), "--vertices", "300"]
    assert vrgs.main([*words, "--up", "+y", "--no-report", "--quantised", "--arch", "cpu"]) == 0
    with h5py.File(tmp_path / "small.h5") as file:
        assert file.attrs["version"] == 2
    Asset.load(tmp_path / "small.h5").save(tmp_path / "large.h5")
    assert (tmp_path / "small.h5").stat().st_size < 0.4 * (tmp_path / "large.h5").stat().st_size


@pytest.mark.parametrize("fraction", [1 / 3, 1.0])
def test_of_two_bodies_far_apart_the_larger_is_taken_and_that_is_said(ti_cpu, tmp_path, fraction):
    """Of two equal ones, either."""
    body = ball(2000)
    other = body.select(np.arange(len(body)) < fraction * len(body))
    far = replace(other, means=other.means + np.float32(40))
    write_gaussians(tmp_path / "two.ply", concatenate([far, body]))
    lines = []
    out = prepare_file(tmp_path / "two.ply", tmp_path / "out.h5", Options(vertices=300, up="+y"), report=lines.append)
    (line,) = (line for line in lines if "apart: the largest" in line)
    left = int(line.split(" Gaussians left out; --pieces keeps all")[0].split()[-1])
    assert len(other) <= left < 1.05 * len(other)
    assert abs(len(Asset.load(out).gaussians) - len(body)) < 0.02 * len(body)


def cells_of(g) -> float:
    """The --cell [m] at which the splat, 6 m long, asks for 50 million cells."""
    low, high = robust_bounds(g.means.astype(np.float64))
    return float(np.cbrt(((high - low) * 6.0 / (high - low).max()).prod() / 50e6))


SCENES = {
    "transparent": (BAD["all transparent"][0], (), "opaque"),
    "plane": (some(500, means=PLANE[:, [0, 2, 1]]), ("--up", "+y"), "nothing stands above the floor"),
    "few": (BAD["too few"][0], (), "only 12 of 12"),
    "table": (table_and_jug(), ("--scale", "6", "--cell", f"{cells_of(table_and_jug()):.4g}"), "cells, the limit is"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_is_none(prepared, tmp_path, name):
    """Of the table a grid of 50 million cells is asked for."""
    splats, options, message = SCENES[name]
    write_gaussians(tmp_path / f"{name}.ply", splats)
    assert_refused(prepared(f"{name}.ply", "--static", *options), message)


def test_an_asset_is_not_left_behind_without_its_report(prepared, tmp_path, monkeypatch):
    write_gaussians(tmp_path / "ball.ply", ball(1000))
    monkeypatch.setattr("prepare.prepared_files.examine", lambda *_: ({}, {}))
    monkeypatch.setattr("prepare.prepared_files.report_texts", lambda *_: ("page", "\ud800"))  # no UTF-8
    with pytest.raises(UnicodeEncodeError):
        prepared("ball.ply", "--vertices", "200", "--up", "+y")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.ply", "cache"]
