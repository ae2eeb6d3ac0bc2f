"""Just dance: a puppet dances on the table, rings bounce off it; --body brings a dancer of yours (prepare --rig)."""

from __future__ import annotations

import numpy as np

from assets.library import animated_height
from core.errors import BadInput
from scenes.dining_table import BACKGROUND, TABLE_TOP, colliders, furniture, lamp, room
from scenes.sandbox import RING, Sandbox, body_material, rings
from scenes.scene import Body, BodyState, Role, Scene

PLACE = (0.0, TABLE_TOP, 0.05)  # [m] on the table, before the bottle


class JustDance(Sandbox):
    """A ring that is thrown and meets the dancer scores; the scripted hand throws one again and again."""

    def reset(self) -> None:
        super().reset()
        self.hits, self.flying = 0, False  # flying: the ring was thrown and has met nobody yet

    def update(self, time: float, bodies: list[BodyState]) -> None:
        super().update(time, bodies)
        dancer, ring = bodies[:2]
        if ring.held:
            self.flying = True
        elif self.flying and (ring.centroid > dancer.low).all() and (ring.centroid < dancer.high).all():
            self.flying, self.hits = False, self.hits + 1

    @property
    def score(self) -> int:
        return self.hits

    @property
    def message(self) -> str:
        return f"{self.hits} hits. Throw the ring at the dancer." if self.hits else "Throw the ring at the dancer."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: a ring has hit the dancer and lies outside of it."""
        assert self.hits > 0, "no ring has met the dancer"
        assert np.isfinite(bodies[1].centroid).all() and bodies[0].low[1] > TABLE_TOP - 0.05


def build(body: str = "dancer", material: str | None = None) -> Scene:
    """`body` is an animated asset, `material` a name (core/material.py) or None for its own. Raises BadInput."""
    height = animated_height(body)
    if height is None:
        raise BadInput(f"{body}: is not animated; make such an asset by vrgs.py prepare PERSON.ply --rig RIG.glb")
    back = float(np.clip(1.5 * height - 0.5, 0.0, 1.2))  # [m], to see it from head to foot
    return Scene(
        bodies=[*furniture(), Body(body, body_material(body, material, height), position=PLACE), *rings(PLACE, height)],
        colliders=colliders(),
        light=lamp(PLACE),
        background=BACKGROUND,
        eye=(0.0, 1.15 + 0.4 * back, 0.75 + back),
        target=(0.0, 0.9 + 0.5 * back, 0.0),
        game=JustDance(PLACE, height),
        roles=(Role("dancer", (body,), animated=True), Role("ring", (RING,))),
        room=room(),
    )
