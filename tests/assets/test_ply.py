"""INRIA .ply: any property order, any degree, and nothing but BadInput from a broken file."""

import numpy as np
import pytest

from assets.formats.ply import read_ply, write_ply
from tests.support.samples import refused, some_gaussians
from tests.support.splat_encoders import ply_bytes, properties

EXACT = ("means", "log_scales", "logit_opacities", "sh")


@pytest.mark.parametrize("degree", range(4))
def test_properties_may_come_in_any_order(tmp_path, degree):
    g = some_gaussians(degree=degree, seed=degree)
    columns = properties(g)
    names = list(np.random.default_rng(degree).permutation(list(columns)))
    columns |= {f"rot_{i}": g.quats[:, i] * np.linspace(0.1, 1e3, len(g)) for i in range(4)}
    path, lines = tmp_path / "a.ply", []
    path.write_bytes(ply_bytes({name: columns[name] for name in names}))
    read = read_ply(path, report=lines.append)
    assert read.sh_degree == degree and lines == []
    for name in EXACT:
        np.testing.assert_array_equal(getattr(read, name), getattr(g, name))
    np.testing.assert_allclose(read.quats, g.quats, atol=1e-6)  # normalised again
    assert not read.object_id.any()


@pytest.mark.parametrize("degree", range(4))
def test_a_written_file_has_inria_s_layout_and_is_read_exactly(tmp_path, degree):
    g = some_gaussians(degree=degree)
    write_ply(tmp_path / "a.ply", g)
    read = read_ply(tmp_path / "a.ply")
    for name in EXACT:
        np.testing.assert_array_equal(getattr(read, name), getattr(g, name))
    np.testing.assert_allclose(read.quats, g.quats, atol=1e-7)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]  # nothing is left beside it
    header = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode().splitlines()
    names = [line.split()[-1] for line in header if line.startswith("property")]
    colour = [*(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(3 * g.sh.shape[1] - 3))]
    shape = ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    assert names == [*"xyz", "nx", "ny", "nz", *colour, *shape]


@pytest.mark.parametrize("form", ["binary_big_endian", "ascii"])
def test_other_encodings(tmp_path, form):
    g = some_gaussians(5, 1)
    (tmp_path / "a.ply").write_bytes(ply_bytes(properties(g), form=form))
    read = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_array_equal(read.sh, g.sh)


def test_foreign_properties_elements_types_and_line_ends(tmp_path):
    g = some_gaussians(7, 2)
    columns = {"red": np.arange(7), "nx": np.ones(7), **properties(g), "confidence": np.ones(7), "id": np.arange(7)}
    types = {"red": "uchar", "confidence": "double", "id": "short", "x": "double"}
    before = "element camera 2\nproperty double a\nproperty uchar b\n"
    (tmp_path / "a.ply").write_bytes(
        ply_bytes(columns, types, before=before, prefix=b"\7" * 18, after=b"rest", end="\r\n")
    )
    read = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.means, g.means)
    np.testing.assert_array_equal(read.log_scales, g.log_scales)


def test_unusable_gaussians_are_dropped_and_counted_in_one_line(tmp_path):
    g = some_gaussians(20)
    columns = {name: values.copy() for name, values in properties(g).items()}
    columns["x"][1] = np.nan
    columns["scale_1"][2] = -np.inf
    columns["scale_1"][3] = np.inf
    columns["opacity"][4] = np.nan
    columns["f_rest_40"][5] = np.nan
    columns["rot_2"][6] = np.nan
    columns["scale_0"][7] = 200.0  # exp(200) is no float32
    for i in range(4):
        columns[f"rot_{i}"][8] = 0.0
    (tmp_path / "a.ply").write_bytes(ply_bytes(columns))
    lines = []
    read = read_ply(tmp_path / "a.ply", report=lines.append)
    keep = [i for i in range(20) if not 1 <= i <= 8]
    np.testing.assert_array_equal(read.means, g.means[keep])
    np.testing.assert_array_equal(read.sh, g.sh[keep])
    assert len(lines) == 1 and "dropped 8 of 20" in lines[0] and "a.ply" in lines[0]


def test_infinite_logits_are_opaque_or_transparent(tmp_path):
    g = some_gaussians(4, 0)
    logits = np.array([np.inf, -np.inf, 3.0, 90.0], np.float32)
    (tmp_path / "a.ply").write_bytes(ply_bytes(properties(g) | {"opacity": logits}))
    lines = []
    read = read_ply(tmp_path / "a.ply", report=lines.append)
    assert lines == [] and np.isfinite(read.logit_opacities).all()
    np.testing.assert_allclose(read.opacities, [1, 0, 1 / (1 + np.exp(-3)), 1], atol=2e-6)


@pytest.mark.parametrize("name", ["x", "f_dc_2", "opacity", "scale_0", "rot_3", "f_rest_5"])
def test_a_missing_property_is_named(tmp_path, name):
    columns = properties(some_gaussians(3, 1))
    if name.startswith("f_rest"):
        columns["f_rest_9"] = columns[name]
    del columns[name]
    assert repr(name) in refused(tmp_path / "a.ply", ply_bytes(columns))


def test_broken_headers_are_refused(tmp_path):
    path = tmp_path / "a.ply"
    good = ply_bytes(properties(some_gaussians(3, 0)))
    assert "empty" in refused(path, b"")
    assert "not a .ply" in refused(path, b"garbage" * 100)
    assert "does not end" in refused(path, good[: good.index(b"end_header")])
    assert "format" in refused(path, good.replace(b"format binary_little_endian 1.0\n", b""))
    assert "understand" in refused(path, good.replace(b"property float x", b"property quad x"))
    assert "understand" in refused(path, good.replace(b"vertex 3", b"vertex -3"))
    assert "no vertex" in refused(path, good.replace(b"element vertex", b"element vortex"))
    assert "twice" in refused(path, good.replace(b"property float y", b"property float x"))
    assert "holds no Gaussians" in refused(path, good.replace(b"vertex 3", b"vertex 0"))
    assert "f_rest" in refused(path, good.replace(b"end_header", b"property float f_rest_0\nend_header"))
    assert "list" in refused(path, good.replace(b"end_header", b"property list uchar int q\nend_header"))
    before = b"element face 1\nproperty list uchar int q\nelement vertex"
    assert "mesh" in refused(path, good.replace(b"element vertex", before))  # what has faces is taken for one
    assert "compressed" in refused(path, good.replace(b"float x", b"uint packed_position"))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("count", [4, 2**31, 2**32 + 3, 10**15])
def test_a_count_that_the_file_cannot_hold_is_refused(tmp_path, form, count):
    data = ply_bytes(properties(some_gaussians(3, 3)), form=form)
    message = refused(tmp_path / "a.ply", data.replace(b"vertex 3", b"vertex %d" % count))
    assert str(count) in message or (form == "ascii" and count == 4)


def test_rows_that_are_not_numbers_or_of_no_use_are_refused(tmp_path):
    columns = properties(some_gaussians(3, 0))
    data = ply_bytes(columns, form="ascii")
    refused(tmp_path / "a.ply", data[:-20])
    refused(tmp_path / "a.ply", data[:-20] + b"spam" * 5)
    assert "none of its 3" in refused(tmp_path / "a.ply", ply_bytes(columns | {"x": np.full(3, np.nan)}))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "count", "degree"),
    [("toy_cat", 23261, 3), ("plush_dragon", 62137, 0), ("biker_human", 152746, 0), ("fruit_drops_minimal", 4721, 3)],
)
def test_captured_splats(shared, name, count, degree):
    lines = []
    g = read_ply(shared / "data" / "splats" / f"{name}.ply", report=lines.append)
    assert (len(g), g.sh_degree, lines) == (count, degree, [])
    np.testing.assert_allclose(np.linalg.norm(g.quats, axis=1), 1, atol=1e-6)
