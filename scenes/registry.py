"""The demos by name: each module of this package with a function `build` is one. Scene files and rooms have paths.

A scene file is a program: only a path that the user has written on the command line comes here.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import scenes
from assets.file_access import file_size
from assets.room_folder import MANIFEST, is_room_folder
from core.errors import BadInput
from scenes.scene_options import SceneOption, options_of

if TYPE_CHECKING:  # a module that has it is taken for a scene
    from scenes.scene import Scene


@dataclass(frozen=True)
class Demo:
    """A scene file: its name, the first line of its docstring, `build` and its options; or the `fault` that it has."""

    name: str
    summary: str = ""
    build: Callable[..., Scene] | None = None
    fault: str = ""
    options: list[SceneOption] = field(default_factory=list)


def demo(name: str) -> Demo | None:
    """The demo in a module of this package, or in a file; None for a module that neither has `build` nor uses Scene:
    others share it."""
    if is_room(name):
        from scenes.captured_room import room_scene

        return Demo(name, f"{label(name)}: a captured room", partial(room_scene, name))
    try:
        module = module_of_file(Path(name)) if is_scene_file(name) else importlib.import_module(f"scenes.{name}")
    except BadInput as e:
        return Demo(name, fault=str(e).removeprefix(f"{name}: "))
    except Exception as e:  # a user's file may fail in any way; the other demos can be played all the same
        return Demo(name, fault=fault_of(e, name))
    build, scene_type = vars(module).get("build"), vars(module).get("Scene")
    if build is None and (scene_type is None or scene_type.__module__ == module.__name__):
        return None
    if not callable(build):
        return Demo(name, fault="it has no function build")
    try:
        options = options_of(build)
    except Exception as e:  # type hints are evaluated
        return Demo(name, fault=" ".join(f"{e}".split()))
    return Demo(name, (module.__doc__ or "(no description)").strip().splitlines()[0], build, options=options)


def is_scene_file(name: str) -> bool:
    """True for the path of a scene file, False for the name of a demo of this package."""
    return name.endswith(".py")


def is_room(name: str) -> bool:
    """True for the path of a captured room; a demo's name is none, whatever folders there are."""
    return name not in module_names() and not is_scene_file(name) and is_room_folder(name)


def module_names() -> list[str]:
    """Names of the modules of this package, sorted."""
    return sorted(m.name for m in pkgutil.iter_modules(scenes.__path__))


def rooms() -> list[str]:
    """The captured rooms in the working directory, sorted."""
    try:
        return sorted(p.parent.name for p in Path().glob(f"*/{MANIFEST}") if is_room(p.parent.name))
    except OSError:
        return []


def label(name: str) -> str:
    """The name of a scene for titles and files: of a scene file its own without the folder, of a room its folder's."""
    return Path(name).stem if is_scene_file(name) else Path(name).absolute().name if is_room(name) else name


def module_of_file(path: Path):
    """The module in a scene file, which is run. It may import its neighbours."""
    file_size(path)
    name = f"scene_file_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look for it there
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(folder)
    return module


def fault_of(error: Exception, name: str) -> str:
    """An error of a scene file in one line, with the number of the file's line in which it arose."""
    text = " ".join(f"{type(error).__name__}: {getattr(error, 'msg', None) or error}".split())
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if is_scene_file(name) and Path(frame.filename) == Path(name):
            line = frame.lineno
    return text if line is None else f"line {line}: {text}"


def built(found: Demo, values: dict) -> Scene:
    """The scene that `build` makes. Raises BadInput, also for an error in the scene file of a user's."""
    from scenes.scene import Scene

    try:
        scene = found.build(**values)
    except BadInput:
        raise
    except Exception as e:
        if not is_scene_file(found.name):
            raise
        raise BadInput(f"{found.name}: {fault_of(e, found.name)}") from e
    if not isinstance(scene, Scene):
        raise BadInput(f"{found.name}: build gives no Scene but {type(scene).__name__}")
    return scene


def demos() -> list[Demo]:
    """All demos and faulty scene files, sorted by name, then the captured rooms in the working directory."""
    found = (demo(name) for name in (*module_names(), *rooms()))
    return [d for d in found if d is not None]


def names() -> list[str]:
    """Names of the demos that can be played, sorted."""
    return [d.name for d in demos() if d.build is not None]


def load(
    name: str,
    /,
    *,
    body: str | Sequence[str] | None = None,
    material: str | None = None,
    stage: str | None = None,
    resize: bool = True,
    **options,
) -> Scene:
    """Build the scene, with the user's bodies and room in their roles. Options that are None are not given.

    body, stage  assets
    material     a name: of the bodies
    resize       let bodies become as large as their roles ask for; otherwise all keep their sizes
    options      of the scene, texts or values

    Raises BadInput, also for what the scene does not take.
    """
    there = is_scene_file(name) or is_room(name) or name in module_names()
    found = demo(name) if there else None
    if found is None and is_scene_file(name):
        raise BadInput(f"{name}: it has no function build (docs/writing_a_scene.md)")
    if found is None and Path(name).is_dir():
        raise BadInput(f"{name}: holds no {MANIFEST}; a captured room is made by: vrgs.py capture")
    if found is None:
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(names())}")
    if found.build is None:
        raise BadInput(
            f"{name}: {found.fault}" if is_scene_file(name) else f"the scene {name} cannot be played: {found.fault}"
        )
    taken = inspect.signature(found.build).parameters
    known = {option.name: option for option in found.options}
    values = {}
    for key, given in options.items():
        if given is not None:
            if key not in known:
                instead = "; a room to play in is its --stage" if key == "capture" else ""
                raise BadInput(f"the scene {name} takes no --{key.replace('_', '-')}{instead}")
            values[key] = known[key].value(given, name)
    assets = [body] if isinstance(body, str) else list(body or ())
    played = []  # by what `build` does itself
    if assets and "body" in taken:
        played = assets[:1] if isinstance(taken["body"].default, str) else assets
        values["body"] = assets[0] if isinstance(taken["body"].default, str) else tuple(assets)
    if material is not None and "material" in taken:
        values["material"] = material
    elif material is not None and not assets:
        raise BadInput(f"the scene {name} takes no --material without --body")
    scene = built(found, values)
    if not resize:
        scene = replace(scene, roles=tuple(replace(role, resize=False) for role in scene.roles))
    return with_users(scene, name, played, assets[len(played) :], material, stage)


def with_users(
    scene: Scene, name: str, played: list[str], assets: list[str], material: str | None, stage: str | None
) -> Scene:
    """The scene with the user's assets in its roles, and in the user's room. Raises BadInput."""
    from scenes.roles import cast_bodies, in_room

    if assets and not scene.roles:
        raise BadInput(f"the scene {name} takes no --body")
    if stage is not None and scene.room is None:
        raise BadInput(f"the scene {name} takes no --stage")
    if played or assets:
        scene = cast_bodies(scene, played, assets, material)
    return scene if stage is None else in_room(scene, stage)
