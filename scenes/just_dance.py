"""Just dance: a puppet dances on the table, rings bounce off it; --body brings a dancer of yours (prepare --rig)."""

from __future__ import annotations

import numpy as np

from assets.library import animated_height
from core.errors import BadInput
from core.material import ANIMATED_MATERIAL, Material
from scenes.ring_toss import BOTTLE, PLASTER, TABLE_TOP, room
from scenes.sandbox import Sandbox, rings
from scenes.scene import Body, BodyState, Light, Scene

PLACE = (0.0, TABLE_TOP, 0.05)  # [m] on the table, before the bottle


class JustDance(Sandbox):
    """A ring that is thrown and meets the dancer scores; the scripted hand throws one again and again."""

    def reset(self) -> None:
        super().reset()
        self.hits, self.open = 0, False  # open: the ring flies, and has met nobody yet

    def update(self, time: float, bodies: list[BodyState]) -> None:
        super().update(time, bodies)
        dancer, ring = bodies[:2]
        if ring.held:
            self.open = True
        elif self.open and (ring.centroid > dancer.low).all() and (ring.centroid < dancer.high).all():
            self.open, self.hits = False, self.hits + 1

    @property
    def score(self) -> int:
        return self.hits

    @property
    def message(self) -> str:
        return f"{self.hits} hits. Throw the ring at the dancer." if self.hits else "Throw the ring at the dancer."

    def verify(self, bodies: list[BodyState]) -> None:
        """What must hold once the scripted hand has played: a ring has met the dancer and lies outside of it."""
        assert self.hits > 0, "no ring has met the dancer"
        assert np.isfinite(bodies[1].centroid).all() and bodies[0].low[1] > TABLE_TOP - 0.05


def build(body: str = "dancer", material: str = ANIMATED_MATERIAL) -> Scene:
    """`body` is an asset that moves by itself, `material` a name (see core/material.py). Raises BadInput."""
    height = animated_height(body)
    if height is None:
        raise BadInput(f"{body}: does not move by itself; make it (vrgs.py prepare PERSON.ply --rig RIG.glb)")
    far = float(np.clip(1.5 * height - 0.5, 0.0, 1.2))  # to see it from head to foot
    return Scene(
        bodies=[
            Body("dining_room"),
            Body("bottle", position=BOTTLE),
            Body(body, Material.animated(material, height), position=PLACE),
            *rings(PLACE, height),
        ],
        colliders=room(),
        light=Light(position=(0.0, 1.9, 0.1), target=PLACE),
        background=PLASTER,
        eye=(0.0, 1.15 + 0.4 * far, 0.75 + far),
        target=(0.0, 0.9 + 0.5 * far, 0.0),
        game=JustDance(PLACE, height),
    )
