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
    row = "{:8} {:>10} {:>8} {:>17} {:>9} {:>8} {:>13}"
    print(row.format("", "young [Pa]", "poisson", "density [kg/m^3]", "friction", "sliding", "yield strain"))
    for name, m in MATERIALS.items():
        numbers = m.poisson, m.density, m.friction, m.sliding_friction, m.yield_strain or "-"
        print(row.format(name, f"{m.young:.0e}", *numbers))
