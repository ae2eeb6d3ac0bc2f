"""Objects cut out of a splat by strokes on its pictures."""

import json

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians
from core.camera import look_at, perspective
from core.errors import BadInput
from core.spherical_harmonics import C0
from prepare.segment.gaussian_graph import Clusters, border_graph, neighbour_graph
from prepare.segment.graph_cut import banded_cut, min_cut, random_walk
from prepare.segment.marks import Marks, ViewMarks
from prepare.segment.splat_marks import SplatMarks, read_splat_marks, write_splat_marks
from prepare.segment.splat_seeds import Seeds
from prepare.segment.splat_segmentation import segment_splat, write_segmented
from prepare.segment.splat_selection import SplatSelection
from prepare.segment.trimming import full_matrices, halves, straddlers, trimmed

CAMERA = perspective(160, 120, 0.9, look_at((0.0, 0.9, 1.2), (0.0, 0.1, 0.0)))


def surfels(points, normals, size, colour) -> Gaussians:
    """Flat Gaussians on a surface, (N, 3) each."""
    from core.rotation import quaternions_from_matrices

    n = np.asarray(normals, float)
    side = np.cross(n, np.where(np.abs(n[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(n, side), n], axis=2)
    scales = np.tile(np.log([size, size, 0.1 * size]), (len(points), 1))
    sh = np.tile((np.asarray(colour) - 0.5) / C0, (len(points), 1))[:, None]
    return Gaussians.of(points, quaternions_from_matrices(axes), scales, np.full(len(points), 4.0), sh)


def balls_on_a_floor() -> tuple[Gaussians, np.ndarray]:
    """Two balls of one colour close together on a floor of nearly that colour; the exact ids (N,)."""
    from assets.gaussians import concatenate

    x, z = np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(-0.8, 0.8, 60))
    floor = np.stack([x.ravel(), 0.0 * x.ravel(), z.ravel()], axis=1)
    parts = [surfels(floor, np.tile([0.0, 1.0, 0.0], (len(floor), 1)), 0.014, (0.5, 0.42, 0.3))]
    k = np.arange(1500) + 0.5
    polar, turn = np.arccos(1 - 2 * k / 1500), np.pi * (1 + 5**0.5) * k
    way = np.stack([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)], axis=1)
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
    inside, outside = (projected(points) for points in (at, around))
    return SplatMarks({"view_1": CAMERA}, Marks({"ball": {"view_1": ViewMarks([inside], [outside])}}))


def projected(points) -> np.ndarray:
    p = points @ CAMERA.world_to_camera[:3, :3].T + CAMERA.world_to_camera[:3, 3]
    return np.stack([CAMERA.fx * p[:, 0] / p[:, 2] + CAMERA.cx, CAMERA.fy * p[:, 1] / p[:, 2] + CAMERA.cy], axis=1)


@pytest.fixture(scope="module")
def scene():
    return balls_on_a_floor()


@pytest.fixture(scope="module")
def done(scene):
    from core.runtime import start_taichi

    start_taichi("cpu")
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


def test_what_another_object_has_is_not_taken(scene):
    g, true = scene
    selection = SplatSelection(g)
    top = g.means[:, 1] > 0.28
    one = selection.select(top & (true == 1), top & (true == 2))
    assert iou(one, true == 1) > 0.95
    assert not selection.select(top & (true == 2), np.zeros(len(g), bool), one)[one].any()


def test_wide_gaussians_under_a_thing_stay_with_the_floor(scene):
    """All that are nearest to the one below the ball are of the ball, and colours differ by too little to help."""
    from assets.gaussians import concatenate

    ball = scene[0].select(scene[1] == 1)
    ball = ball.transformed(np.eye(3), np.array([0.17, 0.0, 0.0]))
    g = concatenate([plane(11, 0.8, 0.15, (0.57, 0.45, 0.26)), ball])
    own, r = np.arange(len(g)) >= 121, np.hypot(g.means[:, 0], g.means[:, 2])
    found = SplatSelection(g).select(own & (g.means[:, 1] > 0.28), ~own & (r > 0.4) & (r < 0.6))
    np.testing.assert_array_equal(found, own)
    assert own[straddlers(g, own)[0]].all(), "the one below it lies beside the border, not over it"


def test_nearly_the_whole_splat_is_no_clear_selection():
    """Little leaves it, but nearly all that the few others have: what is left out has the same border."""
    gaussians, ids = balls_on_a_floor()
    selection = SplatSelection(gaussians)
    ids = ids[selection.order]
    leak = selection._conductance(ids == 1)
    assert leak == pytest.approx(selection._conductance(ids != 1)) and leak < 0.1
    corner = (selection._points < -0.6).any(1) & (ids == 0)
    assert selection._conductance(~corner) == pytest.approx(selection._conductance(corner))


def test_rounds_end_when_the_border_becomes_little_clearer(monkeypatch):
    """The share of edges that leave a disc falls with its radius: twice it is a find, a tenth more a creep."""
    g = plane(60, 1.0, 0.02, (0.5, 0.5, 0.5))
    selection, nothing = SplatSelection(g), np.zeros(len(g), bool)
    r = np.linalg.norm(g.means, axis=1)
    rounds = iter((0.2, 0.4, 0.44, 0.48, 0.5, 0.5, 0.5))
    monkeypatch.setattr(SplatSelection, "_cut", lambda self, *_: (r < next(rounds))[self.order])
    np.testing.assert_array_equal(selection.select(r < 0.05, nothing), r < 0.4)


def test_what_was_selected_once_is_kept(scene, monkeypatch):
    g, true = scene
    selection, top = SplatSelection(g), g.means[:, 1] > 0.28
    seeds = top & (true == 1), top & (true == 2)
    one = selection.select(*seeds)
    monkeypatch.delattr(SplatSelection, "_cut")
    np.testing.assert_array_equal(selection.select(*seeds), one)


def test_a_border_costs_by_its_length_however_dense_the_gaussians():
    costs = []
    for across, size in ((31, 0.05), (61, 0.025)):
        g = plane(across, 1.0, size, (0.5, 0.5, 0.5))
        graph = border_graph(neighbour_graph(g), np.full(len(g), size))
        left = g.means[:, 0] < 0.01
        costs.append((graph[left] @ (~left).astype(float)).sum())
    assert costs[0] == pytest.approx(costs[1], rel=0.1)


def test_rare_colours_say_little_and_frequent_ones_much():
    """Of 1000 Gaussians inside, 10 have a colour of their own; so have all of the others, and nobody a fourth one."""
    colours = np.array([[0.8, 0.1, 0.1], [0.1, 0.1, 0.8], [0.1, 0.8, 0.1], [0.8, 0.8, 0.1]])
    kind = np.repeat(range(4), [990, 10, 1000, 1])
    g = plane(45, 1.0, 0.02, (0.5, 0.5, 0.5)).select(np.arange(len(kind)))
    g = Gaussians.of(g.means, g.quats, g.log_scales, g.logit_opacities, ((colours[kind] - 0.5) / C0)[:, None])
    selection = SplatSelection(g)
    kind = kind[selection.order]
    ratio = selection._colour_ratio(kind < 2, kind == 2)
    own, rare, other, unknown = (ratio[kind == k].mean() for k in range(4))
    assert own > 2.0 and 0.0 < rare < 0.4 and unknown == pytest.approx(0.0, abs=0.05)
    assert -2.0 < other < -0.5, "unlike colours may be of the side that nobody marked"


def test_clusters_are_of_one_kind_and_no_more_than_asked_for(scene):
    g, true = scene
    graph = neighbour_graph(g)
    clusters = Clusters(graph, 300)
    index = np.flatnonzero(g.means[:, 0] < 0.3)
    for count in (300, 1000):
        found = clusters.of(index, count, true[index])
        assert count / 4 < found.max() + 1 < count + 300
        np.testing.assert_array_equal(np.unique(found), np.arange(found.max() + 1))
        assert len(np.unique(np.stack([found, true[index]]), axis=1).T) == found.max() + 1


def test_growing_and_shrinking_are_by_rings_of_neighbours(scene):
    g, true = scene
    selection, one = SplatSelection(g), true == 1
    more, less = selection.grown(one, 1), selection.grown(one, -1)
    assert more[one].all() and not less[~one].any()
    assert less.sum() < one.sum() < more.sum()


def test_small_holes_are_filled_and_large_ones_are_not(scene):
    g, true = scene
    selection, nothing = SplatSelection(g), np.zeros(len(g), bool)
    from_top = np.linalg.norm(g.means - [-0.17, 0.3, 0.0], axis=1)
    for radius, filled in ((0.03, True), (0.12, False)):
        cut = (true == 1) & (from_top > radius)
        hole = (true == 1) & ~cut
        assert hole.sum() > 10
        order = selection.order
        assert selection._without_holes(cut[order], nothing)[hole[order]].all() == filled


def test_a_gaussian_under_strokes_of_both_sides_seeds_the_side_that_clearly_has_more_of_it():
    class Weights:
        """Sums over the strokes inside and outside, [px]."""

        def sums(self, camera, maps):
            return np.array([[10.0, 0.0], [0.0, 10.0], [3.0, 2.0], [4.0, 1.0], [2.0, 3.0]])

    mark = ViewMarks(inside=[np.zeros((1, 2))], outside=[np.ones((1, 2))])
    g = surfels(np.zeros((5, 3)), np.tile([0.0, 1.0, 0.0], (5, 1)), 0.01, (0.5, 0.5, 0.5))
    seeds = Seeds(g, Weights(), {"view": CAMERA}, {"view": mark})
    assert seeds.inside.tolist() == [True, False, False, True, False]
    assert seeds.outside.tolist() == [False, True, False, False, False]


def test_least_cut_of_a_chain_is_its_weakest_link():
    weights = np.array([0.9, 0.5, 0.2, 0.6])
    graph = csr_matrix((weights, (range(4), range(1, 5))), (5, 5))
    graph = (graph + graph.T).tocsr()
    ends = np.array([np.inf, 0, 0, 0, 0]), np.array([0, 0, 0, 0, np.inf])
    np.testing.assert_array_equal(min_cut(graph, *ends), [True, True, True, False, False])
    np.testing.assert_array_equal(banded_cut(graph, *ends, np.array([0, 1, 1, 2, 3])), [1, 1, 1, 0, 0])


def test_random_walk_on_a_chain_is_its_potential():
    """Resistances in a row: the potential falls in proportion to them."""
    weights = np.array([1.0, 0.5, 0.25])
    graph = csr_matrix((weights, (range(3), range(1, 4))), (4, 4))
    graph = (graph + graph.T).tocsr()
    nothing = np.zeros(4)
    p = random_walk(graph, np.array([1, 0, 0, 0], bool), np.array([0, 0, 0, 1], bool), nothing, nothing)
    np.testing.assert_allclose(p, [1, 6 / 7, 4 / 7, 0], atol=1e-4)


def test_halves_have_the_moments_of_the_cut_distribution():
    rng = np.random.default_rng(2)
    g = Gaussians.of([[1.0, 2, 3]], [[0.8, 0.4, 0.2, 0.4]], np.log([[0.3, 0.2, 0.05]]), [0.0], np.zeros((1, 1, 3)))
    normal = np.array([[0.6, 0.0, 0.8]])
    sigma = full_matrices(g.covariances)[0]
    x = rng.multivariate_normal(g.means[0], sigma, 400_000)
    height = (x - g.means[0]) @ normal[0] / np.sqrt(normal[0] @ sigma @ normal[0])
    for part, here in zip(halves(g, normal, np.array([0.7])), (height > -0.7, height <= -0.7), strict=True):
        np.testing.assert_allclose(part.means[0], x[here].mean(0), atol=3e-3)
        np.testing.assert_allclose(full_matrices(part.covariances)[0], np.cov(x[here].T), atol=1e-3)


def test_a_wide_gaussian_over_the_border_is_cut_in_two():
    """A plane of two halves, and one Gaussian of the left half that reaches far into the right one."""
    x, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    points = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1) + [0.025, 0, 0]
    g = surfels(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), 0.02, (0.5, 0.5, 0.5))
    scales = g.log_scales.copy()
    wide = int(np.argmin(np.linalg.norm(points - [-0.025, 0.0, 0.0], axis=1)))
    scales[wide, :2] = np.log(0.2)
    g = Gaussians.of(g.means, g.quats, scales, g.logit_opacities, g.sh)
    whole, left, _ = trimmed(g, points[:, 0] < 0)
    assert left[wide] and not left[-1]
    reach = whole.means[:, 0] + 2 * np.sqrt(whole.covariances[:, 0])
    assert reach[left].max() < 0.25 < g.means[wide, 0] + 2 * 0.2
    assert whole.means[wide, 0] < -0.1
    assert (whole.means[len(g) :, 0] > 0).all() and (~left[len(g) :]).any()


def test_gaussians_that_only_touch_the_border_are_not_cut():
    """Of rows 5 cm apart, 8 cm wide each, only the two beside the border straddle it; the next ones reach it, too."""
    x, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    points = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1) + [0.025, 0, 0]
    g = surfels(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)), 0.08, (0.5, 0.5, 0.5))
    which, normal, _ = straddlers(g, points[:, 0] < 0)
    assert len(which) == 82 and np.abs(points[which, 0]).max() < 0.03
    assert (np.sign(normal[:, 0]) == np.sign(points[which, 0])).all()


def test_marks_and_cameras_are_read_as_they_were_written(tmp_path):
    marks = two_strokes()
    marks.grow = {"ball": -2}
    write_splat_marks(tmp_path / "m.json", marks)
    read = read_splat_marks(tmp_path / "m.json")
    np.testing.assert_allclose(read.cameras["view_1"].world_to_camera, CAMERA.world_to_camera)
    np.testing.assert_allclose(read.marks.objects["ball"]["view_1"].inside[0], projected_first(marks), atol=0.06)
    assert read.grow == {"ball": -2}


def projected_first(marks: SplatMarks) -> np.ndarray:
    return marks.marks.objects["ball"]["view_1"].inside[0]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"views": None}, 'no "views"'),
        ({"views": {"view_1": {"width": 3}}}, "view_1: missing 'height'"),
        ({"grow": {"cat": 1}}, "'cat', which is not marked"),
        ({"grow": {"ball": 1.5}}, "no whole number"),
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
