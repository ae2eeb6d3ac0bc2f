"""The demos by name, with the options of each: every module of this package with a function `build` is one.

Scene files and captured rooms have paths. A scene file is a program: only a path that the user has written on the
command line comes here.

The parameters of `build` are options of the command line: `def build(animal: Literal["fox", "bear"] = "fox")` makes
`--animal fox|bear`. A parameter is a text, a number, a bool or one of several texts (`Literal`), or any of these or
None; `Annotated[str, "a colour"]` says in the help what a text means. COMMON are options of every scene.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import pkgutil
import sys
import traceback
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import scenes
from assets.file_access import file_size
from assets.room_folder import MANIFEST, is_room_folder
from core.errors import BadInput, Cancelled

if TYPE_CHECKING:  # NumPy is not needed to read a command line
    from scenes.scene import Scene

COMMON = ("body", "stage", "material")  # options of every play: the user's bodies and room (scenes/roles.py)
GAME = ("reset", "update", "score", "message")  # what is called of each game in any play
YES_NO = {True: "yes", False: "no"}


@dataclass(frozen=True)
class SceneOption:
    """A parameter of `build` that the command line can set.

    choices  the texts that are allowed; (): any;   meaning  description of a text
    """

    name: str
    kind: type
    choices: tuple[str, ...]
    default: Any
    meaning: str = "a text"

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def choice_text(self) -> str:
        """Choices and default of the option, for the help."""
        kinds = {str: self.meaning, int: "an integer", float: "a number"}
        what = one_of(self.choices) if self.choices else kinds[self.kind]
        default = YES_NO[self.default] if self.kind is bool else self.default
        return what if default is None else f"{what} (default {default})"

    def value(self, given: Any, scene: str) -> Any:
        """The argument of `build` for a text from the command line, or for a value of its type. Raises BadInput."""
        if self.kind is bool:
            given = YES_NO.get(given, given)
        if self.choices:
            if given not in self.choices:
                raise BadInput(f"{self.flag} of the scene {scene} is {one_of(self.choices)}, not {str(given)[:60]!r}")
            return given == "yes" if self.kind is bool else given
        try:
            return self.kind(given)
        except (TypeError, ValueError) as e:
            raise BadInput(f"{self.flag} of the scene {scene} is a number, not {str(given)[:60]!r}") from e


@dataclass(frozen=True)
class Demo:
    """A scene: its name, the first line of its docstring, `build` and its options; or its `fault`."""

    name: str
    summary: str = ""
    build: Callable[..., Scene] | None = None
    fault: str = ""
    options: list[SceneOption] = field(default_factory=list)


def demo(name: str) -> Demo | None:
    """The demo in a module of this package, in a file or a room; None if it has no function `build`."""
    if is_room(name):
        from scenes.captured_room import room_scene

        return Demo(name, f"{label(name)}: a captured room", partial(room_scene, name))
    try:
        module = module_of_file(Path(name)) if is_scene_file(name) else importlib.import_module(f"scenes.{name}")
    except BadInput as e:
        return Demo(name, fault=str(e).removeprefix(f"{name}: "))
    except Exception as e:  # a user's file may fail in any way; the other demos can be played all the same
        return Demo(name, fault=fault_of(e, name))
    build = vars(module).get("build")
    if not callable(build):
        return None
    try:
        hints = get_type_hints(build, include_extras=True)
        parameters = inspect.signature(build).parameters.values()
        options = [option_of(p.name, hints.get(p.name, str), p.default) for p in parameters if p.name not in COMMON]
    except Exception as e:  # type hints are evaluated
        return Demo(name, fault=" ".join(f"{e}".split()))
    return Demo(name, (module.__doc__ or "(no description)").strip().splitlines()[0], build, options=options)


def is_scene_file(name: str) -> bool:
    """True for the path of a scene file, False for the name of a demo of this package."""
    return name.endswith(".py")


def is_room(name: str) -> bool:
    """True for the path of a captured room. The name of a demo never is, even if a folder has that name."""
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
    """The name of a scene for titles and files: the stem of a scene file, the name of a room's folder."""
    return Path(name).stem if is_scene_file(name) else Path(name).absolute().name if is_room(name) else name


def module_of_file(path: Path):
    """Run a scene file, which may import its neighbours, and return its module."""
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
    """An error of a scene file in one line, with the number of the line that raised it."""
    text = " ".join(f"{type(error).__name__}: {getattr(error, 'msg', None) or error}".split())
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
    for frame in traceback.extract_tb(error.__traceback__):
        if is_scene_file(name) and Path(frame.filename) == Path(name):
            line = frame.lineno
    return text if line is None else f"line {line}: {text}"


def built(found: Demo, values: dict) -> Scene:
    """The scene that `build` returns. Raises BadInput, also for an error in a scene file."""
    from scenes.scene import Scene

    with faults_told(found.name):
        scene = found.build(**values)
        game = getattr(scene, "game", None)
        missing = [name for name in GAME if game is not None and not hasattr(game, name)]
    if not isinstance(scene, Scene):
        raise BadInput(f"{found.name}: build returns no Scene but {type(scene).__name__}")
    if missing:
        raise BadInput(f"{found.name}: the game {type(game).__name__} has no {missing[0]}")
    return scene


@contextmanager
def faults_told(name: str) -> Iterator[None]:
    """Raise BadInput, with the line, for an error in the scene file of this name; errors of the program stay what they
    are."""
    try:
        yield
    except (BadInput, Cancelled):
        raise
    except Exception as e:
        frames = traceback.extract_tb(e.__traceback__)
        if not is_scene_file(name) or all(Path(frame.filename) != Path(name) for frame in frames):
            raise
        raise BadInput(f"{name}: {fault_of(e, name)}") from e


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
    """Build the scene, with the user's bodies and room in their roles. Options that are None keep their defaults.

    body, stage  assets
    material     a name: of the bodies
    resize       let bodies become as large as their roles ask for; otherwise all keep their sizes
    options      of the scene, texts or values

    Raises BadInput, also for an option that the scene does not have.
    """
    is_ours = name in module_names()
    found = demo(name) if is_ours or is_scene_file(name) or is_room(name) else None
    if found is None:
        if is_ours or is_scene_file(name):
            raise BadInput(f"{name}: it has no function build (docs/writing_a_scene.md)")
        if os.path.isdir(name):
            raise BadInput(f"{name}: holds no {MANIFEST}; a captured room is made by: vrgs.py capture")
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(names())}")
    if found.build is None:
        raise BadInput(f"{name}: {found.fault}")
    taken = inspect.signature(found.build).parameters
    known = {option.name: option for option in found.options}
    values = {}
    for key, given in options.items():
        if given is not None:
            if key not in known:
                instead = "; a room to play in is its --stage" if key == "capture" else ""
                raise BadInput(f"the scene {name} takes no --{key.replace('_', '-')}{instead}")
            values[key] = known[key].value(given, name)
    assets, played = [body] if isinstance(body, str) else list(body or ()), []  # played: by what `build` does itself
    if assets and "body" in taken:
        one = isinstance(taken["body"].default, str)
        played = assets[:1] if one else assets
        values["body"] = assets[0] if one else tuple(assets)
    if material is not None and "material" in taken:
        values["material"] = material
    elif material is not None and not assets:
        raise BadInput(f"the scene {name} takes no --material without --body")
    scene = built(found, values)
    if not resize:
        scene = replace(scene, roles=tuple(replace(role, resize=False) for role in scene.roles))
    if not assets and stage is None:
        return scene
    from scenes.roles import cast_bodies, in_room

    if assets[len(played) :] and not scene.roles:
        raise BadInput(f"the scene {name} takes no --body")
    if stage is not None and scene.room is None:
        raise BadInput(f"the scene {name} takes no --stage")
    if assets:
        scene = cast_bodies(scene, played, assets[len(played) :], material)
    return scene if stage is None else in_room(scene, stage)


def one_of(names: tuple[str, ...]) -> str:
    """ "fox, bear or horse"."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def option_of(name: str, hint: Any, default: Any) -> SceneOption:
    """The option for a parameter of this type. Raises BadInput."""
    if default is inspect.Parameter.empty:
        raise BadInput(f"the parameter {name} of build has no default")
    meaning = SceneOption.meaning
    if get_origin(hint) is Annotated:
        hint, meaning, *_ = get_args(hint)
    if get_origin(hint) in (Union, types.UnionType):
        hint = next((kind for kind in get_args(hint) if kind is not type(None)), str)
    if get_origin(hint) is Literal:
        return SceneOption(name, str, get_args(hint), default)
    if hint not in (str, int, float, bool):
        raise BadInput(f"the parameter {name} of build is neither a text, a number, a bool nor a Literal of texts")
    return SceneOption(name, hint, tuple(YES_NO.values()) if hint is bool else (), default, meaning)
