"""Materials by name, for bodies whose own is not known."""

from __future__ import annotations

from assets.errors import BadInput

DEFAULT = "plush"

# young [Pa], poisson, density [kg/m^3], friction. Densities, Poisson's ratios and friction are the real ones; stiffness
# is real for foam, plush and jelly. Solid rubber (1e6 to 1e7 Pa) and wood (1e10 Pa) are made as soft as a substep of
# about 1e-4 s on a hand-sized body asks: the step shrinks with the square root of young / density.
MATERIALS = {
    "foam": {"young": 1e4, "poisson": 0.2, "density": 60.0, "friction": 0.6},
    "rubber": {"young": 5e4, "poisson": 0.45, "density": 1100.0, "friction": 0.8},
    "plush": {"young": 2e4, "poisson": 0.35, "density": 250.0, "friction": 0.7},
    "jelly": {"young": 5e3, "poisson": 0.45, "density": 1000.0, "friction": 0.3},
    "wood": {"young": 5e5, "poisson": 0.3, "density": 600.0, "friction": 0.4},
}


def material_named(name: str) -> dict[str, float]:
    """A copy of the material's properties. Raises BadInput that lists the names."""
    if name not in MATERIALS:
        raise BadInput(f"material {name!r} is unknown; one of {', '.join(MATERIALS)}")
    return dict(MATERIALS[name])


def run(args) -> None:
    """vrgs.py materials: print the table."""
    print(f"{'':8} {'young [Pa]':>10} {'poisson':>8} {'density [kg/m^3]':>17} {'friction':>9}")
    for name, m in MATERIALS.items():
        print(f"{name:8} {m['young']:10.0e} {m['poisson']:8} {m['density']:17} {m['friction']:9}")
