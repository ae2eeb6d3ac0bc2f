"""Reading and writing Gaussians of any file format: the suffix names it, and the content must agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from assets.asset import Asset
from assets.file_access import open_input
from assets.file_kind import MESHES, is_mesh
from assets.formats.antimatter_splat import read_splat, write_splat
from assets.formats.compressed_ply import write_compressed
from assets.formats.ksplat import read_ksplat
from assets.formats.ply import read_ply, write_ply
from assets.formats.sog import read_sog
from assets.formats.spz import read_spz, write_spz
from assets.gaussians import Gaussians, Report
from core.errors import BadInput


def _read_asset(path: Path, report: Report) -> Gaussians:
    return Asset.load(path).gaussians


READERS = {
    ".ply": read_ply,
    ".splat": read_splat,
    ".ksplat": read_ksplat,
    ".spz": read_spz,
    ".sog": read_sog,
    ".json": read_sog,
    ".h5": _read_asset,
}
COMPRESSED = ".compressed.ply"  # both suffixes, as PlayCanvas's tools name it; recognised by content on reading
WRITERS = {".ply": write_ply, COMPRESSED: write_compressed, ".spz": write_spz, ".splat": write_splat}
KEEP_OBJECTS = (".ply", ".h5")
KEEP_SORT = (".ply", COMPRESSED, ".spz", ".h5")
MAGICS = {
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"\x1f\x8b": ".spz",  # gzip
    b"NGSP": ".spz",
    b"\x89HDF\r\n\x1a\n": ".h5",
    b"PK\x03\x04": ".sog",  # ZIP
}


def read_gaussians(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply (plain or compressed), .splat, .ksplat, .spz, .sog or of an asset (.h5), or on a mesh.

    A SOG that is not zipped is read by its meta.json. `report` takes one line if some were dropped. Splats that do not
    say which order of blending they were trained for are from elsewhere, and there it is z; assets and meshes are not.
    Raises BadInput.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS and suffix not in MESHES:
        raise BadInput(f"{path}: unknown kind of file {suffix!r}; read are {', '.join((*READERS, *MESHES))}")
    if is_mesh(path):
        from assets.mesh_gaussians import read_mesh_gaussians

        return read_mesh_gaussians(path, report)
    with open_input(path) as file:
        head = file.read(8)
    found = next((kind for magic, kind in MAGICS.items() if head.startswith(magic)), suffix)
    if found != suffix:
        raise BadInput(f"{path}: is named {suffix} but its content is {found}")
    gaussians = READERS[suffix](path, report)
    return gaussians if gaussians.sort or suffix == ".h5" else replace(gaussians, sort="z")


def kind_to_write(path: str | Path) -> str:
    """Key in WRITERS for a file name. Raises BadInput."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise BadInput(f"{path}: cannot write {suffix!r}; written are {', '.join(WRITERS)}")
    return COMPRESSED if path.name.lower().endswith(COMPRESSED) else suffix


def write_gaussians(path: str | Path, g: Gaussians, report: Report = print) -> None:
    """Write a .ply, .compressed.ply, .spz or .splat, in one step: either the whole file or none. Raises BadInput.

    `report` takes a line if the format keeps no objects and there are some, or not the order of blending.
    """
    kind = kind_to_write(path)
    WRITERS[kind](path, g)
    if kind not in KEEP_OBJECTS and g.object_id.any():
        report(f"{path}: {kind} keeps no object ids; {' and '.join(KEEP_OBJECTS)} do")
    if kind not in KEEP_SORT and g.sort not in ("", "z"):
        report(f"{path}: trained for the order {g.sort}, which {kind} does not keep (--sort {g.sort} plays it so)")
