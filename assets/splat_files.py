"""Files of Gaussians of any format: their kind, told before they are loaded, reading, and writing.

The suffix names the format, and the content must agree.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from assets.asset import Asset
from assets.file_access import file_size, open_input
from assets.formats.gaussian_glb import has_splats, read_glb, write_glb
from assets.formats.ply import read_ply, write_compressed, write_ply
from assets.formats.sog import read_sog, write_sog
from assets.formats.splat import read_ksplat, read_splat, write_splat
from assets.formats.spz import read_spz, write_spz
from assets.gaussians import Gaussians, Report
from assets.hdf5 import open_hdf5
from core.errors import BadInput

FileKind = Literal["body", "room", "either", "state"]

SPLATS = (".ply", ".splat", ".ksplat", ".spz", ".sog", ".json")  # and .glb, if it holds Gaussians
MESHES = (".obj", ".glb", ".gltf", ".stl", ".off")
HEADER_MAX = 4096  # [bytes] of a .ply in which its elements are listed


def kind_of(path: str | Path) -> FileKind:
    """Kind of a file: a mesh is a body, a splat a body or a room, an .h5 one of these or a state.

    Raises BadInput, which says what else can be done with an .h5 file.
    """
    path = Path(path)
    file_size(path)
    if path.suffix.lower() != ".h5":
        if is_mesh(path):
            return "body"
        if path.suffix.lower() in (*SPLATS, ".glb"):
            return "either"
        raise BadInput(f"{path.name}: is not one of {', '.join((*SPLATS, *MESHES, '.h5'))}")
    with open_hdf5(path) as file:
        match file.text("", "format"):
            case "vrgs-asset":
                return "body" if file.has("cage") else "room"
            case "vrgs-state":
                return "state"
            case "vrgs-recording":
                raise BadInput(f"{path.name}: is a recording: vrgs.py --replay {path.name} plays it")
            case "vrgs-study":
                raise BadInput(f"{path.name}: is the file of a study: vrgs.py study {path.name} compares its trials")
            case _:
                raise BadInput(f"{path.name}: is not an asset of VR-GS")


def is_mesh(path: str | Path) -> bool:
    """True for a file of triangles: by its name, a .ply that has faces, a .glb without Gaussians."""
    path = Path(path)
    if path.suffix.lower() == ".glb":
        return not has_splats(path)
    if path.suffix.lower() in MESHES:
        return True
    if path.suffix.lower() != ".ply":
        return False
    with open_input(path) as file:
        header = file.read(HEADER_MAX).split(b"end_header")[0]
    return header.startswith(b"ply") and b"element face " in header and b"element face 0" not in header


READERS = {
    ".ply": read_ply,
    ".splat": read_splat,
    ".ksplat": read_ksplat,
    ".spz": read_spz,
    ".sog": read_sog,
    ".json": read_sog,
    ".glb": read_glb,
    ".h5": lambda path, report: Asset.load(path).gaussians,
}
COMPRESSED = ".compressed.ply"  # both suffixes, as PlayCanvas's tools name it; recognised by content on reading
WRITERS = {
    ".ply": write_ply,
    COMPRESSED: write_compressed,
    ".spz": write_spz,
    ".splat": write_splat,
    ".sog": write_sog,
    ".glb": write_glb,
}
KEEP_OBJECTS = (".ply", ".glb", ".h5")
KEEP_TRAINED = (".ply", COMPRESSED, ".spz", ".sog", ".glb", ".h5")
MAGICS = {
    b"ply\n": ".ply",
    b"ply\r": ".ply",
    b"\x1f\x8b": ".spz",  # gzip
    b"NGSP": ".spz",
    b"\x89HDF\r\n\x1a\n": ".h5",
    b"PK\x03\x04": ".sog",  # ZIP
    b"glTF": ".glb",
}


def check_kind(path: Path) -> None:
    """Raise BadInput unless a file's name ends as one that is read."""
    suffix = path.suffix.lower()
    if suffix not in READERS and suffix not in MESHES:
        raise BadInput(
            f"{path}: unknown kind of file {suffix!r}; read are {', '.join(dict.fromkeys((*READERS, *MESHES)))}"
        )


def read_gaussians(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .ply (plain or compressed), .splat, .ksplat, .spz, .sog, .glb or of an asset (.h5), or on a mesh.

    A SOG that is not zipped is read by its meta.json. `report` takes one line if some were dropped. Splats that do not
    say which order of blending they were trained for are from elsewhere, and there it is z; assets and meshes are not.
    Raises BadInput.
    """
    path = Path(path)
    check_kind(path)
    suffix = path.suffix.lower()
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


def write_gaussians(path: str | Path, g: Gaussians, report: Report = print, **options) -> None:
    """Write a .ply, .compressed.ply, .spz, .splat, .sog or .glb, in one step: the whole file or none. Raises BadInput.

    options  of the format's own function.
    `report` takes a line if the format keeps no objects and there are some, or not how they were trained.
    """
    kind = kind_to_write(path)
    WRITERS[kind](path, g, **options)
    if kind not in KEEP_OBJECTS and g.object_id.any():
        report(f"{path}: {kind} keeps no object ids; {' and '.join(KEEP_OBJECTS)} do")
    if kind not in KEEP_TRAINED and g.antialias:
        report(f"{path}: trained for anti-aliased drawing, which {kind} does not keep (render --antialias draws it so)")
    if kind not in KEEP_TRAINED and g.sort not in ("", "z"):
        report(f"{path}: trained for the order {g.sort}, which {kind} does not keep (--sort {g.sort} plays it so)")
