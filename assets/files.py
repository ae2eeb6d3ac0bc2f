"""Gaussians from and to files of any kind: the kind is the file's suffix, and its content must agree."""

from __future__ import annotations

from pathlib import Path

from assets.asset import Asset
from assets.border import Report, reading
from assets.errors import BadInput
from assets.gaussians import Gaussians
from assets.ply import read_ply, write_ply
from assets.splat import read_splat
from assets.spz import read_spz, write_spz


def _read_asset(path: Path, report: Report) -> Gaussians:
    return Asset.load(path).gaussians


READERS = {".ply": read_ply, ".splat": read_splat, ".spz": read_spz, ".h5": _read_asset}
WRITERS = {".ply": write_ply, ".spz": write_spz}
MAGICS = {
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"\x1f\x8b": ".spz",  # gzip
    b"NGSP": ".spz",
    b"\x89HDF\r\n\x1a\n": ".h5",
    b"PK\x03\x04": ".zip (.sog?)",
}


def read_gaussians(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply, .splat, .spz or of an asset (.h5). `report` takes one line if some were dropped.

    Raises BadInput.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise BadInput(f"{path}: unknown kind of file {suffix!r}; read are {', '.join(READERS)}")
    with reading(path) as file:
        head = file.read(8)
    found = next((kind for magic, kind in MAGICS.items() if head.startswith(magic)), suffix)
    if found != suffix:
        raise BadInput(f"{path}: is named {suffix} but its content is {found}")
    return READERS[suffix](path, report)


def write_gaussians(path: str | Path, g: Gaussians) -> None:
    """Write a .ply or .spz, in one step: either the whole file or none. Raises BadInput."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise BadInput(f"{path}: cannot write {suffix!r}; written are {', '.join(WRITERS)}")
    WRITERS[suffix](path, g)
