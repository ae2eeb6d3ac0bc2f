"""Bodies that stand: started as they rest, stiff enough to bear their own weight (against the theory of columns), and
without a thin flap from which they would topple; legs, stems and tips are no flaps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from assets.gaussians import concatenate
from assets.library import SHIPPED_FOLDER
from core.material import MATERIALS
from core.tetmesh import box_mesh
from display.protocol import Frame
from prepare.cage.level_set import ComponentSolid
from prepare.pipeline import Options, fill_components
from prepare.prepared_files import prepare_file
from prepare.progress import Checkpoints, no_progress
from prepare.standing import (
    UPRIGHT,
    bearing_modulus,
    described,
    flap_of,
    lean_at_rest,
    rounded_up,
    stood_up,
    suitable_material,
)
from scenes import sandbox
from tests.support.scripted_play import blind_world
from tests.support.shells import shell


def leaning(name: str, degrees: float) -> tuple[Asset, ComponentSolid]:
    """A shipped body that leans sideways, and its distance grid as a solid."""
    asset = Asset.load(SHIPPED_FOLDER / f"{name}.h5").transformed(
        Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    )
    inside = asset.sdf.values < 0
    return asset, ComponentSolid(inside & (np.indices(inside.shape)[0] % 2 == 0), inside, asset.sdf)


def test_a_leaning_body_is_set_upright():
    """Half of the solid's cells are shell, as before; its distances stay those of the cage."""
    bear, (asset, solid) = Asset.load(SHIPPED_FOLDER / "bear.h5"), leaning("bear", 8.0)
    upright, (turned,) = stood_up(asset, [solid])
    assert upright.provenance["stood_up"] == pytest.approx(8.0, abs=1.0) and "reoriented" in asset.provenance
    turn = Rotation.align_vectors(*(b.cage.vertices - b.cage.vertices.mean(0) for b in (upright, bear)))[0]
    assert turn.magnitude() < np.radians(0.5) and upright.cage.vertices[:, 1].min() == pytest.approx(0.0, abs=1e-6)
    assert turned.solid.sum() == pytest.approx(solid.solid.sum(), rel=0.05)
    assert turned.shell.sum() == pytest.approx(solid.shell.sum(), rel=0.1)
    assert (turned.distance.values[turned.solid] < turned.distance.spacing).all()
    assert turned.distance.values.shape == turned.solid.shape


@pytest.mark.parametrize("degrees", [0.2, 40.0])
def test_what_stands_or_falls_stays_as_it_is(degrees):
    asset, solid = leaning("bear", degrees)
    assert stood_up(asset, [solid]) == (asset, [solid])


PLUSH = MATERIALS["plush"]
G = 9.81


def column(width: float, height: float, across: int):
    """Vertices and tets of an upright column of square cross section, with cubic cells."""
    x, tets, _ = box_mesh((width, height, width), (across, round(across * height / width), across))
    return x, tets


def test_a_slender_column_keeps_away_from_buckling():
    """A column of width b buckles at q L^3 = 7.84 EI: E = 12 rho g L^3 / (7.84 b^2); we want five times that.

    The foot that is held takes 8 % of the length; linear tets are too stiff in bending, with six across by 10 %.
    """
    b, length = 0.05, 0.5
    wanted = 5 * 12 * PLUSH.density * G * (0.92 * length) ** 3 / (7.84 * b * b)
    assert bearing_modulus(*column(b, length, 6), PLUSH) == pytest.approx(wanted, rel=0.25)


def test_a_stout_body_is_measured_by_its_sag():
    """A wide slab is shortened by its weight: mean strain rho g h / 2E of at most 5 %, with nothing to the sides."""
    x, tets, _ = box_mesh((1.0, 0.2, 1.0), (10, 4, 10))
    flat = replace(PLUSH, poisson=0.0)
    assert bearing_modulus(x, tets, flat) == pytest.approx(PLUSH.density * G * 0.2 / (2 * 0.05), rel=0.25)


def test_it_grows_with_the_cube_of_the_slenderness_and_with_the_size():
    thin, thick = (bearing_modulus(*column(b, 0.4, 3), PLUSH) for b in (0.04, 0.08))
    x, tets = column(0.04, 0.4, 3)
    assert thin > 2.5 * thick
    assert bearing_modulus(3 * x, tets, PLUSH) == pytest.approx(3 * thin, rel=1e-3)  # the dimensions of stress
    assert bearing_modulus(x, tets, replace(PLUSH, density=200.0)) == pytest.approx(2 * thin, rel=1e-6)


def test_iteration_and_elimination_agree(monkeypatch):
    x, tets = column(0.05, 0.3, 4)
    direct = bearing_modulus(x, tets, PLUSH)
    monkeypatch.setattr("prepare.standing.DIRECT_SIZE", 0)
    assert bearing_modulus(x, tets, PLUSH) == pytest.approx(direct, rel=1e-2)


def test_of_several_pieces_each_must_stand():
    (x, tets), (y, other) = column(0.05, 0.5, 3), column(0.2, 0.2, 3)
    both = np.concatenate([x, y + [1.0, 0.3, 0.0]]), np.concatenate([tets, other + len(x)])
    assert bearing_modulus(*both, PLUSH) == pytest.approx(bearing_modulus(x, tets, PLUSH))


def test_a_body_on_an_edge_is_measured_by_what_it_falls_onto():
    """A cube that leans stands on no edge: the lowest part with its middle above it counts."""
    x, tets = column(0.2, 0.2, 4)
    c, s = np.cos(0.35), np.sin(0.35)
    assert bearing_modulus(x @ [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], tets, PLUSH) < PLUSH.young


def test_a_plush_stays_soft_and_a_slender_figure_is_stiffened():
    material, found = suitable_material(*column(0.2, 0.25, 4))
    assert material == PLUSH and "plush; it needs" in described(found)
    material, found = suitable_material(*column(0.04, 0.5, 3))
    assert (
        material == replace(PLUSH, young=found["young"]) and found["needed"] <= found["young"] <= 2.5 * found["needed"]
    )
    assert "stiffened from 1e+04 to" in described(found)


def test_moduli_are_round():
    for young, rounded in ((1e4, 1e4), (1.01e4, 2e4), (3e5, 5e5), (5.1e5, 1e6), (99.0, 100.0)):
        assert rounded_up(young) == pytest.approx(rounded)


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
