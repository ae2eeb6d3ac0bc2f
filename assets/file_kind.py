"""Kinds of files in a play: told from its name and its first bytes, before any of it is loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from assets.file_access import file_size, open_input
from core.errors import BadInput

FileKind = Literal["body", "room", "either", "state"]

SPLATS = (".ply", ".splat", ".ksplat", ".spz", ".sog", ".json")
MESHES = (".obj", ".glb", ".gltf", ".stl", ".off")
HEADER_MAX = 4096  # [bytes] of a .ply in which its elements are listed


def kind_of(path: str | Path) -> FileKind:
    """Kinds of a file: a mesh a body, a splat a body or a room, an .h5 these or a state. Raises BadInput."""
    path = Path(path)
    file_size(path)
    suffix = path.suffix.lower()
    if suffix == ".h5":
        return kind_of_asset(path)
    if is_mesh(path):
        return "body"
    if suffix in SPLATS:
        return "either"
    raise BadInput(f"{path.name}: is none of {', '.join((*SPLATS, *MESHES, '.h5'))}")


def kind_of_asset(path: Path) -> FileKind:
    """The kind of an .h5 file. Raises BadInput, which says what else can be done with it."""
    from assets.hdf5 import open_hdf5

    with open_hdf5(path) as file:
        kind = file.text("", "format")
        if kind == "vrgs-recording":
            raise BadInput(f"{path.name}: is a recording: vrgs.py --replay {path.name} plays it")
        if kind == "vrgs-state":
            return "state"
        if kind == "vrgs-study":
            raise BadInput(f"{path.name}: is the file of a study: vrgs.py study {path.name} compares its trials")
        if kind != "vrgs-asset":
            raise BadInput(f"{path.name}: is no asset of VR-GS")
        return "body" if file.has("cage") else "room"


def is_mesh(path: str | Path) -> bool:
    """True for a file of triangles: by its name, or a .ply that has faces."""
    path = Path(path)
    if path.suffix.lower() in MESHES:
        return True
    if path.suffix.lower() != ".ply":
        return False
    with open_input(path) as file:
        header = file.read(HEADER_MAX).split(b"end_header")[0]
    return header.startswith(b"ply") and b"element face " in header and b"element face 0" not in header
