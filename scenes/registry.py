"""The demos by name: every module of this package with a function `build` is one."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import scenes
from core.errors import BadInput
from scenes.scene_options import SceneOption, options_of

if TYPE_CHECKING:
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
    """The demo in a module of this package; None for one that neither has `build` nor uses Scene: others share it."""
    try:
        module = importlib.import_module(f"scenes.{name}")
    except Exception as e:  # a user's file may fail in any way; the other demos can be played all the same
        return Demo(name, fault=" ".join(f"{type(e).__name__}: {e}".split()))
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


def demos() -> list[Demo]:
    """All demos and faulty scene files, sorted by name."""
    found = (demo(name) for name in sorted(m.name for m in pkgutil.iter_modules(scenes.__path__)))
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
    found = demo(name) if name in {m.name for m in pkgutil.iter_modules(scenes.__path__)} else None
    if found is None:
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(names())}")
    if found.build is None:
        raise BadInput(f"the scene {name} cannot be played: {found.fault}")
    taken = inspect.signature(found.build).parameters
    known = {option.name: option for option in found.options}
    values = {}
    for key, given in options.items():
        if given is not None:
            if key not in known:
                raise BadInput(f"the scene {name} takes no --{key.replace('_', '-')}")
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
    scene = found.build(**values)
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
