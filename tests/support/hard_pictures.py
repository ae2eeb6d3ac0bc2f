"""Gaussians that are hard to draw right, each set with the two eyes that look at it."""

from dataclasses import replace

import numpy as np

from assets.gaussians import Gaussians, concatenate
from core.camera import Camera, look_at

DEGREE = 3  # of all sets: one renderer draws them all
SIDE = 64  # [px]; no picture is larger
EYES_APART = 0.064  # [m]


def cloud(rng, count: int, *, degree: int = DEGREE, spread=0.3, size=0.03, center=(0.0, 0.0, 0.0)) -> Gaussians:
    """A ball of Gaussians of many shapes, opacities and colours."""
    means = np.asarray(center) + rng.normal(0, spread, (count, 3))
    scales = np.log(size) + rng.normal(0, 0.7, (count, 3))
    sh = rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3))
    sh[:, 0] += 1.0
    return Gaussians.of(means, rng.normal(size=(count, 4)), scales, rng.normal(0, 2, count), sh).with_sh_degree(DEGREE)


def round_ones(means, *, size=0.05, opacity=0.9, rng=None) -> Gaussians:
    """Round Gaussians at `means`; `size` [m] and `opacity` for all or each; an opacity of 0 or 1 is just that."""
    means = np.atleast_2d(np.asarray(means, float))
    n, rng = len(means), rng or np.random.default_rng(0)
    opacity = np.broadcast_to(opacity, n).astype(float)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacity) - np.log1p(-opacity), -80, 80)
    scales = np.log(np.broadcast_to(size, n).astype(float))[:, None].repeat(3, 1)
    sh = rng.uniform(-1.5, 1.5, (n, 1, 3))
    return Gaussians.of(means, np.tile([1.0, 0, 0, 0], (n, 1)), scales, logits, sh).with_sh_degree(DEGREE)


def two_eyes(width: int, height: int, matrix=None, *, f: float = 40.0, apart: float = EYES_APART) -> list[Camera]:
    """A pair of parallel eyes around a camera, its lens in the middle."""
    matrix = np.eye(4) if matrix is None else matrix
    eyes = []
    for side in (-0.5, 0.5):
        pose = matrix.copy()
        pose[0, 3] -= side * apart
        eyes.append(Camera(width, height, f, f, 0.5 * width, 0.5 * height, pose))
    return eyes


def hard_pictures() -> dict[str, tuple[Gaussians, list[Camera]]]:
    """Gaussians and two cameras of one size, by name."""
    rng = np.random.default_rng(11)
    before = look_at((0.1, 0.2, -0.8), (0.0, 0.0, 0.3))
    ahead = {"center": (0.0, 0.0, 1.0)}
    found = {
        "nothing": (cloud(rng, 0), two_eyes(43, 29)),
        "one": (round_ones((0.02, 0.01, 1.0)), two_eyes(43, 29)),
        "a cloud": (cloud(rng, 200), two_eyes(53, 37, before)),
        "lenses far off centre": off_centre(cloud(rng, 200), 60, 50),
        "lenses whose middle lies outside of the picture": off_centre(cloud(rng, 250, spread=0.6), 61, 33, out=1.3),
        "behind and across the near plane": near_plane(rng),
        "one eye before, one behind": one_ahead(rng),
        "from a millionth of a pixel to the whole sky": (many_sizes(rng), two_eyes(43, 29)),
        "needles and sheets": (needles(rng), two_eyes(64, 64)),
        "far away": (round_ones(1e6 * directions(rng, 60), size=3e4, opacity=0.3), two_eyes(50, 41)),
        "thousands in one pixel": (thousands(), two_eyes(21, 19)),
        "opacities of 0, 1 and about one step": (opacities(rng), two_eyes(43, 29)),
        "all at one depth": (one_depth(rng), two_eyes(43, 29)),
    }
    for width, height in ((17, 33), (1, 1), (15, 1), (1, 40), (16, 16), (64, 63)):
        found[f"a picture of {width}x{height}"] = (
            cloud(rng, 120, **ahead),
            two_eyes(width, height, f=0.8 * height + 4),
        )
    return found


def directions(rng, count: int) -> np.ndarray:
    """Unit vectors about +z."""
    way = rng.normal(0, 0.3, (count, 3)) + (0, 0, 1)
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def off_centre(g: Gaussians, width: int, height: int, *, out: float = 0.35):
    """Eyes that are turned outwards, each with its own lens, whose middle is `out` widths off the picture's."""
    eyes = []
    for side in (-1, 1):
        matrix = look_at((0.032 * side, 0.1, -1.0), (0.032 * side - 0.9 * out * side, 0.05, 0.2))
        middle = (0.5 + out * side) * width
        eyes.append(Camera(width, height, 45.0 + 4 * side, 41.0 - 3 * side, middle, (0.5 - 0.6 * out) * height, matrix))
    return g, eyes


def near_plane(rng):
    """Eyes in the midst of Gaussians: some behind, some within 1 cm of the plane z = 0.01 m, some around both."""
    at = np.c_[rng.normal(0, 0.02, (60, 2)), rng.uniform(0.0, 0.02, 60)]
    close = round_ones(at, size=0.002, opacity=0.4, rng=rng)
    around = round_ones(rng.normal(0, 0.3, (40, 3)), size=0.3, opacity=0.1, rng=rng)
    return concatenate([close, around, cloud(rng, 150)]), two_eyes(43, 29)


def one_ahead(rng):
    """The second eye stands half a metre before the first: it does not see what lies between them."""
    first, second = two_eyes(37, 41)
    pose = second.world_to_camera.copy()
    pose[2, 3] = -0.5
    return cloud(rng, 200, center=(0.0, 0.0, 0.6)), [first, replace(second, world_to_camera=pose)]


def many_sizes(rng) -> Gaussians:
    """Standard deviations of 1e-8 to 1e4 m, a metre away."""
    means = np.c_[rng.uniform(-0.6, 0.6, (120, 2)), rng.uniform(0.5, 1.5, 120)]
    return round_ones(means, size=10.0 ** rng.uniform(-8, 4, 120), opacity=rng.uniform(0.01, 0.08, 120), rng=rng)


def needles(rng) -> Gaussians:
    """One or two axes a thousand times as long as the others."""
    g = cloud(rng, 150, center=(0.0, 0.0, 1.2), size=0.0002)
    longer = np.log(1000.0) * (rng.random((150, 3)) < 0.4)
    return replace(g, log_scales=(g.log_scales + longer).astype(np.float32))


def thousands() -> Gaussians:
    """4,000 faint ones in a pixel, in no order, and a bright wall that must not shine through them."""
    rng = np.random.default_rng(2)
    faint = round_ones(np.c_[np.zeros((4000, 2)), rng.uniform(1, 2, 4000)], size=0.004, opacity=0.05, rng=rng)
    wall = round_ones((0.0, 0.0, 3.0), size=0.5)
    wall.sh[:, 0] = 30.0
    return concatenate([wall, faint])


def opacities(rng) -> Gaussians:
    """Exactly 0 and 1, and within a hundredth of 1/255, where drawing begins."""
    some = np.r_[np.zeros(20), np.ones(20), np.full(20, 0.99 / 255), np.full(20, 1.01 / 255), np.full(20, 0.999)]
    means = np.c_[rng.uniform(-0.5, 0.5, (100, 2)), rng.uniform(0.8, 1.5, 100)]
    return round_ones(means, size=0.03, opacity=rng.permutation(some), rng=rng)


def one_depth(rng) -> Gaussians:
    """A wall square to the view, in layers that lie in one another: only their numbers say which comes first."""
    means = np.c_[rng.uniform(-0.5, 0.5, (300, 2)), np.ones(300)]
    return round_ones(means, size=0.08, opacity=0.5, rng=rng)
