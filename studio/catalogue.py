"""The table of all models: where the function stands that makes each asset. To register a model, add one line."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from importlib import import_module

import numpy as np

from assets.asset import Asset
from studio.detail import SHIPPED, Detail

SEED = 7
FIRST = ("dining_room", "bottle", "ring_red", "ring_blue", "ring_yellow", "dancer")  # numbered: their seeds stay
BRICKS = tuple(f"brick_{kind}" for kind in ("maple", "walnut", "red", "blue", "yellow", "green", "letters"))
BOXES = tuple(f"box_{kind}" for kind in ("cardboard", "parcel", "crate", "tin"))

# Asset name -> ("module:function", further arguments). The module is imported when the model is built, and the function
# is called as f(*arguments, rng, detail, report) -> Asset, where rng is a numpy.random.Generator of the asset's own,
# detail a studio.detail.Detail, and report(line) shows progress. Taichi is running.
MODELS: dict[str, tuple] = {
    # ring toss
    "dining_room": ("studio.dining_room.room_model:dining_room",),
    "bottle": ("studio.dining_room.bottle_model:bottle",),
    "ring_red": ("studio.ring:ring", "ring_red"),
    "ring_blue": ("studio.ring:ring", "ring_blue"),
    "ring_yellow": ("studio.ring:ring", "ring_yellow"),
    # just dance
    "dancer": ("studio.dancer.dancer_model:dancer",),
    "stage": ("studio.stage.stage_model:stage",),
    "ball": ("studio.ball:ball",),
    # toy collection: room, basket
    "childrens_room": ("studio.childrens_room.childrens_room_model:childrens_room",),
    "basket": ("studio.basket:basket",),
    #
    # toy collection: plush toys; their Gaussians and cage vertices as shipped
    "toy_teddy": ("studio.creatures.creature_asset:creature", "toy_pets:toy_teddy", 7_500, 200),
    "toy_rabbit": ("studio.creatures.creature_asset:creature", "toy_pets:toy_rabbit", 7_500, 200),
    "toy_cat": ("studio.creatures.creature_asset:creature", "toy_pets:toy_cat", 7_500, 200),
    "toy_duck": ("studio.creatures.creature_asset:creature", "toy_pets:toy_duck", 7_500, 200),
    "toy_elephant": ("studio.creatures.creature_asset:creature", "toy_wild:toy_elephant", 7_500, 200),
    "toy_penguin": ("studio.creatures.creature_asset:creature", "toy_wild:toy_penguin", 7_500, 200),
    "toy_frog": ("studio.creatures.creature_asset:creature", "toy_wild:toy_frog", 7_500, 300),
    "toy_dinosaur": ("studio.creatures.creature_asset:creature", "toy_wild:toy_dinosaur", 7_500, 200),
    "toy_octopus": ("studio.creatures.creature_asset:creature", "toy_sea_and_sky:toy_octopus", 7_500, 250),
    "toy_whale": ("studio.creatures.creature_asset:creature", "toy_sea_and_sky:toy_whale", 7_500, 200),
    "toy_star": ("studio.creatures.creature_asset:creature", "toy_sea_and_sky:toy_star", 7_500, 200),
    "toy_ladybird": ("studio.creatures.creature_asset:creature", "toy_sea_and_sky:toy_ladybird", 7_500, 250),
    # fitted toy
    "rabbit_fitted": ("studio.fitted_rabbit:fitted_rabbit", "toy_rabbit_hung"),
    # animals
    "fox": ("studio.creatures.creature_asset:creature", "fox:fox", 22_000, 560),
    "bear": ("studio.creatures.creature_asset:creature", "bear:bear", 22_000, 500),
    "horse": ("studio.creatures.creature_asset:creature", "horse:horse", 22_000, 640),
    "sheep": ("studio.creatures.creature_asset:creature", "sheep:sheep", 22_000, 600),
    "rabbit": ("studio.creatures.creature_asset:creature", "rabbit:rabbit", 22_000, 480),
    # animal crossing: garden
    "garden": ("studio.garden.garden_model:garden",),
    **{f"flower_ring_{k}": ("studio.garden.flower_ring:flower_ring", k) for k in range(5)},
    #
    # table brick game
    "study": ("studio.study.study_model:study",),
    **{name: ("studio.study.bricks:brick", name) for name in BRICKS},
    "rubber_ball": ("studio.study.elastic_toys:rubber_ball",),
    "jelly_bear": ("studio.study.elastic_toys:jelly_bear",),
    # box moving
    "attic": ("studio.attic.attic_model:attic",),
    "pallet": ("studio.attic.boxes:pallet",),
    **{name: ("studio.attic.boxes:moving_box", name) for name in BOXES},
}


def build_model(name: str, detail: Detail = SHIPPED, report: Callable[[str], None] = print) -> Asset:
    """Make the asset `name`. Its random numbers are its own: neither order nor other models matter."""
    where, *arguments = MODELS[name]
    module, function = where.split(":")
    number = FIRST.index(name) if name in FIRST else zlib.crc32(name.encode())
    rng = np.random.default_rng([SEED, number])
    return getattr(import_module(module), function)(*arguments, rng, detail, report)
