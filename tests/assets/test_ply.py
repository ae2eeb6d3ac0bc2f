"""INRIA .ply: any property order, any degree, and nothing but BadInput from a broken file."""

import numpy as np
import pytest

from assets.formats.ply import read_ply, write_ply
from assets.gaussians import Gaussians
from core.errors import BadInput
from tests.support.samples import damaged, read_or_refuse, some_gaussians

EXACT = ("means", "log_scales", "logit_opacities", "sh")


def properties(g: Gaussians) -> dict[str, np.ndarray]:
    """Columns by property name, written down from the format, not through the code under test."""
    columns = {axis: g.means[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"f_dc_{c}": g.sh[:, 0, c] for c in range(3)}
    k = g.sh.shape[1] - 1
    columns |= {f"f_rest_{c * k + i}": g.sh[:, 1 + i, c] for c in range(3) for i in range(k)}
    columns |= {"opacity": g.logit_opacities}
    columns |= {f"scale_{i}": g.log_scales[:, i] for i in range(3)}
    return columns | {f"rot_{i}": g.quats[:, i] for i in range(4)}


def ply_bytes(columns, types=None, form="binary_little_endian", before="", prefix=b"", after=b"", end="\n") -> bytes:
    """A .ply whose vertex element has these columns in this order."""
    types = types or {}
    n = len(next(iter(columns.values())))
    order = ">" if "big" in form else "<"
    kinds = {"float": "f4", "double": "f8", "uchar": "u1", "short": "i2"}
    lines = ["ply", f"format {form} 1.0", "comment made by a test", *before.split("\n")[:-1], f"element vertex {n}"]
    lines += [f"property {types.get(name, 'float')} {name}" for name in columns]
    header = end.join([*lines, "end_header"]) + end
    rows = np.zeros(n, [(name, order + kinds[types.get(name, "float")]) for name in columns])
    for name, values in columns.items():
        rows[name] = values
    body = rows.tobytes() if form != "ascii" else "".join(" ".join(map(repr, r.tolist())) + "\n" for r in rows).encode()
    return header.encode() + prefix + body + after


def refused(path, data: bytes | None = None) -> str:
    """The one line with which the file is refused."""
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(BadInput) as error:
        read_ply(path, report=lambda line: None)
    message = str(error.value)
    assert str(path) in message and "\n" not in message
    return message


@pytest.mark.parametrize("degree", range(4))
def test_properties_may_come_in_any_order(tmp_path, degree):
    g = some_gaussians(degree=degree, seed=degree)
    columns = properties(g)
    names = list(np.random.default_rng(degree).permutation(list(columns)))
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes({name: columns[name] for name in names}))
    read = read_ply(path)
    assert read.sh_degree == degree
    for name in EXACT:
        np.testing.assert_array_equal(getattr(read, name), getattr(g, name))
    np.testing.assert_allclose(read.quats, g.quats, atol=1e-7)  # normalised again
    assert not read.object_id.any()


@pytest.mark.parametrize("degree", range(4))
def test_round_trip_is_exact(tmp_path, degree):
    g = some_gaussians(degree=degree)
    write_ply(tmp_path / "a.ply", g)
    read = read_ply(tmp_path / "a.ply")
    for name in EXACT:
        np.testing.assert_array_equal(getattr(read, name), getattr(g, name))
    np.testing.assert_allclose(read.quats, g.quats, atol=1e-7)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]  # nothing is left beside it


def test_written_layout_is_inria_s(tmp_path):
    write_ply(tmp_path / "a.ply", some_gaussians(2, 1))
    names = [
        line.split()[-1] for line in (tmp_path / "a.ply").read_bytes().split(b"\n") if line.startswith(b"property")
    ]
    rest = [b"f_rest_%d" % i for i in range(9)]
    shape = [b"opacity", b"scale_0", b"scale_1", b"scale_2", b"rot_0", b"rot_1", b"rot_2", b"rot_3"]
    assert names == [b"x", b"y", b"z", b"nx", b"ny", b"nz", b"f_dc_0", b"f_dc_1", b"f_dc_2", *rest, *shape]


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


def test_quaternions_are_normalised(tmp_path):
    g = some_gaussians()
    columns = properties(g)
    stretch = np.linspace(0.1, 1e3, len(g))
    (tmp_path / "a.ply").write_bytes(ply_bytes(columns | {f"rot_{i}": g.quats[:, i] * stretch for i in range(4)}))
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").quats, g.quats, atol=1e-6)


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


def test_a_clean_file_reports_nothing(tmp_path):
    write_ply(tmp_path / "a.ply", some_gaussians())
    lines = []
    read_ply(tmp_path / "a.ply", report=lines.append)
    assert lines == []


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
    assert "no such file" in refused(tmp_path / "none.ply")
    assert "folder" in refused(tmp_path)
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
    assert "list" in refused(path, good.replace(b"element vertex", before))
    assert "compressed" in refused(path, good.replace(b"float x", b"uint packed_position"))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("count", [4, 2**31, 2**32 + 3, 10**15])
def test_a_count_that_the_file_cannot_hold_is_refused(tmp_path, form, count):
    data = ply_bytes(properties(some_gaussians(3, 3)), form=form)
    message = refused(tmp_path / "a.ply", data.replace(b"vertex 3", b"vertex %d" % count))
    assert str(count) in message or (form == "ascii" and count == 4)


def test_ascii_rows_that_are_not_numbers_are_refused(tmp_path):
    data = ply_bytes(properties(some_gaussians(3, 0)), form="ascii")
    refused(tmp_path / "a.ply", data[:-20])
    refused(tmp_path / "a.ply", data[:-20] + b"spam" * 5)


def test_a_file_without_a_usable_gaussian_is_refused(tmp_path):
    columns = properties(some_gaussians(3, 0))
    assert "none of its 3" in refused(tmp_path / "a.ply", ply_bytes(columns | {"x": np.full(3, np.nan)}))


def test_damaged_files_load_finite_or_are_refused(tmp_path):
    """Truncations and bit flips: finite Gaussians or BadInput, nothing else."""
    good = ply_bytes(properties(some_gaussians(12, 1)))
    outcomes = read_or_refuse(lambda path: read_ply(path, report=str), tmp_path / "a.ply", damaged(good, 400))
    assert min(outcomes.values()) > 50


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.ply"
    path.write_bytes(b"precious")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(BadInput, match="No space left"):
        write_ply(path, some_gaussians())
    assert path.read_bytes() == b"precious" and [p.name for p in tmp_path.iterdir()] == ["a.ply"]
    with pytest.raises(BadInput, match="does not exist"):
        write_ply(tmp_path / "none" / "a.ply", some_gaussians())


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


@pytest.mark.shared
def test_a_point_cloud_is_no_splat(shared):
    assert "'f_dc_0'" in refused(shared / "data" / "captures" / "bear" / "sparse_pc.ply")
