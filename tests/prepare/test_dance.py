"""A standing person's splat takes over the dance of a rig that is not its own, found without a landmarks file."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.animation import linear_blend_skinning
from assets.asset import Asset
from assets.formats.gltf import read_rig
from core.tetmesh import TET_EDGES
from prepare.pipeline import Options
from prepare.prepared_files import prepare_file
from prepare.rig.skin_weights import least_volumes
from tests.support.animated_shapes import animated_shapes


@pytest.fixture(scope="module")
def dancer(shared, ti_cpu, tmp_path_factory):
    """The standing man with another one's dance, found without a landmarks file."""
    out = tmp_path_factory.mktemp("dancer") / "dancer.h5"
    splats, rig = shared / "data/splats/biker_human.ply", shared / "data/rigs/win-dance.glb"
    options = Options(vertices=2000, up="-y", scale=1.75)
    prepare_file(splats, out, options, rig=rig, progress=lambda *_: None, report=lambda _: None)
    return Asset.load(out)


def test_the_landmarks_of_a_standing_man_are_found(dancer):
    marks, size = dancer.provenance["rig"]["landmarks"], np.ptp(dancer.cage.vertices[:, 1])
    at = {n: np.array(m["at"]) / size for n, m in marks.items()}
    assert all(m["from"] == "solid" for m in marks.values())
    # He looks along -x, a quarter turn to the left of +z, and his left hand is on the side of +z.
    for limb, height in (("shoulder", 0.8), ("elbow", 0.65), ("wrist", 0.54), ("knee", 0.3), ("ankle", 0.07)):
        left, right = at[f"left_{limb}"], at[f"right_{limb}"]
        assert left[2] > 0.05 > -0.03 > right[2]
        assert abs(left[1] - height) < 0.06 and abs(right[1] - height) < 0.06
    for s in ("left", "right"):
        assert at[f"{s}_foot"][0] < at[f"{s}_ankle"][0] - 0.02
    assert max(dancer.provenance["rig"]["residual"].values()) < 0.03 * size


HELMET = (-0.13, 0.78, -0.17), 0.13  # measured on a picture [m]


def test_what_he_holds_is_found_and_stays_whole(dancer):
    """His helmet, that lies against hip and thigh, goes with his right hand: all of it turns as one."""
    (found,) = dancer.provenance["rig"]["held"]
    assert found["by"] == "right_hand"
    assert np.linalg.norm(np.subtract(found["center"], HELMET[0])) < 0.04
    means = dancer.gaussians.means
    mine = np.linalg.norm(means - HELMET[0], axis=1) < HELMET[1]
    mine &= 1 / (1 + np.exp(-dancer.gaussians.logit_opacities)) > 0.3
    assert mine.sum() > 1500
    a = dancer.animation
    rest = dancer.cage.vertices.astype(np.float64)
    hand = linear_blend_skinning(
        rest, np.full((len(rest), 1), a.names.index("right_wrist")), np.ones((len(rest), 1)), a.matrices(2.0)
    )
    x = rest.copy()
    x[a.vertices] = a.skinned(rest[a.vertices], a.matrices(2.0))
    inner = np.setdiff1d(np.arange(len(rest)), a.vertices)
    x[inner] = hand[inner]  # what is deep inside is not looked at here
    e = dancer.embedding
    moved = np.einsum("nkj,nkjd->nkd", e.weights[mine], x[dancer.cage.tets[e.host[mine]]]).mean(1)
    as_one = np.einsum("nkj,nkjd->nkd", e.weights[mine], hand[dancer.cage.tets[e.host[mine]]]).mean(1)
    assert np.percentile(np.linalg.norm(moved - as_one, axis=1), 97) < 0.03


@pytest.mark.parametrize("seconds", [1.5, pytest.param(None, marks=pytest.mark.long)])
def test_a_man_dances_without_tearing(dancer, shared, seconds):
    """Through the dance no tet is inverted, no edge much longer, and next to no Gaussian a spike."""
    a, cage = dancer.animation, dancer.cage
    rig, _ = read_rig(shared / "data/rigs/win-dance.glb")
    assert_allclose(a.duration, (len(rig.frames[0]) - 1) / rig.fps, rtol=1e-9)
    rest = cage.vertices.astype(np.float64)
    shapes = np.stack([rest, *animated_shapes(dancer, seconds=seconds)])
    least = least_volumes(cage.tets, shapes)
    assert least.min() > 0 and (least > 0.4).mean() > 0.99
    ends = cage.tets[:, TET_EDGES].reshape(-1, 2)
    stretch = np.linalg.norm(shapes[:, ends[:, 0]] - shapes[:, ends[:, 1]], axis=2)
    stretch = (stretch / stretch[0]).max(0)
    assert stretch.max() < 4.5 and (stretch < 2).mean() > 0.99
    e = dancer.embedding
    corner = np.einsum("nkj,nkjd->nkd", e.weights, rest[cage.tets[e.host]])
    inverse = np.linalg.inv(corner[:, 1:] - corner[:, :1])
    for x in shapes[:: len(shapes) // 6]:
        moved = np.einsum("nkj,nkjd->nkd", e.weights, x[cage.tets[e.host]])
        growth = np.linalg.norm(inverse @ (moved[:, 1:] - moved[:, :1]), ord=2, axis=(1, 2))
        assert (growth < 2.5).mean() > 0.999
