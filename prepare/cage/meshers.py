"""Which mesher makes the cage, and what happens where it cannot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from assets.asset import Cage
from core.errors import BadInput
from prepare.cage.cage import cage_of

MESHERS = ("stuffing", "tetgen")


def check_mesher(mesher: str) -> None:
    """Raise BadInput unless that mesher is known and installed."""
    if mesher not in MESHERS:
        raise BadInput(f"{mesher!r} is no mesher; known: {', '.join(MESHERS)}")
    if mesher == "tetgen":
        from prepare.cage.tetgen_mesher import check_installed

        check_installed()


def mesh(
    mesher: str,
    phi: np.ndarray,
    points: np.ndarray,
    vertices: int,
    report: Callable[[float], None],
    *,
    adaptive: bool = True,
    exact: bool | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[Cage, str]:
    """The cage, as `cage_of` makes it, and the mesher that made it: stuffing where TetGen fails, which `say` tells.

    Raises BadInput.
    """
    if mesher == "tetgen":
        from prepare.cage.tetgen_mesher import NoMesh, tetgen_cage

        try:
            return tetgen_cage(phi, points, vertices, report, exact), "tetgen"
        except NoMesh as e:
            if say:
                say(f"TetGen: {e}; the cage is made by stuffing instead")
    return cage_of(phi, points, vertices, report, adaptive=adaptive, exact=exact), "stuffing"
