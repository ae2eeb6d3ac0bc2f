"""Things taken in the hand in study and attic: bricks, boxes, ball and bear of jelly; and letters on their faces."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.rotation import matrices_from_quaternions
from scenes import box_moving, table_brick_game
from sim.bodies import RigidBody, SoftBody
from studio.attic import attic_shell, boxes
from studio.catalogue import BOXES, BRICKS, build_model
from studio.detail import Detail
from studio.glyphs import glyph, sampled
from studio.handled import box_cage, solid_cage, solid_grid
from studio.solids import sphere
from studio.study import bricks, elastic_toys, study_shell, writing_table

COARSE = Detail(gaussians=0.3)


def silent(line: str) -> None:
    """Take no note."""


@pytest.fixture(scope="module")
def model(ti_cpu):
    made = {}

    def make(name: str, detail: Detail = COARSE):
        if (name, detail) not in made:
            made[name, detail] = build_model(name, detail, silent)
        return made[name, detail]

    return make


def test_scenes_repeat_the_measures_of_the_models():
    assert (table_brick_game.TABLE_TOP, table_brick_game.TABLE_HALF) == (
        writing_table.TABLE_TOP,
        writing_table.TABLE_HALF,
    )
    assert (
        table_brick_game.BALL_RING == writing_table.BALL_RING
        and table_brick_game.BALL_RADIUS == elastic_toys.BALL_RADIUS
    )
    assert (table_brick_game.ROOM_LOW, table_brick_game.ROOM_HIGH) == (study_shell.ROOM_LOW, study_shell.ROOM_HIGH)
    assert table_brick_game.PLANK == bricks.PLANK and bricks.CUBE == (table_brick_game.CUBE,) * 3
    assert (box_moving.KNEE, box_moving.RIDGE) == (attic_shell.KNEE, attic_shell.RIDGE)
    assert (box_moving.FAR, box_moving.NEAR) == (attic_shell.Z0, attic_shell.Z1)
    assert (*attic_shell.HOLE_X, attic_shell.HOLE_HEIGHT) == box_moving.HOLE
    assert box_moving.SIZES == boxes.SIZES and box_moving.PALLET == (boxes.PALLET_AT, boxes.PALLET_SIZE)


@pytest.mark.parametrize("name", [*BRICKS, *BOXES])
def test_a_box_fills_its_cage_and_is_a_box_to_touch(name, model):
    """Gaussians lie on the faces of the box that is simulated, all of them; as a rigid body its collider is exact."""
    asset = model(name)
    size = np.array(boxes.SIZES.get(name) or (bricks.CUBE if name in bricks.LETTERS else bricks.PLANK))
    x = asset.cage.vertices.astype(float)
    assert_allclose([x.min(0), x.max(0)], [-size / 2, size / 2], atol=1e-6)
    beyond = (np.abs(asset.gaussians.means) - size / 2).max(1)
    assert beyond.max() < 0.002 and np.quantile(beyond, 0.1) > -0.03  # string stands out by its thickness
    sides = {(k, s) for k in range(3) for s in (-1, 1) if (s * asset.gaussians.means[:, k] > 0.47 * size[k]).sum() > 5}
    assert len(sides) == 6
    soft = SoftBody(name, x, asset.cage.tets, asset.cage.surface, asset.material)
    assert RigidBody.from_soft(soft).boxed
    rest = x[asset.cage.tets[asset.embedding.host]]
    corners = np.einsum("nkj,nkjc->nkc", asset.embedding.weights, rest)
    assert_allclose(corners.mean(1), asset.gaussians.means, atol=2e-4)


def test_only_whole_boxes_about_their_origin_count_as_boxes():
    cage = box_cage((0.1, 0.2, 0.3), 60)
    x, tets = cage.vertices.astype(float), cage.tets

    def boxed(vertices, kept=slice(None)):
        body = SoftBody("body", vertices, tets[kept], cage.surface, boxes.MATERIALS["box_crate"])
        return RigidBody.from_soft(body).boxed

    assert len(x) >= 60 and boxed(x) and boxed(0.5 * x)
    assert not boxed(x + 0.01) and not boxed(x, slice(1, None)) and not boxed(x * (1 + 0.1 * (x[:, :1] > 0.04)))


def test_boxes_have_the_vertices_that_are_asked_for():
    for wanted in (8, 100, 700):
        assert wanted <= len(box_cage((0.46, 0.36, 0.38), wanted).vertices) < 1.6 * wanted


@pytest.mark.parametrize(("name", "low", "high"), [("rubber_ball", 150, 175), ("jelly_bear", 190, 250)])
def test_elastic_toys_are_ready_to_be_simulated(name, low, high, model):
    asset = model(name)
    assert low <= len(asset.cage.vertices) <= high and (asset.cage.volumes() > 0).all()
    solid = sphere((0, 0, 0), elastic_toys.BALL_RADIUS) if name == "rubber_ball" else elastic_toys.bear_distance
    assert np.abs(solid(asset.gaussians.means.astype(float))).max() < 0.002
    inside = solid(np.array([[0.0, 0.025, 0.0]]))[0]
    assert_allclose(asset.sdf.sample(np.array([[0.0, 0.025, 0.0]]))[0], inside, atol=0.003)
    thin = matrices_from_quaternions(asset.gaussians.quats)[:, :, 2]
    step = 1e-4
    out = np.stack([solid(asset.gaussians.means + step * e) - solid(asset.gaussians.means - step * e)
                    for e in np.eye(3)], 1) / (2 * step)  # fmt: skip
    assert np.median(np.abs((thin * out).sum(1))) > 0.97  # flat on the surface


def test_the_bear_sits_on_a_broad_base():
    """Its centre of mass is above the points that it stands on, well inside."""
    p = np.stack(np.meshgrid(*(np.arange(-0.045, 0.09, 0.0015),) * 3, indexing="ij"), -1).reshape(-1, 3)
    body = p[elastic_toys.bear_distance(p) < 0]
    base = body[body[:, 1] < 0.002]
    centre = body.mean(0)
    for axis in (0, 2):
        assert base[:, axis].min() + 0.012 < centre[axis] < base[:, axis].max() - 0.012


def test_a_solid_gets_a_cage_as_fine_as_is_asked_for(ti_cpu):
    grid = solid_grid(sphere((0, 0, 0), 0.04), (-0.04,) * 3, (0.04,) * 3, 1500)
    assert 1270 <= len(solid_cage(grid, 1500).vertices) <= 1730


def test_letters_are_upright_and_not_mirrored():
    """An L has its foot at the lower right: in its picture, and on each face of a box as one looks at it."""
    picture = glyph("L")
    ink = [sampled(picture, np.array([u]), np.array([v]))[0] for u, v in ((0.3, -0.75), (-0.3, 0.4), (0.4, 0.4))]
    assert ink[0] > 0.5 > ink[2] and sampled(picture, np.array([1.2]), np.array([0.0]))[0] == 0
    for n in np.concatenate([np.eye(3), -np.eye(3)]):
        p = np.array([[0.1, 0.15, 0.2]]) * n + np.array([[0.01, 0.013, 0.017]]) * (1 - np.abs(n))
        _, right, up = boxes.face_coordinates(p, n[None], (0.2, 0.3, 0.4))
        e = 1e-3
        moved = [boxes.face_coordinates(p + e * d, n[None], (0.2, 0.3, 0.4))[1:] for d in np.eye(3)]
        to_right = np.array([(m[0] - right)[0] / e for m in moved])
        to_up = np.array([(m[1] - up)[0] / e for m in moved])
        assert_allclose(np.cross(to_right, to_up), n, atol=1e-6)
