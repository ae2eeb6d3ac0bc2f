"""Objects cut out of a splat by strokes on its pictures."""

import json

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from assets.gaussians import Gaussians, concatenate, symmetric_matrices
from assets.splat_files import read_gaussians
from core.camera import directions_around, look_at, perspective
from core.errors import BadInput
from core.rotation import quaternions_from_matrices
from core.runtime import start_taichi
from core.spherical_harmonics import C0
from prepare.segment.graph_cut import (
    clearest_level,
    graph_of,
    mahalanobis,
    most_alike,
    neighbour_edges,
    random_walk,
)
from prepare.segment.marks import Marks, SplatMarks, ViewMarks, read_splat_marks, write_splat_marks
from prepare.segment.splat_segmentation import (
    halves,
    segment_splat,
    straddlers,
    trimmed,
    write_segmented,
)
from prepare.segment.splat_selection import (
    SEEN,
    Seeds,
    SplatSelection,
    ViewsAround,
    border_costs,
    distances,
    stroke_weights,
    view_seeds,
)

CAMERA = perspective(160, 120, 0.9, look_at((0.0, 0.9, 1.2), (0.0, 0.1, 0.0)))


def surfels(points, normals, size, colour) -> Gaussians:
    """Flat Gaussians on a surface, (N, 3) each."""
    n = np.asarray(normals, float)
    side = np.cross(n, np.where(np.abs(n[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(n, side), n], axis=2)
    scales = np.tile(np.log([size, size, 0.1 * size]), (len(points), 1))
    sh = np.tile((np.asarray(colour) - 0.5) / C0, (len(points), 1))[:, None]
    return Gaussians.of(points, quaternions_from_matrices(axes), scales, np.full(len(points), 4.0), sh)


def balls_on_a_floor() -> tuple[Gaussians, np.ndarray]:
    """Two balls of one colour close together on a floor of nearly that colour; the exact ids (N,)."""
    x, z = np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(-0.8, 0.8, 60))
    floor = np.stack([x.ravel(), 0.0 * x.ravel(), z.ravel()], axis=1)
    parts = [surfels(floor, np.tile([0.0, 1.0, 0.0], (len(floor), 1)), 0.014, (0.5, 0.42, 0.3))]
    way = directions_around(1500)
    for middle in (-0.17, 0.17):
        parts.append(surfels([middle, 0.15, 0.0] + 0.15 * way, way, 0.008, (0.6, 0.45, 0.25)))
    return concatenate(parts), np.repeat([0, 1, 2], [len(floor), 1500, 1500])


def plane(across: int, half: float, size: float, colour) -> Gaussians:
    """A level square of `across`^2 Gaussians."""
    x, z = np.meshgrid(*[np.linspace(-half, half, across)] * 2)
    points = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)
    return surfels(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), size, colour)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def two_strokes() -> SplatMarks:
    """One stroke within the left ball and one on the floor around it, as a user draws them."""
    at = np.array([[-0.17, 0.27, 0.09], [-0.2, 0.18, 0.15], [-0.14, 0.1, 0.14]])
    ring = np.linspace(-0.2, np.pi + 0.2, 9)
    around = np.stack([-0.17 + 0.24 * np.cos(ring), 0 * ring, 0.24 * np.sin(ring)], axis=1)
    inside, outside = (np.stack(CAMERA.projected(points)[:2], axis=1) for points in (at, around))
    return SplatMarks({"view_1": CAMERA}, Marks({"ball": {"view_1": ViewMarks([inside], [outside])}}))


@pytest.fixture(scope="module")
def scene():
    start_taichi("cpu")
    return balls_on_a_floor()


@pytest.fixture(scope="module")
def views(scene):
    """One for all tests: to start takes seconds."""
    around = ViewsAround()
    yield around
    around.destroy()


@pytest.fixture(scope="module")
def done(scene):
    lines = []
    return segment_splat(scene[0], two_strokes(), lines.append), lines


def test_two_strokes_select_one_of_two_balls_that_look_alike(scene, done):
    """From the floor it stands on, and from the other one beside it."""
    segmented, lines = done
    assert iou(segmented.gaussians.object_id[: len(scene[0])] == 1, scene[1] == 1) > 0.97
    assert any("ball" in line for line in lines)


def test_files_of_the_objects_the_background_and_all(done, tmp_path):
    segmented, _ = done
    files = write_segmented(tmp_path / "out", segmented)
    read = {name: read_gaussians(path) for name, path in files.items()}
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["background.ply", "ball.ply", "scene.ply"]
    assert len(read["ball"]) + len(read["background"]) == len(read["scene"])
    assert read["scene"].objects == ("ball",)
    assert (read["scene"].object_id == 1).sum() == len(read["ball"])


def test_what_another_object_has_is_not_taken(scene, views):
    g, true = scene
    selection = SplatSelection(g, views)
    top = g.means[:, 1] > 0.28
    one = selection.select(top & (true == 1), top & (true == 2))
    assert iou(one, true == 1) > 0.95
    assert not selection.select(top & (true == 2), np.zeros(len(g), bool), one)[one].any()


def test_wide_gaussians_under_a_thing_stay_with_the_floor(scene, views):
    """All that are nearest to the one below the ball are of the ball, and colours differ by too little to help."""
    ball = scene[0].select(scene[1] == 1)
    ball = ball.transformed(np.eye(3), np.array([0.17, 0.0, 0.0]))
    g = concatenate([plane(11, 0.8, 0.15, (0.57, 0.45, 0.26)), ball])
    own, r = np.arange(len(g)) >= 121, np.hypot(g.means[:, 0], g.means[:, 2])
    found = SplatSelection(g, views).select(own & (g.means[:, 1] > 0.28), ~own & (r > 0.4) & (r < 0.6))
    np.testing.assert_array_equal(found, own)
    assert own[straddlers(g, own)[0]].all(), "the one below it lies beside the border, not over it"


def slab_on_a_floor() -> tuple[Gaussians, np.ndarray]:
    """A flat box that lies with its whole bottom on a floor of its colour; which Gaussians (N,) bool are its own."""
    level = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # the normal turns from y to a side
    parts = [plane(81, 1.6, 0.04, (0.5, 0.5, 0.5))]
    for height in (0.012, 0.14):
        parts.append(plane(13, 0.24, 0.02, (0.5, 0.5, 0.5)).transformed(np.eye(3), (0.0, height, 0.0)))
    side = plane(13, 0.24, 0.02, (0.5, 0.5, 0.5))
    side = side.select(np.abs(side.means[:, 2]) < 0.05).transformed(level, (0.0, 0.076, 0.25))
    for turn in np.arange(4) * np.pi / 2:
        c, r = np.cos(turn), np.sin(turn)
        parts.append(side.transformed(np.array([[c, 0, r], [0, 1, 0], [-r, 0, c]])))
    g = concatenate(parts)
    return g, np.arange(len(g)) >= 81**2


def test_a_thing_on_its_whole_bottom_is_cut_off_along_the_rim(views):
    """Between bottom and floor are more edges than around the rim, but no view shows them. The bottom comes along."""
    g, own = slab_on_a_floor()
    r = np.abs(g.means[:, [0, 2]]).max(1)
    inside = own & (g.means[:, 1] > 0.13) & (r < 0.1)
    found = SplatSelection(g, views).select(inside, ~own & (g.means[:, 0] > 0.3) & (r < 0.36))
    assert iou(found, own) > 0.98


def test_a_share_is_seen_of_what_others_hide(views):
    """A plane above another one: each is seen from its own side alone, and one Gaussian beside them from everywhere."""
    low = plane(15, 0.3, 0.03, (0.5, 0.5, 0.5))
    alone = surfels(np.array([[0.0, 0.5, 0.0]]), np.array([[0.0, 1.0, 0.0]]), 0.03, (0.5, 0.5, 0.5))
    g = concatenate([low, low.transformed(np.eye(3), (0.0, 0.05, 0.0)), alone])
    shares = views.shares(g)
    up = np.argsort(shares[:, 15 * 7 + 7])  # the middle of the lower plane: seen from below
    assert shares[up[:8], 15 * 7 + 7].max() < 0.02 < 0.25 < shares[up[-4:], 15 * 7 + 7].min()
    assert shares[up[:4], 225 + 15 * 7 + 7].min() > 0.2
    assert np.median(shares[:, -1]) > 0.8


def test_likeness_falls_with_the_gap_the_colour_and_the_ratio_of_widths():
    """Rows of Gaussians 10 cm apart and wide: the next row, one twice as wide, one at twice the distance, red ones."""
    x = np.arange(-1.0, 1.01, 0.1)
    up = np.tile([0.0, 1.0, 0.0], (len(x), 1))

    def row(z, size=0.1, colour=(0.5, 0.5, 0.5)):
        return surfels(np.stack([x, 0 * x, np.full(len(x), z)], axis=1), up, size, colour)

    def likeness(other):
        low, high, weight = neighbour_edges(concatenate([row(0.0), other]))
        here = (low == 10) & (high == 10 + len(x))
        return float(weight[here][0])

    near = likeness(row(0.1))
    assert 0.8 < near < 0.95
    assert 0.5 < likeness(row(0.2)) / near < 0.8
    assert 0.2 < likeness(row(0.1, size=0.2)) / near < 0.35


def test_an_object_may_be_larger_than_the_strokes_on_it():
    """Of strokes with a radius of 1 cm: four times as large, and twice with strokes outside that say where it ends."""
    turn = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    points = 0.01 * np.concatenate([0.3 * ring, ring[::2], [[50.0, 0.0, 0.0]], ring])
    inside = np.arange(len(points)) <= 90  # the last of them shines through from far behind
    nothing, outside = np.zeros(len(points), bool), ~inside
    assert 0.04 < distances(points, inside, nothing)[1] < 0.07
    assert 0.02 < distances(points, inside, outside)[1] < 0.04


def test_what_lies_beyond_an_objects_reach_is_outside_and_far_from_it_left_out(scene, views, monkeypatch):
    g, true = scene
    near, seen = (true == 1) & (g.means[:, 1] > 0.2), []
    monkeypatch.setattr(SplatSelection, "_cut", lambda self, near, own, others: seen.append((near, others)) or own)
    foot = (true == 0) & (np.hypot(g.means[:, 0] + 0.17, g.means[:, 2]) < 0.1)
    SplatSelection(g, views).select(near, foot)
    distance, reach = distances(g.means, near, foot)
    around, outside = seen[0]
    beyond = np.linalg.norm(around.means - np.median(g.means[near], axis=0), axis=1) / reach
    assert 1.1 < beyond.max() < 1.6 < distance.max() / reach
    assert outside[beyond > 1.0].all()


def test_a_border_costs_the_likeness_across_it_where_a_view_shows_it():
    """Two fifths of Gaussians that overlap are all that a view can show. A thousand edges that none shows, or between
    Gaussians that are not alike at all, cost about as much as one."""
    shares = np.array([[0.45, 0.45, 0.1, 0.0, 0.0], [0.0, 0.0, 0.6, 0.0, 0.0]])
    low, high = np.arange(4), np.arange(1, 5)
    cost = border_costs(low, high, np.full(4, 0.6), shares / SEEN)
    np.testing.assert_allclose(cost[0], 0.6)
    assert 0.1 < cost[1] / cost[0] < 0.45
    assert 0.6 < 1000 * cost[3] / cost[0] < 1.7
    assert 0.6 < 1000 * border_costs(low, high, np.zeros(4), np.ones((1, 5)))[0] < 1.7


def test_a_thinned_splat_is_cut_as_all_of_it_along_the_border(scene, views, monkeypatch):
    """Of 6600 Gaussians 1000 say where the border is about, and those along it where it is."""
    g, true = scene
    seeds = [(g.means[:, 1] > 0.28) & (true == k) for k in (1, 2)]
    seeds[1] |= (true == 0) & (np.hypot(g.means[:, 0] + 0.17, g.means[:, 2]) > 0.22)
    whole = SplatSelection(g, views).select(*seeds)
    monkeypatch.setattr("prepare.segment.splat_selection.NODES", 1000)
    part = SplatSelection(g, views).select(*seeds)
    assert iou(part, whole) > 0.99 and iou(part, true == 1) > 0.99


def test_a_stroke_smaller_than_a_cell_among_strokes_outside_selects_no_other_place(scene, views, monkeypatch):
    g, true = scene
    distance = np.linalg.norm(g.means - g.means[(true == 1) & (g.means[:, 1] > 0.29)][0], axis=1)
    inside, outside = distance == 0.0, (distance > 0.0) & (distance < 0.05)
    monkeypatch.setattr("prepare.segment.splat_selection.NODES", 200)
    found = SplatSelection(g, views).select(inside, outside)
    assert found[inside].all() and distance[found].max() < 0.1


def test_growing_and_shrinking_are_by_rings_of_neighbours(scene, views, monkeypatch):
    """In a thinned splat as in all of it."""
    g, true = scene
    one = true == 1
    whole = {rings: SplatSelection(g, views).grown(one, rings) for rings in (1, -1, -2)}
    assert whole[1][one].all() and not whole[-1][~one].any()
    assert whole[-2].sum() < whole[-1].sum() < one.sum() < whole[1].sum()
    monkeypatch.setattr("prepare.segment.splat_selection.NODES", 1000)
    selection = SplatSelection(g, views)
    for rings, expected in whole.items():
        np.testing.assert_array_equal(selection.grown(one, rings), expected)


def test_a_gaussian_under_strokes_of_both_sides_seeds_the_side_that_clearly_has_more_of_it():
    class Weights:
        """Sums over the strokes inside and outside, [px]."""

        def sums(self, camera, maps):
            return np.array([[10.0, 0.0], [0.0, 10.0], [3.0, 2.0], [4.0, 1.0], [2.0, 3.0]])

    mark = ViewMarks(inside=[np.zeros((1, 2))], outside=[np.ones((1, 2))])
    g = surfels(np.zeros((5, 3)), np.tile([0.0, 1.0, 0.0], (5, 1)), 0.01, (0.5, 0.5, 0.5))
    seeds = Seeds(len(g), [view_seeds(g, Weights(), CAMERA, mark)])
    assert seeds.inside.tolist() == [True, False, False, True, False]
    assert seeds.outside.tolist() == [False, True, False, False, False]


def test_a_stroke_is_a_thin_pen_and_of_a_box_the_middle_third_counts_as_one():
    class Weights:
        """Keeps the maps of pixels that it is asked for."""

        def sums(self, camera, maps):
            self.maps = [np.array(each, float) for each in maps]
            return np.ones((1, 2))

    weights, camera = Weights(), perspective(900, 1000, 0.9, np.eye(4))
    stroke_weights(weights, camera, ViewMarks(inside=[np.array([[100.0, 500.0], [600.0, 500.0]])]))
    assert 2500 < weights.maps[0].sum() < 5500 and not weights.maps[1].any()  # of 500 px, 8 px wide
    stroke_weights(weights, camera, ViewMarks(boxes=[np.array([100.0, 200.0, 700.0, 800.0])]))
    y, x = np.nonzero(weights.maps[0])
    assert 180 < np.ptp(x) < 220 and 180 < np.ptp(y) < 220 and abs(x.mean() - 400) < 2 and abs(y.mean() - 500) < 2


def chain(weights) -> csr_matrix:
    k = np.arange(len(weights))
    return graph_of(k, k + 1, np.array(weights), len(weights) + 1)


def walked(graph, inside, outside) -> np.ndarray:
    return random_walk(graph, np.where(inside, 1, np.where(outside, 0, -1)), 2)[:, 1]


def test_random_walk_on_a_chain_is_its_potential():
    """Resistances in a row: the potential falls in proportion to them."""
    p = random_walk(chain([1.0, 0.5, 0.25]), np.array([1, -1, -1, 0]), 2)[:, 1]
    np.testing.assert_allclose(p, [1, 6 / 7, 4 / 7, 0], atol=1e-4)


def test_the_clearest_border_is_the_weakest_for_what_it_encloses():
    """The first of two weak links encloses too little, the second is the cheaper one for its side."""
    graph = chain([0.09, 1.0, 1.0, 1.0, 0.1, 1.0, 1.0, 1.0])
    ends = np.arange(9) == 0, np.arange(9) == 8
    found = clearest_level(graph, walked(graph, *ends), *ends)
    np.testing.assert_array_equal(found, np.arange(9) < 5)


def test_what_no_walker_reaches_is_not_selected():
    """A part without a seed: nothing joins it to the rest, so that all of it would be had for nothing."""
    graph = csr_matrix(np.kron(np.eye(2), chain([1.0, 0.2, 1.0]).toarray()))
    ends = np.arange(8) == 0, np.arange(8) == 3
    np.testing.assert_array_equal(clearest_level(graph, walked(graph, *ends), *ends), np.arange(8) < 2)


def test_what_is_not_fixed_joins_the_side_that_it_is_most_alike_with():
    """A hidden row 1 to 3 is firmly joined to 0 at its end, and weakly to the outside 4 all along."""
    low, high = np.array([0, 1, 2, 1, 2, 3]), np.array([1, 2, 3, 4, 4, 4])
    likeness = np.array([0.5, 0.6, 0.7, 0.4, 0.4, 0.4])
    cut, fixed = np.array([1, 0, 0, 0, 0, 0], bool), np.array([1, 0, 0, 0, 1, 0], bool)
    np.testing.assert_array_equal(most_alike(low, high, likeness, cut, fixed), [1, 1, 1, 1, 0, 0])
    likeness[1] = 0.3
    np.testing.assert_array_equal(most_alike(low, high, likeness, cut, fixed), [1, 1, 0, 0, 0, 0])


def test_halves_have_the_moments_of_the_cut_distribution():
    rng = np.random.default_rng(2)
    g = Gaussians.of([[1.0, 2, 3]], [[0.8, 0.4, 0.2, 0.4]], np.log([[0.3, 0.2, 0.05]]), [0.0], np.zeros((1, 1, 3)))
    normal = np.array([[0.6, 0.0, 0.8]])
    sigma = symmetric_matrices(g.covariances)[0]
    x = rng.multivariate_normal(g.means[0], sigma, 400_000)
    height = (x - g.means[0]) @ normal[0] / np.sqrt(normal[0] @ sigma @ normal[0])
    for part, here in zip(halves(g, normal, np.array([0.7])), (height > -0.7, height <= -0.7), strict=True):
        np.testing.assert_allclose(part.means[0], x[here].mean(0), atol=3e-3)
        np.testing.assert_allclose(symmetric_matrices(part.covariances)[0], np.cov(x[here].T), atol=1e-3)


def plane_in_halves(size: float) -> tuple[Gaussians, np.ndarray]:
    """A level square of Gaussians of this width in rows 5 cm apart, and which of them lie to the left of x = 0."""
    g = plane(41, 1.0, size, (0.5, 0.5, 0.5)).transformed(np.eye(3), (0.025, 0.0, 0.0))
    return g, g.means[:, 0] < 0


def test_a_wide_gaussian_over_the_border_is_cut_in_two():
    """One Gaussian of the left half that reaches far into the right one."""
    g, left = plane_in_halves(0.02)
    scales = g.log_scales.copy()
    wide = int(np.argmin(np.linalg.norm(g.means - [-0.025, 0.0, 0.0], axis=1)))
    scales[wide, :2] = np.log(0.2)
    g = Gaussians.of(g.means, g.quats, scales, g.logit_opacities, g.sh)
    whole, left, _ = trimmed(g, left)
    assert left[wide] and not left[-1]
    reach = whole.means[:, 0] + 2 * np.sqrt(whole.covariances[:, 0])
    assert reach[left].max() < 0.25 < g.means[wide, 0] + 2 * 0.2
    assert whole.means[wide, 0] < -0.1
    assert (whole.means[len(g) :, 0] > 0).all() and (~left[len(g) :]).any()


def test_gaussians_that_only_touch_the_border_are_not_cut():
    """Of rows 8 cm wide each, only the two beside the border straddle it; the next ones reach it, too."""
    g, left = plane_in_halves(0.08)
    which, normal, _ = straddlers(g, left)
    assert len(which) == 82 and np.abs(g.means[which, 0]).max() < 0.03
    assert (np.sign(normal[:, 0]) == np.sign(g.means[which, 0])).all()


def test_marks_and_cameras_are_read_as_they_were_written(tmp_path):
    marks = two_strokes()
    marks.grow = {"ball": -2}
    write_splat_marks(tmp_path / "m.json", marks)
    read = read_splat_marks(tmp_path / "m.json")
    np.testing.assert_allclose(read.cameras["view_1"].world_to_camera, CAMERA.world_to_camera)
    inside = [m.marks.objects["ball"]["view_1"].inside[0] for m in (read, marks)]
    np.testing.assert_allclose(*inside, atol=0.06)
    assert read.grow == {"ball": -2}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"views": None}, 'no "views"'),
        ({"views": {"view_1": {"width": 3}}}, "view_1: height is missing"),
        ({"grow": {"cat": 1}}, "'cat', which is not marked"),
        ({"grow": {"ball": 1.5}}, "grow"),
        ({"objects": {"ball": {"view_9": {"inside": [[[1, 1]]]}}}}, "view_9"),
    ],
)
def test_bad_marks_are_refused_in_a_line(change, what, tmp_path):
    path = tmp_path / "m.json"
    write_splat_marks(path, two_strokes())
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(BadInput, match=what) as error:
        read_splat_marks(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_distances_between_gaussians_are_those_of_their_covariances():
    rng = np.random.default_rng(0)
    root, d, added = rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3)), rng.uniform(0.01, 1.0, 50)
    S = root @ root.swapaxes(1, 2)
    whole = S + added[:, None, None] * np.eye(3)
    expected = np.einsum("ei,eij,ej->e", d, np.linalg.inv(whole), d)
    found = mahalanobis(d, S[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], added)
    assert np.allclose(found, expected, rtol=1e-9)
