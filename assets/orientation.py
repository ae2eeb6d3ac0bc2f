"""The up axis, of a bare splat from cues, of a scene from its floor, of a capture from its cameras; and the front.

Structure from motion leaves the frame free, and tools differ (y down from COLMAP, y up from editors). Cameras and a
floor tell the vertical to a degree. Of a bare splat the guess is a probability for each of the file's six axes: a
conditional logit model (McFadden 1974) of four cues times how often files have that axis up, fitted on 1,200 turned and
cut objects and rooms. Of others 76% are right (of cuts of shipped assets 65%), and of those said with 80% or more, 90%.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.gaussians import Gaussians, normals_and_areas, robust_bounds
from core.errors import BadInput
from core.planes import LEVEL_COS, fit_level_plane, largest_level_plane, lowest_level_plane, mean_normal
from core.rotation import rotation_between
from core.spherical_harmonics import C0

# The axes of a file that may point up, by name: "-y", "+y", ... and their directions, (3,).
AXES = {f"{sign}{'xyz'[axis]}": np.eye(3)[axis] * (1 if sign == "+" else -1) for axis in (1, 2, 0) for sign in "-+"}

# log P(up | cues) = sum_k WEIGHTS[k] cue_k(up) + const. Left out for less than a point each: an underside that is
# missing, the centre's height, stability, asymmetry above and below, level shelves.
WEIGHTS = {"bright": 9.44, "foot": 1.91, "sharp": 14.2, "askew": -9.08}
LAPSE = 0.0081  # share of the cases, fitted, in which the cues mean nothing: no guess is surer than that leaves it
# Frequencies of a file's up axis: of 30 splats that public programs for the web place in their code, 18 have -y up
# (COLMAP's), 10 +y, one +z and one -z. Two more are added to each.
FILE_PRIOR = {"-y": 0.48, "+y": 0.29, "+z": 0.07, "-z": 0.07, "+x": 0.05, "-x": 0.04}
UNSURE = 0.8  # below, the user is shown the alternatives
ALTERNATIVE_MIN = 0.02  # probability of an axis that is shown as one


def rotation_to_up(up: str) -> np.ndarray:
    """The smallest rotation (3, 3) that takes the axis `up` of the file to +y. Raises BadInput."""
    if up not in AXES:
        raise BadInput(f"up axis {up!r} is unknown; one of {', '.join(sorted(AXES))}")
    if up == "-y":  # half a turn about x, as from COLMAP's cameras to OpenGL's
        return np.diag([1.0, -1.0, -1.0])
    return np.rint(rotation_between(AXES[up], (0.0, 1.0, 0.0)))


def up_probabilities(gaussians: Gaussians, prior: dict[str, float] = FILE_PRIOR) -> dict[str, float]:
    """Probability of each axis of the file, "+x" to "-z", to point up."""
    cues = up_cues(gaussians)
    given = np.array([prior[up] for up in AXES])
    given /= given.sum()
    votes = np.array([sum(w * cues[up][name] for name, w in WEIGHTS.items()) for up in AXES])
    likely = given * np.exp(votes - votes.max())
    p = (1 - LAPSE) * likely / likely.sum() + LAPSE * given
    return dict(zip(AXES, p.tolist(), strict=True))


def guess_up_axis(gaussians: Gaussians) -> tuple[str, float]:
    """The most probable up axis of a file, "+x", "-x", ... "-z", and its probability."""
    return most_likely(up_probabilities(gaussians))


def most_likely(probabilities: dict[str, float]) -> tuple[str, float]:
    """The most probable axis, and its probability."""
    up = max(probabilities, key=probabilities.get)
    return up, probabilities[up]


def alternatives(probabilities: dict[str, float]) -> list[str]:
    """The axes that may well point up, most probable first; one alone if that is sure."""
    ranked = sorted(probabilities, key=probabilities.get, reverse=True)
    if not ranked or probabilities[ranked[0]] >= UNSURE:
        return ranked[:1]
    return [up for up in ranked if probabilities[up] >= ALTERNATIVE_MIN]


def describe_guess(up: str, probabilities: dict[str, float]) -> str:
    """A guess in words, for the terminal; without probabilities cameras have told the up axis."""
    how = f"guessed, {probabilities[up]:.0%} sure" if probabilities else "as its cameras stand"
    return f"{up} ({how}; --up overrides)"


def question(probabilities: dict[str, float], pictures: Path | None = None) -> str:
    """The line that shows the alternatives to the user, as options of the command line; "" if the guess is sure."""
    ups = alternatives(probabilities)
    if len(ups) < 2:
        return ""
    listed = ", ".join(f"--up {up} {probabilities[up]:.0%}" for up in ups)
    return f"which way is up is not sure: {listed}" + (f"; pictures: {pictures}" if pictures is not None else "")


# Cues of a bare splat

SAMPLE = 8000  # Gaussians that are looked at
CORE_RADIUS = 4.0  # median distances from the middle: a backdrop lies farther
LEAN_MAX = np.cos(np.radians(25.0))  # of level planes against the file's axis; beyond, they are other planes
SHARP_COS = np.cos(np.radians(8.0))  # of normals of very level surfaces to the vertical
VIEW_PIXELS = 64  # on the longest side of the views from above and below
LUMA = np.array([0.299, 0.587, 0.114])  # BT.601
FOOT_HEIGHT = 0.05  # of the longest extent: the part that the object stands on
MAP_CELLS = 24  # on the longest side of the maps of what stands where
MIRROR_CELLS, MIRROR_PLANES = 20, 8  # on the longest side of the grid of mirror images, and planes that are tried


def up_cues(gaussians: Gaussians) -> dict[str, dict[str, float]]:
    """Cues for each axis, "+x" to "-z", to point up, by name.

    bright  how much brighter the topmost Gaussians are than the undermost: light comes from above
    foot    how much wider the lowest slice is than the highest: things stand on something
    sharp   share of the surface that is very level: floors, ceilings, tables, seats
    askew   how little it resembles its images mirrored at upright planes: most things are alike left and right
    """
    some = gaussians.select(np.arange(0, len(gaussians), max(1, -(-len(gaussians) // SAMPLE))))
    g = some.select(some.opacities >= min(0.3, np.median(some.opacities)))
    away = np.linalg.norm(g.means - np.median(g.means, axis=0), axis=1)
    g = g.select(away <= CORE_RADIUS * np.median(away))
    points = g.means.astype(np.float64)
    normals, areas = normals_and_areas(g)
    areas = np.minimum(areas, np.percentile(areas, 99.0))
    areas /= max(areas.sum(), 1e-30)
    luma = np.clip(0.5 + C0 * g.sh[:, 0], 0, 1) @ LUMA
    found = {}
    for axis in range(3):
        along = np.eye(3)[axis]
        direction = mean_normal(along, normals, areas)
        turn = rotation_between(direction if direction @ along > LEAN_MAX else along, (0.0, 1.0, 0.0))
        p = points @ turn.T
        low, high = robust_bounds(p)
        longest = float((high - low).max())
        bright, foot = brighter_above(p, luma, low, longest), wider_below(p, low, high, longest)
        even = {"sharp": float(areas[np.abs(normals @ turn[1]) > SHARP_COS].sum()), "askew": askew(p, low, longest)}
        for name, sign in (("+", 1.0), ("-", -1.0)):
            found[name + "xyz"[axis]] = {"bright": sign * bright, "foot": sign * foot} | even
    return found


def brighter_above(p: np.ndarray, luma: np.ndarray, low: np.ndarray, longest: float) -> float:
    """Mean brightness of the highest of the points (N, 3) in each column along y, less that of the lowest."""
    pixel = np.floor((p[:, [0, 2]] - low[[0, 2]]) / longest * VIEW_PIXELS).astype(np.int64)
    column = pixel[:, 0] * (4 * VIEW_PIXELS) + pixel[:, 1]
    order = np.lexsort([p[:, 1], column])
    edge = np.flatnonzero(np.diff(column[order])) + 1
    below, above = order[np.r_[0, edge]], order[np.r_[edge - 1, len(order) - 1]]
    return float(luma[above].mean() - luma[below].mean())


def wider_below(p: np.ndarray, low: np.ndarray, high: np.ndarray, longest: float) -> float:
    """Share of the ground plan of points (N, 3) that the lowest slice covers, less that of the highest."""
    extent = max(high[1] - low[1], 1e-12)
    h = (2 * (p[:, 1] - low[1]) / extent - 1).clip(-1, 1)  # -1 bottom, 1 top
    slab = min(2 * FOOT_HEIGHT * longest / extent, 0.5)
    cell = np.floor((p[:, [0, 2]] - low[[0, 2]]) / longest * MAP_CELLS).astype(int).clip(-1, MAP_CELLS + 1)
    bottom, top, whole = (len(np.unique(cell[m], axis=0)) for m in (h < slab - 1, -h < slab - 1, slice(None)))
    return (bottom - top) / max(whole, 1)


def askew(p: np.ndarray, low: np.ndarray, longest: float) -> float:
    """Share of the points (N, 3) whose mirror image is no point's neighbour, mean over upright planes."""
    cells = np.floor((p - low) / longest * MIRROR_CELLS).astype(int)
    within = ((cells >= 0) & (cells <= MIRROR_CELLS)).all(1)
    filled = np.zeros((MIRROR_CELLS + 3,) * 3, bool)  # with a border
    filled[tuple((cells[within] + 1).T)] = True
    some = (np.argwhere(filled[1:-1, 1:-1, 1:-1]) + 0.5) / MIRROR_CELLS * longest + low
    near = filled.copy()
    for axis in range(3):
        near |= np.roll(filled, 1, axis) | np.roll(filled, -1, axis)
    centred, missing = some - some.mean(0), []
    for a in np.pi / MIRROR_PLANES * np.arange(MIRROR_PLANES):
        normal = np.array([np.cos(a), 0.0, np.sin(a)])
        image = some - 2 * (centred @ normal)[:, None] * normal
        at = np.floor((image - low) / longest * MIRROR_CELLS).astype(int) + 1
        inside = ((at >= 0) & (at < len(near))).all(1)
        missing.append(1.0 - near[tuple(at[inside].T)].sum() / len(some))
    return float(np.mean(missing))


# The floor of a scene

FLOOR_LEAN_COS = np.cos(np.radians(32.0))  # of a floor to the file's axis; beyond, another axis is nearer, or a wall


def find_gravity(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, up: str) -> tuple[float, np.ndarray]:
    """Height of the floor along the true vertical, and the levelling rotation (3, 3), near the axis `up` of the file.

    points (N, 3) in the file's frame, normals (N, 3) of any sign, areas (N,) weights. An axis of the file is refined
    to the level planes, as cameras are seldom held straight. Raises BadInput for an unknown axis or without a floor.
    """
    turn = rotation_to_up(up)
    direction = mean_normal(turn[1], normals, areas)
    floor, _ = lowest_level_plane(points @ direction, np.abs(normals @ direction) > LEVEL_COS, areas)
    floor, direction = fit_level_plane(points, normals, areas, floor, direction)
    if direction @ turn[1] < FLOOR_LEAN_COS:
        raise BadInput(
            "what is most nearly level leans too much to be a floor (--up names another axis; "
            "with its photographs, vrgs.py capture needs no floor)"
        )
    return floor, rotation_between(turn @ direction, (0.0, 1.0, 0.0)) @ turn


def floor_height(gaussians: Gaussians) -> float:
    """Height [m] of the largest level plane in the lower half, +y up. Raises BadInput where nothing is level."""
    solid = gaussians.opaque()
    normals, areas = normals_and_areas(solid)
    level = np.abs(normals[:, 1]) > LEVEL_COS
    if level.sum() < 10:
        raise BadInput("nothing is level there: a room that is played in needs a floor")
    areas = np.minimum(areas, np.percentile(areas, 99.0))  # a smear must not outweigh a floor
    return lowest_level_plane(solid.means[:, 1].astype(np.float64), level, areas)[0]


# The cameras of a capture

ROLL = np.radians(4.0)  # standard deviation of a hand-held camera's roll
TILT = np.radians(25.0)  # standard deviation of a tilt shared by all photographs, as of a table seen from above
OUTLIER = 3.0  # standard deviations of roll beyond which the cost is constant
# Cost of a picture turned by 0, 1, 2, 3 quarters, as -log of how seldom that is: most cameras store pictures upright.
QUARTER_COST = np.array([0.0, 2.0, 5.0, 2.0])
STARTS = 60  # cameras whose axes are tried as the initial vertical
ITERATIONS = 20
AGREEMENT, AGREEMENT_MIN, AGREEMENT_MAX = 2.5, np.radians(3.0), np.radians(30.0)  # plane to cameras, in errors; [rad]
PLANE_SHARE = 0.04  # a support plane has at least this share of the area of all Gaussians below the cameras
LOWER_SHARE = 0.25  # a level plane under it with this share of its area is the floor, the upper one a table


def up_of_cameras(world_to_camera: np.ndarray) -> tuple[np.ndarray, float]:
    """The vertical (3,) of cameras (V, 4, 4), +z ahead and +y down, V > 0, and the standard deviation of its
    angle [rad] in the direction in which that is largest.

    People hold a camera level to a few degrees, upright or turned by a quarter, but tilt it up or down as they like. So
    the horizontal axes x_i of the pictures are nearly perpendicular to the vertical, and the mean up m of the pictures
    decides what they leave open. It is the maximum of a posterior,
        u ~ (sum_i w_i x_i x_i^T / ROLL^2 + I / TILT^2)^-1 m / TILT^2,
    with weights w_i that leave outliers out. It starts at the best of the pictures' own axes.
    """
    right, down, _ = np.moveaxis(world_to_camera[:, :3, :3], 1, 0)
    axes = np.stack([-down, right, down, -right], 1)  # up in the world if the picture is turned by 0, 1, 2, 3 quarters
    some = axes[:: -(-len(axes) // STARTS)].reshape(-1, 3)
    starts = np.concatenate([_unit(-down.sum(0))[None], some])
    up = starts[np.argmin([_costs(axes, u).min(1).sum() for u in starts])]
    for _ in range(ITERATIONS):
        quarters = _costs(axes, up).argmin(1)
        level, own = (axes[np.arange(len(axes)), (quarters + k) % 4] for k in (1, 0))
        weight = 1 / (1 + (level @ up / (OUTLIER * ROLL)) ** 2) ** 2  # Geman and McClure
        precision = (weight[:, None] * level).T @ level / ROLL**2 + np.eye(3) / TILT**2
        up = _unit(np.linalg.solve(precision, _unit(weight @ own) / TILT**2))
    across = np.linalg.svd(up[None])[2][1:]
    return up, float(np.linalg.eigvalsh(across @ precision @ across.T)[0] ** -0.5)


def _costs(axes: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Cost (V, 4) of each picture for each number of quarter turns, given the vertical `up`."""
    along = axes @ up
    sine_of_roll = np.roll(along, -1, axis=1)
    held = np.minimum((sine_of_roll / ROLL) ** 2, OUTLIER**2) / 2
    tilt = (1 - along.clip(-1, 1)) / TILT**2  # about half the square of the angle
    return held + np.minimum(tilt, OUTLIER**2) + QUARTER_COST


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(np.linalg.norm(v), 1e-12)


def support_plane(near: Gaussians, places: np.ndarray, up: np.ndarray, error: float) -> tuple[np.ndarray, float] | None:
    """Normal (3,) of the largest level plane below cameras at `places` (V, 3), and the height along it of the floor.

    The floor is that plane, or one under it that is not much smaller. None: there is no plane, or none that agrees with
    the cameras' vertical `up` with its `error` [rad]. `near` are the opaque Gaussians without a background.
    """
    below = near.means @ up < np.percentile(places @ up, 5.0)
    if below.sum() < 100:
        return None
    near = near.select(below)
    points = near.means.astype(np.float64)
    normals, areas = normals_and_areas(near)
    areas = np.minimum(areas, np.percentile(areas, 99.0))  # a smear must not outweigh a floor
    size = 2.0 * float(np.percentile(np.linalg.norm(points - np.median(points, axis=0), axis=1), 95.0))
    direction = mean_normal(up, normals, areas)
    for _ in range(2):  # the height of a leaning plane is known only once it is level
        level = np.abs(normals @ direction) > LEVEL_COS
        height, share = largest_level_plane(points @ direction, level, areas, size)
        height, direction = fit_level_plane(points, normals, areas, height, direction)
    apart = np.arccos(np.clip(direction @ up, -1.0, 1.0))
    if share < PLANE_SHARE or apart > np.clip(AGREEMENT * error, AGREEMENT_MIN, AGREEMENT_MAX):
        return None
    heights, level = points @ direction, np.abs(normals @ direction) > LEVEL_COS
    under = heights < height - 0.15 * (np.median(places @ direction) - height)
    if under.sum() > 100 and level[under].any():
        lower, part = lowest_level_plane(heights[under], level[under], areas[under], size)
        if part * areas[under].sum() > LOWER_SHARE * share * areas.sum():
            height = lower
    return direction, float(height)


# The front of a body that stands upright

FRONT_CELLS = 40  # along the largest extent, of the grid that evens out the density of Gaussians
FRONT_ANGLES = np.radians(np.arange(0.0, 180.0, 5.0))  # of the mirror planes that are tried, about +y from z
FRONT_OFFSETS = (-0.02, 0.0, 0.02)  # of the mirror planes from the middle, in extents
UNMATCHED = 0.1  # extents from its neighbour; farther, a mirror image has none
SHAPE_WEIGHT = 10.0  # of a distance in extents against a difference of colours
CONTRAST_NEIGHBOURS = 8  # whose colours differ from a cell's own by its contrast
# log odds of the guess to be right within 25 degrees = BIAS + WEIGHTS . (contrast in extents, symmetry), fitted.
FRONT_BIAS, FRONT_WEIGHTS = -5.7, (91.0, 16.4)
FRONT_SURE = 0.7  # below, a body keeps the front of its file


def turned_about_up(angle: float) -> np.ndarray:
    """Rotation (3, 3) by an angle [rad] about +y, from +z towards +x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def front_of(gaussians: Gaussians) -> tuple[float, float]:
    """Angle [rad] about +y, from +z, of the front of a body that stands upright, and the probability that it is right
    within 25 degrees.

    Faces, limbs and most made things are alike left and right, so the front lies in a mirror plane; and the front has
    the pattern: eyes, a mouth, buttons. Of 54 worn copies of shipped toys 51 were turned by it, 47 to their front.
    """
    from scipy.spatial import cKDTree

    points, colours, spread = _cell_means(gaussians)
    low, high = robust_bounds(points)
    extent = max(float((high - low).max()), 1e-12)
    centred, tree = points - points.mean(axis=0), cKDTree(points)

    def misfit(angle: float) -> float:
        """Least misfit of the points and their images in planes that contain +y and the direction at the angle."""
        side, found = np.array([np.cos(angle), 0.0, -np.sin(angle)]), []
        for offset in FRONT_OFFSETS:
            away, near = tree.query(points - 2.0 * (centred @ side - offset * extent)[:, None] * side)
            shape = np.minimum(away / extent, UNMATCHED).mean()
            found.append(SHAPE_WEIGHT * shape + np.abs(colours[near] - colours).mean())
        return min(found)

    misfits = np.array([misfit(angle) for angle in FRONT_ANGLES])
    angle = float(FRONT_ANGLES[misfits.argmin()])
    _, near = tree.query(points, k=min(CONTRAST_NEIGHBOURS + 1, len(points)))
    contrast = np.abs(colours[near[:, 1:]] - colours[:, None]).mean(axis=(1, 2)) + spread
    offset = float(contrast @ (centred @ [np.sin(angle), 0.0, np.cos(angle)]) / (extent * max(contrast.sum(), 1e-12)))
    symmetry = 1.0 - float(misfits.min() / max(np.median(misfits), 1e-12))
    odds = FRONT_BIAS + np.dot(FRONT_WEIGHTS, (abs(offset), symmetry))
    return angle if offset >= 0 else angle + np.pi, float(1.0 / (1.0 + np.exp(-odds)))


def _cell_means(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean position (C, 3) and colour (C, 3) of the opaque Gaussians in each cell of a grid, and the standard deviation
    of their colours (C,)."""
    g = gaussians.select(gaussians.opacities >= min(0.3, np.median(gaussians.opacities)))
    x = g.means.astype(np.float64)
    colour = np.clip(0.5 + C0 * g.sh[:, 0].astype(np.float64), 0.0, 1.0)
    low, high = robust_bounds(x)
    cell = np.floor((x - low) / max((high - low).max(), 1e-12) * FRONT_CELLS)
    _, index, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(index.ravel(), v) / count for v in values.T], axis=1)

    colours = mean(colour)
    return mean(x), colours, np.sqrt(np.maximum(mean(colour**2) - colours**2, 0.0)).mean(axis=1)
