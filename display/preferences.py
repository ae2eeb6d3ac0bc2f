"""Settings that last from one start of the program to the next, in a JSON file of the configuration folder.

One object whose keys name what is remembered:

| key | value |
| --- | --- |
| window.size, window.place | [width, height], [left, top] in screen coordinates |
| window.maximized | true or false |
| panel.open | true or false |
| panel.sections | {title: true or false}: whether its content is on view |
| light.SCENE | fields of a Light, where it is not the scene's own |
| bookmarks.SCENE | {"1": [[eye x, y, z], [target x, y, z]], ...} [m] |
| sound | true or false |
| folder | the folder in which a file was opened or saved last |

Several programs may run at once: each writes only the keys that it has changed, over what the file holds by then.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, TypeVar

from assets.file_access import atomic_write, locked, unused_name
from core.errors import BadInput
from core.typed import Size, from_plain, to_plain
from core.vocabulary import Vec3

SIZE_MAX = 1 << 20  # [bytes]; more was not written by this program
LOCK_PATIENCE = 0.5  # [s] of a frame at most, for which another program is waited for
PathText = Annotated[str, Size(4096)]
Bookmarks = dict[str, tuple[Vec3, Vec3]]  # eye and target [m], by the digit of their key
T = TypeVar("T")


def config_folder() -> Path:
    """Folder of the user's settings, by the platform's custom. `VRGS_CONFIG` overrides it."""
    override = os.environ.get("VRGS_CONFIG")
    if override:
        return Path(override)
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA", str(Path.home()))) / "vrgs"
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "vrgs"


class Preferences:
    """The remembered values. `set` writes them at once; a path of None remembers only while the program runs.

    A file that cannot be read or written is reported once, on stderr, and then left alone; a damaged one is set aside
    under another name.
    """

    def __init__(self, path: Path | None = None):
        self.path = path
        self._own: dict = {}  # what this program has changed
        self._values = {} if path is None else self._read()

    @classmethod
    def of_user(cls) -> Preferences:
        """The preferences of the user who runs the program."""
        return cls(config_folder() / "preferences.json")

    def get(self, key: str, kind: type[T], default: T | None = None) -> T | None:
        """The value of a key as this type (core/typed.py); `default` if there is none, or one of another type."""
        value = self._values.get(key)
        try:
            return default if value is None else from_plain(kind, value, key)
        except BadInput:
            return default

    def set(self, key: str, value) -> None:
        """Remember a value; None: forget it."""
        value = to_plain(value)
        if self._values.get(key) == value:
            return
        self._values[key] = self._own[key] = value
        if self.path is not None:
            self._write()

    def _read(self) -> dict:
        """Content of the file; {} without one. A damaged one is set aside."""
        try:
            with open(self.path, "rb") as file:
                data = file.read(SIZE_MAX + 1)
        except (FileNotFoundError, NotADirectoryError):
            return {}
        except OSError as e:
            return self._give_up(f"{self.path}: cannot be read ({e.strerror})")
        try:
            values = json.loads(data) if len(data) <= SIZE_MAX else None
        except (ValueError, RecursionError):
            values = None
        if isinstance(values, dict):
            return values
        aside = unused_name(self.path.with_name(f"{self.path.stem}.broken{self.path.suffix}"))
        try:
            os.replace(self.path, aside)
        except OSError as e:
            return self._give_up(f"{self.path}: is damaged and cannot be moved ({e.strerror})")
        tell(f"{self.path} was damaged and is now {aside.name}; settings start afresh")
        return {}

    def _write(self) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with locked(self.path, patience=LOCK_PATIENCE):
                there = self._read()
                if self.path is None:
                    return
                values = {k: v for k, v in {**there, **self._own}.items() if v is not None}
                with atomic_write(self.path) as beside:
                    beside.write_text(json.dumps(values, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        except OSError as e:
            self._give_up(f"{self.path}: cannot be written ({e.strerror})")
        except BadInput as e:
            self._give_up(str(e))

    def _give_up(self, reason: str) -> dict:
        """Neither read nor write the file again; tell the reason. There are no values then."""
        tell(f"settings are not kept: {reason}")
        self.path = None
        return {}


def tell(text: str) -> None:
    """Print a line for the user."""
    print(f"vrgs: {text}", file=sys.stderr, flush=True)
