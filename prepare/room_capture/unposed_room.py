"""A static environment of a splat without its cameras that has no floor, or none from which it is seen clearly.

The likely cameras (likely_cameras.py) take the place of the photographs': Gaussians that none of them needs are left
out, the space that they looked through is free, the player stands where the best one is. What is played with lies on a
level surface in view, or on an unseen level in front of what is looked at.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from assets.gaussians import Gaussians
from assets.level_planes import AXES
from assets.reoriented import turned_environment, turned_grid
from assets.up_axis import most_likely, robust_bounds, rotation_to_up, up_probabilities
from core.camera import look_at, perspective
from core.errors import BadInput
from core.rotation import rotation_between
from prepare.cleaning import cut_out
from prepare.environment.clear_view import CLEAR, clearest
from prepare.environment.environment_pipeline import (
    ENVIRONMENT_VERSION,
    EnvironmentOptions,
    main_component,
    prepare_environment,
)
from prepare.environment.support_planes import NoFloor
from prepare.orientation.capture_orientation import VIEW_DISTANCE, VIEW_SPREAD, lowest_surface, support_plane
from prepare.progress import Progress, no_progress
from prepare.room_capture.captured_background import RoomView, captured_environment, room_extent
from prepare.room_capture.contributions import SIDE, contributions, needed
from prepare.room_capture.likely_cameras import NothingSeen, Outlook, ScoredViews, likely_cameras

SHARP = 0.8  # of the picture at the start; a backdrop that no photograph was about is blurred
SEARCHING = "searching for where cameras may have been"
UNPOSED_STEPS = ("views", "cameras", "surface", "planes", "distance")
FOV_Y = 1.2  # [rad] of the likely cameras: wider than a photographer's lens, so that little is cut off
LEAN_ERROR = np.radians(6.0)  # of a file's axis from the vertical; a plane may lean by 2.5 times as much
LEVEL_HALF = 0.4  # [m] half a side of the unseen level on which things are played with
LEVEL_FREE = 0.15  # [m] radius of free space over it that is enough
# Places to try: parts of the way from the eye to what is looked at, and of that distance below the line of sight.
LEVEL_WAYS, LEVEL_DOWN = (0.75, 0.7, 0.65, 0.6, 0.55, 0.5), 0.2


@dataclass(frozen=True)
class Placed:
    """A splat in metres with +y up, and what is likely of its cameras.

    up, chances  the file's axis that points up, and the probability of each that was considered
    rotation     (3, 3) from the file's frame, and `factor` [m per unit]
    """

    gaussians: Gaussians
    cut: dict[int, Gaussians]
    outlook: Outlook
    floor_seen: bool
    up: str
    chances: dict[str, float]
    rotation: np.ndarray
    factor: float


def playable_environment(
    gaussians: Gaussians,
    options: EnvironmentOptions | None = None,
    *,
    progress: Progress = no_progress,
    again: Progress = no_progress,
    report=lambda line: None,
) -> tuple[Asset, dict[int, Gaussians]]:
    """As `prepare_environment`; where there is no floor or the view is poor, from likely cameras. Taichi must run.

    progress, again  of the first way and of the second one, with steps of ENVIRONMENT_STEPS and UNPOSED_STEPS
    report           told why the second way is tried
    Raises BadInput.
    """
    options, made, why = options or EnvironmentOptions(), None, None
    try:
        made = prepare_environment(gaussians, options, progress=progress)
        share = made[0].provenance["clear_view"]
        sharp = start_of(made[0])[0]
        if share >= CLEAR and sharp >= SHARP:
            return made
        report(f"of the view from its floor {min(share, sharp):.0%} is clear and sharp: {SEARCHING}")
    except NoFloor as e:
        why = e
        report(f"{e}: {SEARCHING}")
    try:
        found = unposed_environment(gaussians, options, progress=again)
    except BadInput as e:
        if made is not None:
            return made
        raise why if isinstance(e, NothingSeen) else e from why
    worse = made is not None and np.prod(start_of(found[0])) <= np.prod(start_of(made[0]))
    return made if worse else found


def start_of(asset: Asset) -> tuple[float, float]:
    """The share of the picture at the start that is sharp, and that of the splat's detail which it shows."""
    environment, views = asset.environment, ScoredViews(asset.gaussians)
    target = environment.drop_point if environment.target is None else environment.target
    found = views.sharp_and_seen(np.array(environment.eye_position), np.array(target))
    views.destroy()
    return found


def unposed_environment(
    gaussians: Gaussians, options: EnvironmentOptions, *, progress: Progress = no_progress
) -> tuple[Asset, dict[int, Gaussians]]:
    """The environment around the likely cameras of a splat. Taichi must be running. Raises BadInput."""
    begin = time.perf_counter()
    options.check()
    scene = placed(gaussians, options, progress)
    g, outlook = scene.gaussians, scene.outlook
    wide = [perspective(SIDE, 3 * SIDE // 4, FOV_Y, c.world_to_camera) for c in outlook.cameras]
    found = contributions(g, wide, progress=lambda step, done: progress("cameras", done))
    keep = needed(g, wide, found)
    g, weight = g.select(keep), found.weight[keep]
    view = RoomView(wide, found.depth, scene.floor_seen, stand=0)
    asset = captured_environment(g, view, room_extent(g, weight, view), cell=options.cell, progress=progress)
    if asset.provenance["drop_on"] == "nothing":
        asset = replace(asset, environment=on_unseen_level(asset, outlook))
    environment = replace(asset.environment, target=tuple(map(float, outlook.target)))
    _, share = clearest(g, [np.array(environment.eye_position)], outlook.target)
    to = -np.array([environment.drop_point[0], environment.floor_height, environment.drop_point[2]])
    provenance = asset.provenance | {
        "made_by": f"vrgs prepare --static {ENVIRONMENT_VERSION}",
        "options": {"up": options.up, "scale": options.scale, "cell": options.cell, "cut": list(options.cut)},
        "up": scene.up,
        "up_sure": round(scene.chances[scene.up], 2),
        "up_probabilities": {up: round(p, 3) for up, p in scene.chances.items()},
        "lean": round(float(np.degrees(np.arccos(np.clip(scene.rotation[1] @ AXES[scene.up], -1, 1)))), 2),
        "size": float(np.ptp(np.percentile(g.means, (0.5, 99.5), axis=0), axis=0).max()),
        "metres_per_unit": scene.factor,
        "clear_view": round(share, 2),
        "likely_cameras": len(wide),
        "not_needed": int((~keep).sum()),
        "seconds": round(time.perf_counter() - begin, 2),
    }
    same = np.eye(3)
    moved = Asset(
        asset.gaussians.transformed(same, to),
        sdf=turned_grid(asset.sdf, same, 1.0, to),
        provenance=provenance,
        environment=turned_environment(environment, same, 1.0, to),
    )
    return moved, {k: p.transformed(same, to) for k, p in scene.cut.items()}


def placed(gaussians: Gaussians, options: EnvironmentOptions, progress: Progress) -> Placed:
    """The splat upright, level where a support plane is seen, in metres, and its likely cameras.

    The size is the file's if the distance of the cameras is one of a photographer then, else guessed by that distance.
    """
    main = main_component(gaussians)
    chances = up_probabilities(main, kind="scene") if options.up is None else {options.up: 1.0}
    up, _ = most_likely(chances)
    rotation = rotation_to_up(up)
    outlook = likely_cameras(gaussians.transformed(rotation), progress=progress)
    upright = main.transformed(rotation)
    plane = support_plane(upright, outlook.places, outlook.target, np.array([0.0, 1.0, 0.0]), LEAN_ERROR)
    turn = np.eye(3) if plane is None else rotation_between(plane[0], (0.0, 1.0, 0.0))
    rotation, target = turn @ rotation, turn @ outlook.target
    floor = lowest_surface(upright, outlook.places, outlook.target, np.eye(3)[1]) if plane is None else plane[1]
    away = float(np.linalg.norm(outlook.places[0] - outlook.target))
    usual = VIEW_DISTANCE / VIEW_SPREAD <= away <= VIEW_DISTANCE * VIEW_SPREAD
    factor = 1.0 if usual else VIEW_DISTANCE / away
    if options.scale is not None:
        low, high = robust_bounds(main.means.astype(np.float64))
        factor = options.scale / float((high - low).max())
    shift = -factor * np.array([target[0], floor, target[2]])
    cut, rest = cut_out(gaussians.transformed(rotation, shift, factor), options.cut)
    cameras = []
    for c in outlook.cameras:
        eye, at = (factor * turn @ p + shift for p in (c.position, outlook.target))
        cameras.append(perspective(c.width, c.height, FOV_Y, look_at(eye, at)))
    outlook = replace(outlook, cameras=cameras, target=factor * target + shift)
    return Placed(rest, cut, outlook, plane is not None, up, chances, rotation, factor)


def on_unseen_level(asset: Asset, outlook: Outlook) -> Environment:
    """The environment with a level that nothing shows, in view and in free space before what is looked at."""
    environment = asset.environment
    eye, target = np.array(environment.eye_position), outlook.target
    away = float(np.linalg.norm(target - eye))
    down = np.cross(np.cross([0.0, 1.0, 0.0], target - eye), target - eye) / away**2
    ways = [eye + t * (target - eye) + t * LEVEL_DOWN * away * down / np.linalg.norm(down) for t in LEVEL_WAYS]
    free = np.min([g.sample_extended(np.array(ways)) for g in asset.grids], axis=0)
    best = int(np.argmax(free >= LEVEL_FREE)) if (free >= LEVEL_FREE).any() else int(np.argmax(free))
    x, y, z = ways[best]
    row = ("unseen", float(y), *(float(v) for v in (x - LEVEL_HALF, z - LEVEL_HALF, x + LEVEL_HALF, z + LEVEL_HALF)))
    clear = float(max(free[best], 0.05))
    drop, planes = (float(x), float(y), float(z)), (*environment.planes, row)
    return replace(environment, drop_point=drop, clear_radius=clear, planes=planes)
