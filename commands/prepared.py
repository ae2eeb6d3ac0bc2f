"""Assets of the user's bodies and rooms: as they are, or prepared from a splat file and kept in the cache."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

from assets.file_access import file_size
from assets.library import cached_asset
from assets.room_folder import is_room_folder, read_room
from core.errors import BadInput
from core.program import cache_folder
from core.runtime import start_taichi

BODY_CACHE_VERSION, ENVIRONMENT_CACHE_VERSION = 7, 6  # of what `cached_body` and `cached_environment` make


def prepared_bodies(args: argparse.Namespace) -> list[str]:
    """The asset of each --body: an asset as it is, a splat prepared and cached.

    Where no number of vertices is asked for, args.vertices becomes that of the only splat, or theirs in a list.
    """
    if not args.body:
        return []
    splats = [name for name in args.body if not is_asset(name)]
    asked = args.vertices if isinstance(args.vertices, list) else [args.vertices] * len(splats)
    if len(asked) != len(splats):
        raise BadInput(f"there are numbers of vertices for {len(asked)} bodies, not for {len(splats)}")
    made = {}
    for k, name in enumerate(splats):
        made[name], asked[k] = prepared_body(Path(name), args, asked[k])
    if splats:
        args.vertices = asked[0] if len(asked) == 1 else asked
    return [made.get(name, name) for name in args.body]


def is_asset(name: str) -> bool:
    """True if a body or room is an asset already: a shipped one, or an .h5 file."""
    from assets.library import SHIPPED_FOLDER

    return (SHIPPED_FOLDER / f"{name}.h5").is_file() or Path(name).suffix.lower() == ".h5"


def prepared_body(path: Path, args: argparse.Namespace, vertices: int | None) -> tuple[str, int]:
    """The asset of a splat file, and its number of vertices."""
    file_size(path)
    own = argparse.Namespace(**{**vars(args), "vertices": vertices})
    return str(cached_body(path, own)), own.vertices


def prepared_stage(args: argparse.Namespace) -> str | None:
    """The asset of --stage: an asset as it is, the background of a captured room, a splat prepared and cached."""
    if args.stage is None or is_asset(args.stage):
        return args.stage
    if Path(args.stage).is_dir():
        return str(Path(args.stage) / read_room(args.stage).background)
    return str(cached_environment(Path(args.stage), args))


def prepared_capture(args: argparse.Namespace) -> None:
    """Make a room of the capture that a scene's option --capture names, unless it is one; kept in the cache.

    The option becomes the room's folder.
    """
    options = args.options or {}
    capture = options.get("capture")
    if capture is None or is_room_folder(capture):
        return
    from commands.capture_room import make_room, room_arguments
    from scenes.registry import demo

    found = demo(args.scene)
    if found is None or all(option.name != "capture" for option in found.options):
        return  # it is refused later, with the reason
    path = Path(capture)
    if not path.exists():
        raise BadInput(f"{capture}: no such file or folder")
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    room = cache_folder() / "rooms" / f"{path.resolve().stem}-{name}"
    print(f"making a room of {capture} (once; kept as {room})", flush=True)
    make_room(room_arguments(path, room, args.arch, args.seed))
    args.options = {**options, "capture": str(room)}


def is_animated(splats: Path, rig: Path | None = None) -> bool:
    """True if the body made of these files moves by itself."""
    from prepare.rig.rigging import is_skinned

    return rig is not None or is_skinned(Path(splats))


def suited(vertices: int) -> str:
    """The line that says which number of vertices was chosen."""
    import taichi as ti

    return f"a cage of {vertices} vertices, as suits a {'GPU' if ti.cfg.arch == ti.cuda else 'CPU'} (--vertices N)"


def cached_body(splats: Path, args: argparse.Namespace) -> Path:
    """The asset prepared from a splat file with the options; made now unless it is in the cache. Raises BadInput.

    Without args.vertices as many as suit the device are taken; then it becomes that number.
    """
    file_size(splats)
    chosen = chosen_vertices(splats, args)
    out = body_place(splats, args, chosen)
    if not out.is_file():
        from prepare.pipeline import Options
        from prepare.prepared_files import prepare_file

        _begin(splats, out, args)
        adaptive = args.cells == "adaptive"
        how = {"adaptive": adaptive, "pieces": args.pieces, "front": args.front}
        options = Options(args.vertices or chosen[0], args.scale, args.up, **how)
        prepare_file(splats, out, options, vertices=chosen)
    else:
        _ask_up(splats, out)
    if chosen:
        args.vertices = wanted_vertices(out)
        print(f"{splats.name}: {suited(args.vertices)}", flush=True)
    return out


def chosen_vertices(splats: Path, args: argparse.Namespace) -> tuple[int, ...]:
    """Numbers of vertices to be tried in turn, where args.vertices asks for none; else ()."""
    from prepare.prepared_files import device_vertices

    if args.vertices:
        return ()
    start_taichi(args.arch, args.seed)
    return device_vertices(animated=is_animated(splats))


def body_place(splats: Path, args: argparse.Namespace, chosen: tuple[int, ...]) -> Path:
    """Path in the cache of the asset of a splat file, whether or not it exists yet."""
    key = {"vertices": args.vertices or chosen, "scale": args.scale, "up": args.up}
    key |= {} if args.front is None else {"front": args.front}
    key |= {} if args.cells == "adaptive" else {"cells": args.cells}
    key |= {"pieces": True} if args.pieces else {}
    return cached_asset(splats, key | {"version": BODY_CACHE_VERSION})


def environment_place(splats: Path) -> Path:
    """Path in the cache of the environment of a splat file, whether or not it exists yet."""
    return cached_asset(splats, {"stage": ENVIRONMENT_CACHE_VERSION})


def is_prepared(path: Path, args: argparse.Namespace, *, room: bool) -> bool:
    """True if the asset of a splat file is in the cache. Raises BadInput for a file that there is not."""
    file_size(path)
    place = environment_place(path) if room else body_place(path, args, chosen_vertices(path, args))
    return place.is_file()


def wanted_vertices(path: Path) -> int:
    """Number of vertices that an asset of `prepare` was asked for. Raises BadInput."""
    from assets.hdf5 import open_hdf5

    with open_hdf5(path) as file:
        try:
            return int(file.json("", "provenance")["options"]["vertices"])
        except (KeyError, TypeError, ValueError) as e:
            raise file.error("does not say how many vertices it was prepared with") from e


def cached_environment(splats: Path, args: argparse.Namespace) -> Path:
    """The environment prepared from a splat file; made now unless it is in the cache. Raises BadInput."""
    file_size(splats)
    out = environment_place(splats)
    if not out.is_file():
        from prepare.prepared_files import prepare_environment_file

        _begin(splats, out, args)
        prepare_environment_file(splats, out)
    else:
        _ask_up(splats, out)
    return out


def _ask_up(splats: Path, prepared: Path) -> None:
    """Say again, of what was prepared earlier, that its up axis was not sure, unless the user has turned it since."""
    from assets.hdf5 import open_hdf5
    from assets.orientation import question

    with open_hdf5(prepared) as file:
        provenance = file.json("", "provenance")
    chances = {} if "reoriented" in provenance else provenance.get("up_probabilities", {})
    if line := question(chances):
        print(f"{splats.name}: {line}", flush=True)


def _begin(splats: Path, out: Path, args: argparse.Namespace) -> None:
    start_taichi(args.arch, args.seed)
    print(f"preparing {splats.name} (once; kept as {out})", flush=True)
