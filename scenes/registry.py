"""The demos by name: every module of this package with a function `build` is one."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import scenes
from core.errors import BadInput

if TYPE_CHECKING:
    from scenes.scene import Scene


@dataclass(frozen=True)
class Demo:
    """A scene file: its name, the first line of its docstring, and its `build`; or the `fault` that it has."""

    name: str
    summary: str = ""
    build: Callable[..., Scene] | None = None
    fault: str = ""


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
    return Demo(name, (module.__doc__ or "(no description)").strip().splitlines()[0], build)


def demos() -> list[Demo]:
    """All demos and faulty scene files, sorted by name."""
    found = (demo(name) for name in sorted(m.name for m in pkgutil.iter_modules(scenes.__path__)))
    return [d for d in found if d is not None]


def names() -> list[str]:
    """Names of the demos that can be played, sorted."""
    return [d.name for d in demos() if d.build is not None]


def load(name: str, **options) -> Scene:
    """Build the scene; options that are None count as not given. Raises BadInput, also for options it does not take."""
    found = demo(name) if name in {m.name for m in pkgutil.iter_modules(scenes.__path__)} else None
    if found is None:
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(names())}")
    if found.build is None:
        raise BadInput(f"the scene {name} cannot be played: {found.fault}")
    options = {key: value for key, value in options.items() if value is not None}
    unknown = set(options) - set(inspect.signature(found.build).parameters)
    if unknown:
        raise BadInput(f"the scene {name} takes no --{sorted(unknown)[0]}")
    return found.build(**options)
