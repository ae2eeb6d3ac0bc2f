"""Assets of --body and --stage: as they are, or prepared from a splat file and kept in the cache."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assets.camera_file import cameras_of_splat
from assets.file_access import file_size
from assets.hdf5 import open_hdf5
from assets.library import cached_asset, is_asset
from assets.orientation import question
from assets.room_folder import is_room_folder, read_room
from assets.splat_files import check_kind
from core.errors import BadInput
from core.program import cache_folder
from core.runtime import running_arch, start_taichi
from scenes.registry import demo

if TYPE_CHECKING:
    from commands.options import Preparation
    from commands.play_options import PlayOptions
    from prepare.pipeline import Options
    from prepare.progress import Progress

BODY_CACHE_VERSION, ENVIRONMENT_CACHE_VERSION = 8, 7  # of what `cached_body` and `cached_environment` make


def prepared_bodies(options: PlayOptions) -> list[str]:
    """The asset of each --body: an asset as it is, a splat prepared and cached.

    Without --vertices, options.vertices becomes that of the only splat, or a list of theirs.
    """
    splats = [name for name in options.body or () if not is_asset(name)]
    wanted = options.vertices if isinstance(options.vertices, list) else [options.vertices] * len(splats)
    if len(wanted) != len(splats):
        raise BadInput(f"there are numbers of vertices for {len(wanted)} bodies, not for {len(splats)}")
    made = {}
    for k, name in enumerate(splats):
        made[name], wanted[k] = cached_body(Path(name), options, options.arch, options.seed, vertices=wanted[k])
    if splats:
        options.vertices = wanted[0] if len(wanted) == 1 else wanted
    return [str(made.get(name, name)) for name in options.body or ()]


def prepared_stage(options: PlayOptions) -> str | None:
    """The asset of --stage: an asset as it is, the background of a captured room, a splat prepared and cached."""
    if options.stage is None or is_asset(options.stage):
        return options.stage
    if Path(options.stage).is_dir():
        return str(Path(options.stage) / read_room(options.stage).background)
    return str(cached_environment(Path(options.stage), options.arch, options.seed))


def prepared_capture(options: PlayOptions) -> None:
    """Make a room of the capture that a scene's option --capture names, unless it is one; kept in the cache.

    The option becomes the room's folder.
    """
    capture = options.options.get("capture")
    if capture is None or is_room_folder(capture):
        return
    from commands.capture_room import CaptureOptions, make_room

    found = demo(options.scene)
    if found is None or all(option.name != "capture" for option in found.options):
        return  # it is refused later, with the reason
    path = Path(capture)
    if not path.exists():
        raise BadInput(f"{capture}: no such file or folder")
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    room = cache_folder() / "rooms" / f"{path.resolve().stem}-{name}"
    print(f"making a room of {capture} (once; kept as {room})", flush=True)
    make_room(CaptureOptions(capture=path, out=room, arch=options.arch, seed=options.seed))
    options.options = {**options.options, "capture": str(room)}


def is_animated(splats: Path, rig: Path | None = None) -> bool:
    """True if the body made of these files moves by itself."""
    from prepare.rig.rig_source import is_skinned

    return rig is not None or is_skinned(splats)


def suited(vertices: int) -> str:
    """The line that says which number of vertices was chosen."""
    return f"a cage of {vertices} vertices, as suits a {'GPU' if running_arch() == 'cuda' else 'CPU'} (--vertices N)"


def cached_body(
    splats: Path,
    how: Preparation,
    arch: str | None = None,
    seed: int = 0,
    *,
    vertices: int | None = None,
    progress: Progress | None = None,
) -> tuple[Path, int]:
    """The asset prepared from a splat file, and its number of vertices; made now unless it is in the cache.

    vertices  of the cage, instead of those in `how`; without either as many as suit the device
    Raises BadInput.
    """
    file_size(splats)
    vertices = vertices or how.vertices
    chosen = () if vertices else chosen_vertices(splats, arch, seed)
    out = body_place(splats, how, vertices or chosen)
    if vertices and not out.is_file():  # a state and a recording name the number that was chosen
        automatic = body_place(splats, how, chosen_vertices(splats, arch, seed))
        out = automatic if automatic.is_file() and wanted_vertices(automatic) == vertices else out
    if _is_to_be_made(splats, out, arch, seed):
        from prepare.prepared_files import prepare_file

        prepare_file(splats, out, pipeline_options(how, vertices or chosen[0]), vertices=chosen, progress=progress)
    if chosen:
        vertices = wanted_vertices(out)
        print(f"{splats.name}: {suited(vertices)}", flush=True)
    return out, vertices


def pipeline_options(how: Preparation, vertices: int) -> Options:
    """The options of `prepare` for a cage of so many vertices."""
    from prepare.pipeline import Options

    adaptive = how.cells == "adaptive"
    return Options(vertices, how.scale, how.up, adaptive=adaptive, pieces=how.pieces, front=how.front)


def chosen_vertices(splats: Path, arch: str | None, seed: int) -> tuple[int, ...]:
    """Numbers of vertices to be tried in turn where none is asked for."""
    from prepare.prepared_files import device_vertices

    start_taichi(arch, seed)
    return device_vertices(animated=is_animated(splats))


def body_place(splats: Path, how: Preparation, vertices: int | tuple[int, ...]) -> Path:
    """Path in the cache of the asset of a splat file, whether or not it exists yet."""
    key = {"vertices": vertices, "scale": how.scale, "up": how.up}
    key |= {} if how.front is None else {"front": how.front}
    key |= {} if how.cells == "adaptive" else {"cells": how.cells}
    key |= {"pieces": True} if how.pieces else {}
    return cached_asset(splats, key | {"version": BODY_CACHE_VERSION})


def environment_place(splats: Path) -> Path:
    """Path in the cache of the environment of a splat file, whether or not it exists yet."""
    known = cameras_of_splat(splats)
    seen = {} if known is None else {"cameras": hashlib.sha256(known.read_bytes()).hexdigest()}
    return cached_asset(splats, {"stage": ENVIRONMENT_CACHE_VERSION} | seen)


def is_prepared(path: Path, options: PlayOptions, *, room: bool) -> bool:
    """True if the asset of a splat file is in the cache. Raises BadInput for a missing file."""
    file_size(path)
    if room:
        return environment_place(path).is_file()
    vertices = options.vertices or chosen_vertices(path, options.arch, options.seed)
    return body_place(path, options, vertices).is_file()


def wanted_vertices(path: Path) -> int:
    """Number of vertices that an asset of `prepare` was asked for. Raises BadInput."""
    with open_hdf5(path) as file:
        try:
            return int(file.json("", "provenance", dict[str, Any])["options"]["vertices"])
        except (KeyError, TypeError, ValueError) as e:
            raise file.error("does not say how many vertices it was prepared with") from e


def cached_environment(
    splats: Path, arch: str | None = None, seed: int = 0, *, progress: Progress | None = None
) -> Path:
    """The environment prepared from a splat file; made now unless it is in the cache. Raises BadInput."""
    file_size(splats)
    out = environment_place(splats)
    if _is_to_be_made(splats, out, arch, seed):
        from prepare.prepared_files import prepare_environment_file

        prepare_environment_file(splats, out, progress=progress)
    return out


def _is_to_be_made(splats: Path, out: Path, arch: str | None, seed: int) -> bool:
    """True if the asset `out` of a splat file is not in the cache; then Taichi is started.

    Of one that is, a line says again that its up axis was not sure, unless it has been turned since.
    """
    if not out.is_file():
        check_kind(splats)
        start_taichi(arch, seed)
        print(f"preparing {splats.name} (once; kept as {out})", flush=True)
        return True
    with open_hdf5(out) as file:
        provenance = file.json("", "provenance", dict[str, Any])
    chances = {} if "reoriented" in provenance else provenance.get("up_probabilities", {})
    if line := question(chances):
        print(f"{splats.name}: {line}", flush=True)
    return False
