"""The demos by name: each module of this package with a `build` function is one."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import scenes
from core.errors import BadInput
from scenes.scene import Scene

_NOT_SCENES = {"registry", "scene", "scripted_throw"}


def names() -> list[str]:
    """Names of all scenes, sorted."""
    return sorted(m.name for m in pkgutil.iter_modules(scenes.__path__) if m.name not in _NOT_SCENES)


def summary(name: str) -> str:
    """First line of the scene's docstring."""
    return (importlib.import_module(f"scenes.{name}").__doc__ or "").strip().splitlines()[0]


def load(name: str, **options) -> Scene:
    """Build the scene. Options that it does not take are refused. Raises BadInput."""
    if name not in names():
        raise BadInput(f"no scene named {name!r}; there are: {', '.join(names())}")
    build = importlib.import_module(f"scenes.{name}").build
    options = {key: value for key, value in options.items() if value is not None}
    unknown = set(options) - set(inspect.signature(build).parameters)
    if unknown:
        raise BadInput(f"the scene {name} takes no --{sorted(unknown)[0]}")
    return build(**options)
