"""Location of assets: shipped ones by name, the user's by path, prepared splats in a cache.

HDF5 is imported in the functions, since the command line lists the shipped assets before anything is read.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from functools import cache
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING

from assets.file_access import make_folder
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL, DEFAULT_MATERIAL, Material
from core.program import cache_folder

if TYPE_CHECKING:
    import numpy as np

SHIPPED_FOLDER = Path(__file__).resolve().parent / "data"
_searched = [SHIPPED_FOLDER]  # folders of named assets, in turn
_sources: dict[str, str] = {}  # the user's file, by the path in the cache of what is made of it


def is_asset(name: str) -> bool:
    """True if a body or room is an asset already: a shipped one, or an .h5 file."""
    return isfile(SHIPPED_FOLDER / f"{name}.h5") or Path(name).suffix.lower() == ".h5"


def find_asset(name: str) -> Path:
    """Path of an asset named as in a scene: a shipped one ("ring") or a file. Raises BadInput."""
    for folder in _searched:
        if isfile(folder / f"{name}.h5"):  # False for a name too long, too
            return folder / f"{name}.h5"
    if isfile(name):
        return Path(name)
    known = ", ".join(sorted(p.stem for p in SHIPPED_FOLDER.glob("*.h5"))) or "none (run: python -m studio)"
    raise BadInput(f"{name}: no such asset; shipped ones: {known}")


def search_first(folder: Path | None) -> None:
    """From now on find named assets in `folder` before the shipped ones; None: in these alone."""
    _searched[:] = [SHIPPED_FOLDER] if folder is None else [folder, SHIPPED_FOLDER]


def paper_folder(demo: str) -> Path:
    """Folder of the assets that `python -m studio --detail paper` makes for a demo of scenes/paper_demos.py."""
    return cache_folder() / "paper" / demo


def asset_material(name: str) -> Material | None:
    """The material that an asset file names, checked; None if it names none. Raises BadInput."""
    from assets.asset import read_material
    from assets.hdf5 import open_hdf5

    path = find_asset(name)
    with open_hdf5(path) as file:
        material = read_material(file)
    if material is not None:
        material.check(str(path))
    return material


def default_material(name: str) -> Material:
    """The asset's own material; of one without, flesh if it is animated, else plush. Raises BadInput."""
    usual = DEFAULT_MATERIAL if animated_height(name) is None else ANIMATED_MATERIAL
    return asset_material(name) or Material.named(usual)


def animated_height(name: str) -> float | None:
    """Height [m] of an asset with an animation of its own, None if it has none. Raises BadInput."""
    from assets.hdf5 import open_hdf5

    with open_hdf5(find_asset(name)) as file:
        animated = file.has("animation")
    y = cage_vertices(name)[:, 1] if animated else ()
    return float(y.max() - y.min()) if len(y) else None


def cage_vertices(name: str) -> np.ndarray:
    """Vertices of an asset's cage [m], (V, 3); they need not be finite. Raises BadInput if it has none."""
    from assets.hdf5 import open_hdf5

    with open_hdf5(find_asset(name)) as file:
        if not file.has("cage"):
            raise BadInput(f"{name}: has no cage to simulate (make one: python vrgs.py prepare)")
        return file.array("cage/vertices", "f", (None, 3))


def cached_asset(source: Path, options: dict) -> Path:
    """Path of the asset prepared from `source` with `options`, whether or not it exists yet.

    The name holds a hash of the file's bytes and the options: an edited file is prepared again.
    """
    digest = hashlib.sha256(repr(sorted(options.items())).encode())
    with open(source, "rb") as f:
        while block := f.read(1 << 20):
            digest.update(block)
    name = f"{source.stem}-{digest.hexdigest()[:16]}.h5"
    kept = cache_folder() / name
    kept = kept if os.path.isfile(kept) else writable_cache(cache_folder()) / name  # Path.is_file may raise
    _sources[str(kept)] = str(source)
    return kept


def with_sources(text: str) -> str:
    """A message with the files that the user gave in place of the assets in the cache that were made of them."""
    for kept, source in _sources.items():
        text = text.replace(kept, source)
    return text


@cache
def writable_cache(folder: Path) -> Path:
    """The cache folder, made if need be; where it cannot be, a line says so, and it is one for this run alone."""
    try:
        make_folder(folder)
        return folder
    except BadInput as e:
        print(f"vrgs: {e}: nothing is kept for the next time", file=sys.stderr, flush=True)
    temporary = tempfile.mkdtemp(prefix="vrgs-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    os.environ["VRGS_CACHE"] = temporary  # also of the programs that this one starts
    return Path(temporary)
