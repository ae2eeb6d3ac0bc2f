"""A body's corrected up, front and size, or a room's, written into the asset file it was made of, so that the next play
has them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from assets.asset import Asset, is_quantised
from assets.file_access import atomic_write_all, locked_folder
from assets.library import SHIPPED_FOLDER, find_asset
from assets.room_folder import MANIFEST, is_room_folder, read_room, write_room
from core.errors import BadInput
from core.rotation import best_fit_rotation, matrices_from_quaternions
from core.vocabulary import Body

if TYPE_CHECKING:
    from display.viewer import Viewer
    from display.world import World

SAME = 1e-6  # of a rotation's entries, and of a factor


def frame_writer(world: World | Viewer, body: int | None) -> tuple[Path, Callable[[], None]]:
    """The asset file of a body (None: of the selected one), and a function that writes it with the up, front and size
    that the body has now.

    In a viewer it is the file that is shown; if the room was turned, that of the room. The next play of the scene puts
    the body where it stood at the beginning, turned and as large as it is now. Raises BadInput if the file is not the
    user's own, or its frame cannot change.
    """
    if world.file is not None:
        return file_writer(world)
    if world.room.turned:
        return room_writer(world)
    k = world.editor.index_of(body)
    placed = body_of(world, k)
    path = find_asset(placed.asset)
    asset, small = Asset.load(path), is_quantised(path)
    rotation, factor = turn_since(asset, world, k)
    start = world.room.pose[:3, :3] @ matrices_from_quaternions(np.asarray(placed.rotation, np.float64))
    rotation, factor = start.T @ rotation, factor / placed.scale
    check_change(path, rotation, factor)
    changed = asset.transformed(rotation, factor)
    return path, lambda: changed.save(path, quantised=small)


def room_writer(world: World, factor: float = 1.0) -> tuple[Path, Callable[[], None]]:
    """The file of the turned room, and a function that writes it, `factor` times as large, in some seconds.

    Raises BadInput if the room is not the user's.
    """
    room = world.room
    if room.own is None:
        raise BadInput("Only a room of your own can be changed: --stage ROOM.")
    path, pose = find_asset(room.own.asset), room.pose
    start = matrices_from_quaternions(np.asarray(room.own.rotation, np.float64))
    rotation = start.T @ pose[:3, :3] @ room.kept[:3, :3].T @ start

    def write() -> None:
        write_room_turned(path, rotation, factor)
        room.kept = pose

    return path, write


def write_room_turned(path: Path, rotation: np.ndarray, factor: float = 1.0) -> None:
    """Write a room's asset turned by (3, 3) and scaled, and the manifest of a captured room with it.

    Raises BadInput.
    """
    if not is_room_folder(path.parent):
        Asset.load(path).transformed(rotation, factor).save(path, quantised=is_quantised(path))
        return
    if factor != 1.0:
        raise BadInput(
            "The size of a captured room is that of its objects, too: vrgs.py capture --scale-points sets it."
        )
    with locked_folder(path.parent):  # vrgs.py capture may be making the room anew
        changed, small = Asset.load(path).transformed(rotation, factor), is_quantised(path)
        room = read_room(path.parent)
        moved = room.transformed(rotation, np.array(changed.provenance["reoriented"][-1][2]))
        with atomic_write_all(path, path.parent / MANIFEST) as (background, manifest):
            changed.save(background, quantised=small)
            write_room(manifest.parent, moved, manifest.name)


def file_writer(viewer: Viewer) -> tuple[Path, Callable[[], None]]:
    """The file that a viewer shows, and a function that writes it turned and scaled as shown. Raises BadInput."""
    file = viewer.file
    if file.path.suffix.lower() != ".h5":
        raise BadInput("O writes a splat file as it stands, +y up; then prepare that one.")
    turn, factor = file.turn, file.factor
    check_change(file.path, turn, factor)
    asset, small = Asset.load(file.path), is_quantised(file.path)
    changed = None if asset.environment is not None else asset.transformed(turn, factor)

    def write() -> None:
        if changed is None:
            write_room_turned(file.path, turn, factor)
        else:
            changed.save(file.path, quantised=small)
        viewer.frame_kept(file.path, turn, factor)

    return file.path, write


def check_change(path: Path, rotation: np.ndarray, factor: float) -> None:
    """Raise BadInput if a file comes with the program, or if nothing would change in it."""
    if path.resolve().is_relative_to(SHIPPED_FOLDER.resolve()):
        raise BadInput(f"{path.stem} comes with the program: only what is your own can be changed for good.")
    if np.abs(rotation - np.eye(3)).max() < SAME and abs(factor - 1.0) < SAME:
        raise BadInput(f"{path.stem} is already in its file as it is here.")


def body_of(world: World, k: int) -> Body:
    """The body, of the scene or of an asset that joined, of which body k is a copy. Raises BadInput."""
    registry = world.registry
    source = registry.members[k].source
    own = [b for b in world.scene.bodies if b.material is not None]
    joined = {sources[0]: Body(asset, None) for asset, sources in registry.added.items() if len(sources) == 1}
    found = own[source] if source < len(own) else joined.get(source)
    names = [model.body.name for model in registry.scene_models]
    if found is None or (source < len(own) and names.count(found.asset) > sum(b.asset == found.asset for b in own)):
        raise BadInput("It is a piece of a body: pieces cannot be changed for good one by one.")
    return found


def turn_since(asset: Asset, world: World, k: int) -> tuple[np.ndarray, float]:
    """Rotation (3, 3) and relative size of body k, deformed or not, since the asset in its file, which may have been
    written a moment ago. Raises BadInput if the file has another cage by now."""
    solver = world.device.solver
    model = solver.body_models[k]
    first, last = solver.vertex_offset[k : k + 2]
    x = solver.snapshot()["x"][first:last].astype(np.float64)
    if asset.cage is None or len(asset.cage.vertices) != len(x):
        raise BadInput("Its file has been prepared anew since: begin the play again.")
    rest = asset.cage.vertices.astype(np.float64)
    rest -= np.average(rest, axis=0, weights=model.mass)
    x -= np.average(x, axis=0, weights=model.mass)
    now = model.shape.vertices - model.shape.center
    factor = np.sqrt((model.mass @ (now**2).sum(1)) / (model.mass @ (rest**2).sum(1)))
    return best_fit_rotation((x * model.mass[:, None]).T @ rest), float(factor)
