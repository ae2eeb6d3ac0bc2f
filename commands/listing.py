"""`vrgs.py scenes` and `vrgs.py materials`: lists of what there is by name."""

from __future__ import annotations

from dataclasses import dataclass

from commands import options as cli
from core.material import MATERIALS
from scenes import registry


@dataclass(kw_only=True)
class ScenesOptions(cli.Options):
    EXAMPLES = ("scenes",)


@dataclass(kw_only=True)
class MaterialsOptions(cli.Options):
    EXAMPLES = ("materials",)


def list_scenes(options: ScenesOptions) -> None:
    """Print each scene's name, what it is and its options, or why it cannot be played."""
    for demo in registry.demos():
        print(f"{demo.name:16} {demo.summary if demo.build else f'cannot be played: {demo.fault}'}")
        for option in demo.options:
            print(f"{'':16} {option.flag}: {option.choice_text}")


def list_materials(options: MaterialsOptions) -> None:
    """Print a line for each material."""
    print(f"{'':8} {'young [Pa]':>10} {'poisson':>8} {'density [kg/m^3]':>17} {'friction':>9} {'sliding':>8}")
    for name, m in MATERIALS.items():
        print(f"{name:8} {m.young:10.0e} {m.poisson:8} {m.density:17} {m.friction:9} {m.sliding_friction:8}")
