"""Options of a scene: the parameters of its `build`, as the command line gives them.

`def build(animal: Literal["fox", "bear"] = "fox")` makes `--animal fox|bear`. A parameter is a text, a number, a bool
or one of several texts (`Literal`), or any of these or None; `Annotated[str, "a colour"]` tells the help what a text
means. What all scenes are offered (COMMON) is no option of one.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from core.errors import BadInput

COMMON = ("body", "stage", "material")  # options of every play: the user's bodies and room, see scenes/roles.py
TRUTH = {"yes": True, "no": False}


@dataclass(frozen=True)
class SceneOption:
    """A parameter of `build` that the command line can set.

    choices  all the texts that it may be, if not any;   meaning  what a text is, in words
    """

    name: str
    kind: type
    choices: tuple[str, ...]
    default: Any
    meaning: str = "a text"

    @property
    def flag(self) -> str:
        """As it is written on the command line."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def choice_text(self) -> str:
        """Choices and default of the option, in words."""
        kinds = {str: self.meaning, int: "an integer", float: "a number"}
        what = one_of(self.choices) if self.choices else kinds[self.kind]
        default = {True: "yes", False: "no"}[self.default] if self.kind is bool else self.default
        return what if default is None else f"{what} (default {default})"

    def value(self, given: Any, scene: str) -> Any:
        """The value that `build` gets for a text of the command line or a value of that type. Raises BadInput."""
        if self.kind is bool:
            given = {True: "yes", False: "no"}.get(given, given)
        if self.choices:
            if given not in self.choices:
                raise BadInput(f"{self.flag} of the scene {scene} is {one_of(self.choices)}, not {str(given)[:60]!r}")
            return TRUTH[given] if self.kind is bool else given
        try:
            return self.kind(given)
        except (TypeError, ValueError) as e:
            raise BadInput(f"{self.flag} of the scene {scene} is a number, not {str(given)[:60]!r}") from e


def one_of(names: tuple[str, ...]) -> str:
    """ "fox, bear or horse"."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def options_of(build: Callable) -> list[SceneOption]:
    """The options of a scene besides the common ones. Raises BadInput for a parameter that cannot be one."""
    hints = get_type_hints(build, include_extras=True)
    own = [p for p in inspect.signature(build).parameters.values() if p.name not in COMMON]
    return [option_of(p.name, hints.get(p.name, str), p.default) for p in own]


def option_of(name: str, hint: Any, default: Any) -> SceneOption:
    """The option of a parameter with this type. Raises BadInput."""
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
    return SceneOption(name, hint, tuple(TRUTH) if hint is bool else (), default, meaning)
