"""The place and name of a file that the user asked for by a key: never one that is there."""

from __future__ import annotations

import re
from collections.abc import Container
from datetime import datetime
from pathlib import Path

from assets.file_access import check_writable, unused_name
from core.errors import BadInput


def output_path(scene: str, ending: str, taken: Container[Path] = (), *, now: datetime | None = None) -> Path:
    """A new name of scene and time in the current folder, or, if it cannot be written, in that of pictures.

    `ending` is what follows them: ".png", "_camera.json". It is none of those `taken` for files that are still to come.
    Raises BadInput if neither folder can be written.
    """
    stem = re.sub(r"[^\w.-]+", "_", Path(scene).stem) or "scene"
    name = f"{stem}_{(now or datetime.now()).strftime('%Y-%m-%d_%H-%M-%S')}{ending}"
    error: BadInput | None = None
    for folder in (Path.cwd(), pictures_folder()):
        path = unused_name(folder / name, taken)
        try:
            check_writable(path)
            return path
        except BadInput as e:
            error = error or e
    raise error


def pictures_folder() -> Path:
    """The user's folder of pictures; the home folder if there is none."""
    home = Path.home()
    return home / "Pictures" if (home / "Pictures").is_dir() else home
