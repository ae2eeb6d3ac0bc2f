"""Pictures that are hard to draw right against the float64 twin, one eye and two; two eyes against one at a time."""

import numpy as np
import pytest

from core.camera import Camera, look_at
from core.rotation import matrices_from_quaternions
from tests.support import reference_render as reference
from tests.support.drawing import Drawing
from tests.support.hard_pictures import DEGREE, SIDE, cloud, hard_pictures, round_ones, two_eyes

TOLERANCE = 1e-4  # of rgb (or of the brightest, where that is above 1), alpha and relative depth; float32 gives 1e-5
AT_A_THRESHOLD = 0.01  # of the same, where rounding decides whether a Gaussian of alpha 1/255 is drawn
PICTURES = hard_pictures()
CAPACITY = 4100


@pytest.fixture(scope="module")
def drawings(ti_cpu):
    """A drawing by number of views and options, made when it is first asked for."""
    made = {}

    def get(views: int, **options) -> Drawing:
        key = (views, *sorted(options.items()))
        if key not in made:
            made[key] = Drawing(CAPACITY, views, SIDE, degree=DEGREE, **options)
        return made[key]

    return get


def assert_equals_twin(images, twin) -> None:
    """rgb, alpha and depth of all views, but for pixels at a threshold, of which there must be few."""
    rgb, alpha, depth = images
    expected_rgb, expected_alpha, expected_depth, doubts = twin
    assert all(np.isfinite(image).all() for image in images)
    bright = max(1.0, expected_rgb.max())
    seen = expected_alpha > 0.01  # a depth of less is a quotient of two small numbers
    errors = [
        np.abs(rgb - expected_rgb).max(axis=-1) / bright,
        np.abs(alpha - expected_alpha),
        np.where(seen, np.abs(depth / np.where(seen, expected_depth, 1.0) - 1.0), 0.0),
    ]
    for error in errors:
        assert error[~doubts].max(initial=0.0) < TOLERANCE and error.max() < AT_A_THRESHOLD
    assert doubts.mean() < 0.06


@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("name", PICTURES)
def test_hard_pictures_equal_their_twins(drawings, name, views):
    g, eyes = PICTURES[name]
    assert_equals_twin(drawings(views).draw(g, eyes[:views]), reference.render_stereo(g, eyes[:views]))


@pytest.mark.parametrize(
    "name",
    ["lenses far off centre", "behind and across the near plane", "from a millionth of a pixel to the whole sky"],
)
def test_antialiased_pictures_of_two_eyes_equal_their_twins(drawings, name):
    g, eyes = PICTURES[name]
    twin = reference.render_stereo(g, eyes, antialias=True)
    assert_equals_twin(drawings(2, antialias=True).draw(g, eyes), twin)


@pytest.mark.parametrize("name", ["a cloud", "behind and across the near plane", "one eye before, one behind"])
def test_pictures_by_distance_equal_their_twins(drawings, name):
    g, eyes = PICTURES[name]
    assert_equals_twin(drawings(2, sort="radial").draw(g, eyes), reference.render_stereo(g, eyes, radial=True))


def test_the_pictures_are_as_hard_as_they_say():
    """Or else the tests above would prove nothing."""

    def projected(name, eye):
        g, eyes = PICTURES[name]
        return reference.project(g.means, reference.covariances(g), g.opacities, eyes[eye])

    for eye in (0, 1):
        _, sigma, _, z, kept = projected("behind and across the near plane", eye)
        radii = 3 * np.exp(PICTURES["behind and across the near plane"][0].log_scales).max(axis=1)
        assert (z < 0).sum() > 50 and ((z < 0.01) & (z + radii > 0.01)).sum() > 50 and kept.sum() > 50
        sigma = projected("from a millionth of a pixel to the whole sky", eye)[1][:, 0, 0] - 0.3
        assert sigma.min() < 1e-12 and sigma.max() > 1e10
    first, second = (projected("one eye before, one behind", eye)[4] for eye in (0, 1))
    assert (first & ~second).sum() > 20 and second.sum() > 20
    uv = projected("thousands in one pixel", 0)[0]
    assert (np.abs(uv - uv[0]).max(axis=1) < 1).sum() > 3000
    for eye in PICTURES["lenses whose middle lies outside of the picture"][1]:
        assert not 0 < eye.cx < eye.width


PARALLEL = [name for name, (_, eyes) in PICTURES.items() if "lens" not in name and "one behind" not in name]


@pytest.mark.parametrize("name", PARALLEL)
def test_two_parallel_eyes_equal_one_at_a_time_to_the_bit(drawings, name):
    """They have the same depths, so the same order; and with degree 0 the same colours."""
    g, eyes = PICTURES[name]
    g = g.with_sh_degree(0).with_sh_degree(DEGREE)
    both = drawings(2).draw(g, eyes)
    for v, eye in enumerate(eyes):
        for together, alone in zip(both, drawings(1).draw(g, [eye]), strict=True):
            np.testing.assert_array_equal(together[v], alone[0])


@pytest.mark.parametrize("seed", range(4))
def test_broken_numbers_in_any_field_leave_both_eyes_finite(drawings, seed):
    """NaN, infinities, denormals and huge numbers, as a simulation that blew up leaves them."""
    rng = np.random.default_rng(seed)
    g = cloud(rng, 300, center=(0.0, 0.0, 1.5))
    fields = [np.array(f, np.float32) for f in (g.means, g.covariances, g.opacities, g.sh)]
    bad = [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e19, 1e-42, -1e-42]
    for k in rng.choice(len(g), 100, replace=False):
        row = fields[rng.integers(4)][k : k + 1].reshape(-1)
        row[rng.integers(row.size)] = rng.choice(bad)
    rgb, alpha, depth = drawings(2).draw_fields(*fields, two_eyes(43, 29))
    assert np.isfinite(rgb).all() and np.isfinite(depth).all()
    assert alpha.min() >= 0.0 and 0.3 < alpha.max() <= 1.0


@pytest.mark.parametrize(("field", "value"), [("means", np.nan), ("means", -np.inf), ("log_scales", np.nan)])
def test_a_gaussian_without_numbers_is_left_out_of_both_eyes(drawings, field, value):
    """Wherever in order it would stand."""
    g, eyes = PICTURES["a cloud"]
    broken = np.arange(0, len(g), 7)
    kept = g.select(np.setdiff1d(np.arange(len(g)), broken))
    g = g.select(np.arange(len(g)))
    getattr(g, field)[broken, 0] = value
    for found, expected in zip(drawings(2).draw(g, eyes), drawings(2).draw(kept, eyes), strict=True):
        np.testing.assert_array_equal(found, expected)


EYE = Camera(43, 29, 40.0, 40.0, 21.5, 14.5, np.eye(4))  # at the origin, along +z; sides that no tile divides


@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.3, 30.0, 1e4])
@pytest.mark.parametrize("mean", [(0.0, 0.0, 1.0), (0.4, -0.2, 0.5), (3.0, 0.0, 0.02), (0.0, 0.0, -0.5)])
def test_subpixel_and_huge_gaussians_at_any_place(drawings, mean, size):
    g = round_ones(mean, size=size)
    for found, expected in zip(drawings(1).draw(g, [EYE])[:2], reference.render(g, EYE)[:2], strict=True):
        np.testing.assert_allclose(found[0], expected, atol=2e-4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e9])
def test_a_gaussian_of_no_colour_is_left_out(drawings, value):
    g = round_ones(np.tile((0.0, 0.0, 1.0), (4, 1)))
    broken = g.sh.copy()
    broken[1:3, 0, 1] = value
    pictures = drawings(1).draw_fields(g.means, g.covariances, g.opacities, broken, [EYE])
    for found, expected in zip(pictures, drawings(1).draw(g.select(np.array([0, 3])), [EYE]), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_visibility_and_the_frame_of_the_harmonics_belong_to_each_gaussian(drawings):
    """Colour = visibility * max(0, 0.5 + SH(R^T d)); a body that turns keeps its highlights."""
    rng, drawing = np.random.default_rng(5), drawings(1)
    g, splats = cloud(rng, 100), drawing.splats
    quats = rng.normal(size=(100, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    visibility = rng.uniform(0.2, 1, 100)
    camera = Camera(40, 40, 47.0, 47.0, 20.0, 20.0, look_at((0, 0, -1.2), (0, 0, 0)))
    splats.count = 100
    splats.rotation.from_numpy(splats.padded(quats))
    splats.visibility.from_numpy(splats.padded(visibility))
    rgb = drawing.draw(g, [camera])[0]
    splats.rotation.from_numpy(np.tile(np.float32([1, 0, 0, 0]), (splats.capacity, 1)))
    splats.visibility.fill(1.0)
    colors = reference.colors(g, camera, matrices_from_quaternions(quats)) * visibility[:, None]
    expected = reference.render(g, camera, rgb=colors)[0]
    assert (np.abs(rgb[0] - expected).max(axis=-1) < 1e-3).mean() > 0.999
