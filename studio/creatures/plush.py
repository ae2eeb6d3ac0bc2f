"""What plush toys have in common: short fleece, soft filling, button eyes, embroidered mouths."""

from __future__ import annotations

from core.material import Material
from studio.creatures.creature import Creature, Part, pair
from studio.creatures.implicit import ellipsoid, limb

BLACK, THREAD, CREAM, ROSE = "14100e", "4a2f2a", "f5ead6", "e79a9a"


def toy(parts: list[Part], low, high, hair: float = 0.005, **options) -> Creature:
    """A toy of these parts in fleece of that depth [m]."""
    usual = {"lift": 0.55, "curl": 0.4, "border": 0.002, "mottle": 0.06, "from_below": 0.68}
    return Creature(parts, low, high, Material.named("plush"), hair, **(usual | options))


def buttons(x: float, y: float, z: float, radius: float) -> list[Part]:
    """Two black button eyes."""
    return pair(Part(ellipsoid((x, y, z), radius), BLACK, 0.0, glint=True))


def thread(path, colour: str = THREAD, radius: float = 0.0016) -> Part:
    """An embroidered line."""
    return Part(limb(path, [radius] * len(path)), colour, 0.0)


def smile(y: float, z: float, width: float, depth: float, curve: float = 0.004) -> Part:
    """A smile of this width [m], its corners `depth` higher than its middle and `curve` farther back."""
    x = 0.5 * width
    corner, bend = (y + depth, z - curve), (y + 0.25 * depth, z - 0.3 * curve)
    return thread([(-x, *corner), (-0.55 * x, *bend), (0, y, z), (0.55 * x, *bend), (x, *corner)])
