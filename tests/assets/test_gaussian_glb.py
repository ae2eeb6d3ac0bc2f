"""Splats as .glb (KHR_gaussian_splatting): files built by hand, round trips, nodes, and what cannot be."""

import json
from dataclasses import replace

import numpy as np
import pytest

from assets.formats.gaussian_glb import object_order, write_glb
from assets.formats.gltf import GlbFile
from assets.splat_files import is_mesh, kind_of, read_gaussians, write_gaussians
from core.errors import BadInput
from tests.support.glb import Builder
from tests.support.samples import assert_is_image, some_gaussians

KHR = "KHR_gaussian_splatting"
FIELDS = ("means", "log_scales", "logit_opacities", "sh", "quats")


def hand_made(g, nodes=None, *, logs=False, **about) -> tuple[Builder, dict]:
    """A .glb built attribute by attribute from the extension's text; about: more of its properties."""
    b, attributes = Builder(), {}
    attributes["POSITION"] = b.array(g.means)
    attributes[f"{KHR}:ROTATION"] = b.array(np.roll(g.quats, -1, axis=1))
    attributes[f"{KHR}:SCALE"] = b.array(g.log_scales if logs else np.exp(g.log_scales))
    attributes[f"{KHR}:OPACITY"] = b.array(np.round(255 * g.opacities), "u1", normalized=True)
    for k in range(g.sh.shape[1]):
        degree = int(k**0.5)
        attributes[f"{KHR}:SH_DEGREE_{degree}_COEF_{k - degree**2}"] = b.array(g.sh[:, k])
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"} | about
    primitive = {"attributes": attributes, "mode": 0, "extensions": {KHR: extension}}
    scene = b.json(meshes=[{"primitives": [primitive]}], nodes=nodes or [{"mesh": 0}], extensionsUsed=[KHR])
    return b, scene | {"extensionsRequired": [KHR]}


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("logs", [False, True])
def test_a_file_built_by_hand_is_read(tmp_path, degree, logs):
    """Drafts of the extension stored the logs of the scales."""
    g = some_gaussians(20, degree)
    builder, scene = hand_made(g, logs=logs)
    path = builder.write(tmp_path / "a.glb", scene)
    read = read_gaussians(path, pytest.fail)
    assert kind_of(path) == "either" and not is_mesh(path)
    for name in ("means", "log_scales", "sh", "quats"):
        np.testing.assert_allclose(getattr(read, name), getattr(g, name), atol=2e-6)
    np.testing.assert_allclose(read.opacities, g.opacities, atol=1 / 510 + 1e-6)
    assert (read.sort, read.antialias) == ("radial", False)


def test_what_is_not_drawn_as_the_file_says_is_told(tmp_path):
    lines, (builder, scene) = [], hand_made(some_gaussians(9), kernel="cone", sortingMethod="zDepth")
    scene["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 0})
    assert read_gaussians(builder.write(tmp_path / "a.glb", scene), lines.append).sort == "z"
    assert len(lines) == 1 and "kernel 'cone'" in lines[0] and "points" in lines[0]


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("sort", ["z", "radial", "pixel"])
def test_what_is_written_comes_back(tmp_path, degree, sort):
    g = replace(some_gaussians(30, degree), sort=sort, antialias=sort == "z", objects=("bear", "cup"))
    g = replace(g, object_id=np.arange(30).astype(np.uint16) % 3)
    write_gaussians(tmp_path / "a.glb", g, pytest.fail)
    read, g = read_gaussians(tmp_path / "a.glb", pytest.fail), g.select(object_order(g))
    for name in FIELDS:
        np.testing.assert_allclose(getattr(read, name), getattr(g, name), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(read.object_id, g.object_id)
    assert (read.objects, read.sort, read.antialias) == (g.objects, g.sort, g.antialias)


def test_a_single_object_keeps_its_name(tmp_path):
    g = replace(some_gaussians(5), object_id=np.ones(5, np.uint16), objects=("bear",))
    write_glb(tmp_path / "a.glb", g)
    assert read_gaussians(tmp_path / "a.glb").objects == ("bear",)


def test_nodes_turn_stretch_and_mirror(tmp_path):
    """Means, covariances and the colour seen along a turned direction follow the chain of the nodes."""
    g, half = some_gaussians(12, 3), np.sqrt(0.5)
    turned = {"name": "turned", "rotation": [0, half, 0, half], "scale": [2, 2, 2], "translation": [1, 2, 3]}
    mirrored = {"name": "mirrored", "mesh": 0, "scale": [-1, 2, 0.5]}
    builder, scene = hand_made(g, [turned | {"children": [1, 2]}, {"mesh": 0, "name": "plain"}, mirrored])
    read = read_gaussians(builder.write(tmp_path / "a.glb", scene), pytest.fail)
    R = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]])
    for k, S in enumerate((np.eye(3), np.diag([-1, 2, 0.5]))):
        assert_is_image(read.select(read.object_id == k + 1), g, 2 * R @ S, R @ np.sign(S), (1, 2, 3))
    assert read.objects == ("plain", "mirrored")


def broken(change) -> dict:
    builder, scene = hand_made(some_gaussians(9, 1))
    primitive = scene["meshes"][0]["primitives"][0]
    change(scene, primitive, primitive["attributes"])
    return builder, json.loads(json.dumps(scene))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s, p, a: a.pop(f"{KHR}:SCALE"), "lack the attribute .*SCALE"),
        (lambda s, p, a: a.pop(f"{KHR}:SH_DEGREE_1_COEF_2"), "lack the attribute .*COEF_2"),
        (lambda s, p, a: a.update({f"{KHR}:OPACITY": 0}), "of type VEC3, expected SCALAR"),
        (lambda s, p, a: p.update(mode=4), "primitive of splats is damaged"),
        (lambda s, p, a: p["extensions"].update({KHR: 3}), "primitive of splats is damaged"),
        (lambda s, p, a: s["nodes"].clear(), "holds no Gaussians"),
        (lambda s, p, a: s["nodes"][0].update(scale=[1, 0, 1]), "flattens|damaged|shears"),
        (lambda s, p, a: s["nodes"][0].update(scale=[1e20] * 3), "not finite|cannot|flattens"),
        (lambda s, p, a: s["extensionsRequired"].append(KHR + "_compression_spz_2"), "requires the extension"),
        (lambda s, p, a: s.update(nodes=[{"mesh": 0}] * 5000), "5000 nodes"),
        (lambda s, p, a: s["accessors"][0].update(count=2), "expected 2"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, change, words):
    builder, scene = broken(change)
    with pytest.raises(BadInput, match=words) as e:
        read_gaussians(builder.write(tmp_path / "a.glb", scene))
    assert "\n" not in str(e.value)


def test_nodes_that_repeat_a_mesh_are_bounded_by_the_size_of_the_file(tmp_path):
    g = some_gaussians(20_000)
    builder, scene = hand_made(g, [{"mesh": 0}] * 4000)
    with pytest.raises(BadInput, match="more often"):
        read_gaussians(builder.write(tmp_path / "a.glb", scene))


def test_other_readers_find_points_with_colours(tmp_path):
    """Bounds of the positions and COLOR_0 are there, for programs that do not know the extension."""
    g = some_gaussians(30, 2)
    write_glb(tmp_path / "a.glb", g)
    file = GlbFile(tmp_path / "a.glb")
    attributes = file.json["meshes"][0]["primitives"][0]["attributes"]
    position = file.json["accessors"][attributes["POSITION"]]
    np.testing.assert_array_equal([position["min"], position["max"]], [g.means.min(0), g.means.max(0)])
    colour = file.accessor(attributes["COLOR_0"], kinds=("VEC4",), count=30)
    np.testing.assert_allclose(colour[:, 3], g.opacities, atol=1 / 255)
