"""Thin flaps under a body: one from which it would topple is no part of its cage; legs, stems and tips are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets.gaussians import concatenate
from display.protocol import Frame
from prepare.pipeline import Options, fill_components
from prepare.prepared_files import prepare_file
from prepare.progress import Checkpoints, no_progress
from prepare.standing import UPRIGHT, flap_of, lean_at_rest
from scenes import sandbox
from tests.support.scripted_play import blind_world
from tests.support.shells import shell

SHAPE = (60, 70, 60)


def boxes(*ranges) -> np.ndarray:
    """Cells in boxes, each ((x0, x1), (y0, y1), (z0, z1))."""
    cells = np.zeros(SHAPE, bool)
    for r in ranges:
        cells[tuple(slice(*ends) for ends in r)] = True
    return cells


BODY = ((10, 50), (20, 64), (10, 50))
FEET = [((x, x + 9), (14, 20), (z, z + 9)) for x in (10, 41) for z in (10, 41)]
LABEL = ((30, 42), (6, 20), (22, 25))
THIN_LEGS = [((x, x + 3), (6, 20), (z, z + 3)) for x in (10, 47) for z in (10, 47)]
x, y, z = np.indices(SHAPE)
EGG = ((x - 30) / 16) ** 2 + ((y - 33) / 28) ** 2 + ((z - 30) / 16) ** 2 < 1


def test_a_label_below_the_feet_is_a_flap():
    """All of it below the feet, nothing else; without it the body stands."""
    cells, label = boxes(BODY, *FEET, LABEL), boxes((LABEL[0], (6, 14), LABEL[2]))
    assert lean_at_rest(cells) > UPRIGHT
    assert (flap_of(cells) == label).all()
    assert lean_at_rest(cells & ~label) == 0.0


@pytest.mark.parametrize(
    "cells",
    [
        boxes(BODY, *FEET),
        boxes(BODY, *THIN_LEGS),  # it stands on them
        boxes(BODY, *FEET, ((30, 42), (16, 20), (22, 25))),  # a label above the ground
        EGG,  # stands on nothing, but a tip is no flap
        boxes(BODY, ((26, 30), (6, 20), (24, 42))),  # a keel: it topples, and would stand without, but that is large
        boxes(BODY, FEET[0], LABEL),  # it topples without the label, too
    ],
    ids=["feet", "legs", "short", "egg", "keel", "one foot"],
)
def test_other_parts_are_no_flaps(cells):
    assert not flap_of(cells).any()


def test_the_nearest_face_to_upright_is_the_one_rested_on():
    assert lean_at_rest(boxes(BODY)) == 0.0
    assert lean_at_rest(boxes(((10, 11), (0, 60), (10, 11)))) == 0.0  # a line has no faces
    wedge = boxes(BODY) & (y - 20 > 0.2 * (x - 10))
    assert lean_at_rest(wedge) == pytest.approx(np.degrees(np.arctan(0.2)), abs=1.0)


def box(ends, n: int):
    """Discs on the faces of a box, given by ((x0, x1), (y0, y1), (z0, z1)), n of them."""
    rng, (low, high) = np.random.default_rng(n), np.array(ends, float).T / 64
    size = high - low
    area = np.repeat([size[1] * size[2], size[2] * size[0], size[0] * size[1]], 2)
    face = rng.choice(6, n, p=area / area.sum())
    points, normals = rng.uniform(low, high, (n, 3)), np.zeros((n, 3))
    every, axis, side = np.arange(n), face // 2, face % 2
    points[every, axis] = np.where(side, high[axis], low[axis])
    normals[every, axis] = 2 * side - 1
    return shell(points, normals, sigma=np.sqrt(area.sum() * 2 / n) / 2)


def test_gaussians_of_a_flap_stay_without_tets(ti_cpu):
    """A block on four feet with a label: the solid ends at the feet, the Gaussians of the label stay."""
    parts = [(BODY, 4000), *((f, 400) for f in FEET), (LABEL, 500)]
    g = concatenate([box(r, n) for r, n in parts])
    (found,) = fill_components(g, np.zeros(len(g), int), Options(vertices=300), no_progress, Checkpoints())
    below = g.means[:, 1] < (FEET[0][1][0] - 1) / 64
    assert below.sum() > 150 and found.in_flap(g)[below].mean() > 0.9
    assert len(found.indices) == len(g) and found.in_flap(g)[: 4000 + 4 * 400].sum() == 0
    foot = found.box()[0][1]
    assert foot == pytest.approx(FEET[0][1][0] / 64, abs=2 * found.grid.spacing)


@pytest.mark.long
@pytest.mark.shared
def test_a_toy_with_a_label_stands(ti_cpu, shared, tmp_path):
    """Dropped in the sandbox, two seconds later it leans by a few degrees; its label was lower than its feet."""
    said = []
    source = shared / "data" / "splats" / "toy_cat.ply"
    prepare_file(source, tmp_path / "cat.h5", Options(vertices=300, up="-y"), report=said.append)
    assert any("Gaussians under it, on which it would topple" in line for line in "\n".join(said).splitlines())
    world = blind_world(sandbox.build((str(tmp_path / "cat.h5"),)))
    rest = world.device.solver.snapshot()["x"]
    for k in range(120):
        world.step(Frame(1 / 60, k / 60, [], []))
    turn = Rotation.align_vectors(*(x - x.mean(0) for x in (world.device.solver.snapshot()["x"], rest)))[0]
    assert np.degrees(np.arccos(turn.as_matrix()[1, 1])) < 20.0
