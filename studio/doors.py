"""Panelled doors: leaves with recessed panels, and the casing around them."""

from __future__ import annotations

from collections.abc import Sequence

from studio.shapes import Mesh, box
from studio.walls import reveal, wall_sheet

Rectangle = tuple[float, float, float, float]  # x from, to, y from, to [m]


def panelled_leaf(outline: Rectangle, panels: Sequence[Rectangle], face: float, recess: float) -> list[Mesh]:
    """A leaf in the plane z = `face` [m] that looks towards -z, with panels set back by `recess` [m].

    There is nothing behind its faces, so that no Gaussians of a hidden surface show between those of the front.
    """
    x0, x1, y0, y1 = outline
    meshes = [wall_sheet((x1, x0), (y0, y1), panels, lambda u, v: (u, v, face))]
    for a, b, c, d in panels:
        meshes.append(wall_sheet((b, a), (c, d), [], lambda u, v: (u, v, face + recess)))
        meshes.append(reveal((a, c), (b, d), recess, lambda u, v, w: (u, v, face + w), flip=True))
    return meshes


def casing(outline: Rectangle, width: float, low_z: float, high_z: float) -> list[Mesh]:
    """The boards at both sides of an opening and above it, from `low_z` to the wall at `high_z` [m]."""
    x0, x1, y0, y1 = outline
    return [
        box((x0 - width, y0, low_z), (x0, y1 + width, high_z)),
        box((x1, y0, low_z), (x1 + width, y1 + width, high_z)),
        box((x0, y1, low_z), (x1, y1 + width, high_z)),
    ]
