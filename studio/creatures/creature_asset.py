"""From a creature to an asset: its coat, and the cage that `prepare` makes of that, as it would of a capture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

import numpy as np

from assets.asset import Asset
from studio.creatures.coat import coat
from studio.detail import Detail


def creature(
    where: str, gaussians: int, vertices: int, rng: np.random.Generator, detail: Detail, report: Callable[[str], None]
) -> Asset:
    """The asset of a creature. Taichi must be running.

    where                "module:function" in this package that gives its Creature
    gaussians, vertices  about how many at the shipped detail
    """
    from prepare.pipeline import Options, prepare

    module, function = where.split(":")
    made = getattr(import_module(f"studio.creatures.{module}"), function)()
    g = coat(made, round(gaussians * detail.gaussians), rng)
    report(f"{function}: {len(g):,} Gaussians")
    longest = float(np.ptp(g.means, axis=0).max())
    options = Options(vertices=detail.cage_vertices(vertices), scale=longest, up="+y")
    return replace(prepare(g, options), material=made.material)
