"""Binary glTF: what is read is what was written, and nothing damaged gets past in more than one line."""

import functools
import json
import re
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.animation import linear_blend_skinning, world_matrices
from assets.formats.gltf import PIXELS_MAX, GlbFile, read_mesh, read_rig
from tests.support import samples
from tests.support.glb import CODES, TIMES, Builder, bar, packed


def whole(path):
    rig, file = read_rig(path)
    return rig, read_mesh(file, len(rig.joints))


refused = functools.partial(samples.refused, read=whole)


@pytest.mark.parametrize("dtype", CODES)
def test_every_component_type_is_read_plain_and_normalised(tmp_path, dtype):
    b = Builder()
    low, high = (-1e3, 1e3) if dtype == "f4" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    values = np.array([[low, high, 0], [1, 2, 3]], np.float64)
    at = b.array(values, dtype), b.array(values, dtype, normalized=True)
    file = GlbFile(b.write(tmp_path / "a.glb", b.json()))
    assert_allclose(file.accessor(at[0], kinds=("VEC3",)), values)
    expected = values if dtype == "f4" else np.maximum(values / high, -1.0)  # the specification's formula
    assert_allclose(file.accessor(at[1], kinds=("VEC3",)), expected, atol=1e-7)


def test_interleaved_and_sparse_accessors(tmp_path):
    b = Builder()
    rows = np.arange(20, dtype="<f4").reshape(4, 5)
    view = b.view(rows.tobytes(), byteStride=20)
    b.accessors.append({"bufferView": view, "byteOffset": 8, "componentType": 5126, "count": 4, "type": "VEC3"})
    where, what = b.view(np.array([1, 3], "<u2").tobytes()), b.view(np.full(6, 7, "<f4").tobytes())
    sparse = {"count": 2, "indices": {"bufferView": where, "componentType": 5123}, "values": {"bufferView": what}}
    b.accessors.append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    b.accessors.append({**b.accessors[0], "sparse": sparse})
    file = GlbFile(b.write(tmp_path / "a.glb", b.json()))
    assert_allclose(file.accessor(0, kinds=("VEC3",)), rows[:, 2:])
    assert_allclose(file.accessor(1, kinds=("VEC3",)), [[0] * 3, [7] * 3, [0] * 3, [7] * 3])
    assert_allclose(file.accessor(2, kinds=("VEC3",))[[0, 2]], rows[[0, 2], 2:])
    assert_allclose(file.accessor(2, kinds=("VEC3",))[[1, 3]], 7)


def test_a_bar_bends_as_its_file_says(tmp_path):
    b, scene = bar()
    rig, mesh = whole(b.write(tmp_path / "bar.glb", scene))
    assert set(rig.names) == {"lower", "upper", "node 2"}
    world = world_matrices(rig.parents, rig.frames)[:, rig.joints] @ rig.inverse_bind
    assert_allclose(linear_blend_skinning(mesh.vertices, mesh.joints, mesh.weights, world[0]), mesh.vertices, atol=1e-7)
    at_90 = round(0.5 * rig.fps)
    top = linear_blend_skinning(mesh.vertices, mesh.joints, mesh.weights, world[at_90])[-4:]
    assert_allclose(top.mean(0), [-0.5, 0.5, 0], atol=1e-6)  # (0, 1, 0) turned about (0, 0.5, 0)
    at_45 = linear_blend_skinning(mesh.vertices, mesh.joints, mesh.weights, world[round(0.25 * rig.fps)])[-4:].mean(0)
    assert_allclose(at_45, [-0.5 * np.sqrt(0.5), 0.5 + 0.5 * np.sqrt(0.5), 0], atol=1e-6)  # slerp, at the half
    assert_allclose(mesh.weights.sum(1), 1)
    assert mesh.textures[0][0].tolist() == [[0, 0, 0], [255, 0, 0]]


def test_step_holds_and_the_cubic_spline_is_hermites(tmp_path):
    for kind in ("STEP", "CUBICSPLINE"):
        b, scene = bar()
        moves = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], np.float64)
        tangent = np.array([0.0, 2.0, 0.0])
        rows = np.stack([0 * moves + tangent, moves, 0 * moves + tangent], 1).reshape(-1, 3)
        sampler = {"input": 6, "output": b.array(moves if kind == "STEP" else rows), "interpolation": kind}
        sampler["input"] = scene["animations"][0]["samplers"][0]["input"]
        scene["animations"][0]["samplers"].append(sampler)
        scene["animations"][0]["channels"].append({"sampler": 1, "target": {"node": 0, "path": "translation"}})
        rig, _ = read_rig(b.write(tmp_path / f"{kind}.glb", b.json(**scene)
                                     | {"buffers": [{"byteLength": len(b.binary)}]}))  # fmt: skip
        moved = rig.frames[0][:, rig.names.index("lower")]
        k = round(0.3 * rig.fps)  # at 0.8 s, 0.6 of the way from the first key to the second, 0.5 s later
        if kind == "STEP":
            assert_allclose(moved[k], moves[0])
            assert_allclose(moved[-1], moves[-1])
        else:
            u, dt = k / rig.fps / 0.5, 0.5
            h = [2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, 3 * u**2 - 2 * u**3, u**3 - u**2]
            expected = h[0] * moves[0] + h[2] * moves[1] + dt * (h[1] + h[3]) * tangent
            assert_allclose(moved[k], expected, atol=1e-6)


def test_a_cubic_spline_reproduces_a_cubic_motion(tmp_path):
    """Of Hermite's interpolation between keys at uneven times, with the tangents of each side, whatever the cubic."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(4, 3))
    at, slope = (
        (lambda t: sum(a[k] * t**k for k in range(4))),
        (lambda t: sum(k * a[k] * t ** (k - 1) for k in (1, 2, 3))),
    )
    b, scene = bar()
    keys = TIMES[:, None]
    rows = np.stack([slope(keys), at(keys), slope(keys)], 1).reshape(-1, 3)
    animation = scene["animations"][0]
    times = animation["samplers"][0]["input"]
    animation["samplers"].append({"input": times, "output": b.array(rows), "interpolation": "CUBICSPLINE"})
    animation["channels"].append({"sampler": 1, "target": {"node": 0, "path": "translation"}})
    rig, _ = read_rig(b.write(tmp_path / "a.glb", scene | {"buffers": [{"byteLength": len(b.binary)}]}))
    moved = rig.frames[0][:, rig.names.index("lower")]
    time = TIMES[0] + np.arange(len(moved))[:, None] / rig.fps
    assert_allclose(moved, at(time), atol=1e-5)


def changed(scene: dict, path: tuple, value):
    for key in path[:-1]:
        scene = scene[key]
    scene[path[-1]] = value


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("nodes", 1, "children"), [0], "ring|two parents"),
        (("nodes", 1, "rotation"), [0, 0, 0, 0], "quaternion"),
        (("nodes", 1, "translation"), [0, 1e400, 0], "finite"),
        (("nodes", 1, "translation"), "up", "numbers"),
        (("skins",), [], "no skin"),
        (("skins", 0, "joints"), [0, 0], "twice"),
        (("accessors", 0, "count"), 10**9, "count"),
        (("accessors", 0, "count"), 85, "more than its buffer view"),
        (("accessors", 0, "componentType"), 9999, "unknown"),
        (("accessors", 0, "byteOffset"), -4, "byteOffset"),
        (("bufferViews", 0, "byteLength"), 10**12, "byteLength"),
        (("bufferViews", 0, "buffer"), 1, "not there|another file"),
        (("buffers", 0, "uri"), "/etc/passwd", "another file"),
        (("images", 0), {"uri": "http://example.com/a.png"}, "another file"),
        (("animations",), [], "no animation"),
        (("animations", 0, "samplers", 0, "interpolation"), "MAGIC", "interpolation"),
        (("animations", 0, "channels", 0, "sampler"), 5, "sampler"),
        (("meshes", 0, "primitives", 0, "mode"), 5, "triangles"),
        (("extensionsRequired",), ["KHR_draco_mesh_compression"], "KHR_draco"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, path, value, says):
    b, scene = bar()
    changed(scene, path, value)
    assert re.search(says, refused(b.write(tmp_path / "bad.glb", scene)))


def test_a_damaged_container_is_refused(tmp_path):
    b, scene = bar()
    sound = packed(json.dumps(scene).encode(), b.binary)
    path = tmp_path / "d.glb"
    assert "truncated" in refused(path, sound[:-8])
    assert "version 1" in refused(path, sound[:4] + struct.pack("<I", 1) + sound[8:])
    assert "not a binary glTF" in refused(path, b"{}" * 20)
    assert "JSON" in refused(path, packed(b"[" * 100_000, b""))


def test_a_picture_bomb_is_refused_by_its_header(tmp_path):
    b, scene = bar()
    side = int(np.sqrt(PIXELS_MAX)) + 2
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", side, side) + b"\0" * 64
    scene["images"] = [{"bufferView": b.view(header)}]
    scene["buffers"] = [{"byteLength": len(b.binary)}]
    assert "pixels" in refused(b.write(tmp_path / "bomb.glb", scene))


def test_the_walking_man(shared):
    """At rest the skin is the mesh, bones keep their lengths, and the colours are there."""
    rig, mesh = whole(shared / "data/rigs/CesiumMan.glb")
    world = world_matrices(rig.parents, rig.rest)
    place = world[rig.joints[0]] @ rig.inverse_bind[0]
    still = linear_blend_skinning(mesh.vertices, mesh.joints, mesh.weights, world[rig.joints] @ rig.inverse_bind)
    assert_allclose(still, mesh.vertices @ place[:3, :3].T + place[:3, 3], atol=1e-5)
    joint = world_matrices(rig.parents, rig.frames)[:, :, :3, 3]
    bones = np.flatnonzero(np.isin(rig.parents, rig.joints))
    length = np.linalg.norm(joint[:, bones] - joint[:, rig.parents[bones]], axis=2)
    assert_allclose(length, np.broadcast_to(length[:1], length.shape), rtol=2e-3)  # its keys move joints by that
    assert mesh.textures[0].shape == (1024, 1024, 3) and (mesh.texture == 0).all()
