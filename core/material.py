"""Materials by name, for bodies whose own is not known."""

from __future__ import annotations

from dataclasses import dataclass

from core.errors import BadInput

DEFAULT = "plush"
MOVING = "flesh"  # of what moves by itself
STATURE = 1.75  # [m] of the person whose flesh it is
SOFTEST = 1e3  # [Pa] of anything that moves by itself: it must still bear its weight

# young [Pa], poisson, density [kg/m^3], friction that holds and friction that slides on a dry smooth table. The solver
# takes 1e2 to 1e8 Pa and Poisson's ratios up to 0.49; what is stiffer or less compressible is given the nearest value.
MATERIALS = {
    # Flexible polyurethane: Gibson and Ashby, Cellular Solids (1997), E = E_s (rho / rho_s)^2 = 45 MPa (30 / 1200)^2.
    "foam": {"young": 3e4, "poisson": 0.3, "density": 30.0, "friction": 0.6, "kinetic_friction": 0.5},
    # Natural rubber: Ashby, Materials Selection in Mechanical Design: 1.5 to 2.5 MPa, 920 to 930 kg/m^3, 0.4999.
    "rubber": {"young": 2e6, "poisson": 0.48, "density": 930.0, "friction": 1.0, "kinetic_friction": 0.8},
    # A toy of 0.3 kg in 3 l, fibre fill in cloth; 10 N of a hand on 50 cm^2 press it in by about a fifth (an estimate).
    "plush": {"young": 1e4, "poisson": 0.2, "density": 100.0, "friction": 0.6, "kinetic_friction": 0.5},
    # A gelatine dessert of 3 to 5%: shear moduli of 1 to 3 kPa, so E = 3 G of 3 to 9 kPa; it is mostly water, and wet.
    "jelly": {"young": 5e3, "poisson": 0.48, "density": 1030.0, "friction": 0.2, "kinetic_friction": 0.1},
    # Pine, Wood Handbook (Forest Products Laboratory, 2010): 510 kg/m^3; 1e10 Pa along the grain, 5e8 to 1e9 Pa across.
    "wood": {"young": 1e8, "poisson": 0.35, "density": 510.0, "friction": 0.5, "kinetic_friction": 0.3},
    # Muscle at rest: some 10 kPa pressed, more pulled (McKee et al., Tissue Engineering B, 2011), many times as much at
    # work; 1,060 kg/m^3. At 30 kPa a dancing man's own inertia crumples his joints, at 100 kPa they hold their shape.
    # That it keeps its volume keeps a joint's inner side from turning inside out.
    "flesh": {"young": 1e5, "poisson": 0.45, "density": 1060.0, "friction": 0.6, "kinetic_friction": 0.5},
}


@dataclass(frozen=True)
class Material:
    """An isotropic elastic material: Young's modulus [Pa], Poisson's ratio, density [kg/m^3], Coulomb's coefficient of
    friction that holds, a damping rate [1/s] towards the body's rigid motion, and the coefficient of friction of what
    slides (None: it is the same)."""

    young: float
    poisson: float
    density: float
    friction: float = 0.5
    damping: float = 2.0
    kinetic_friction: float | None = None

    @property
    def sliding_friction(self) -> float:
        """The coefficient of friction of what slides."""
        return self.friction if self.kinetic_friction is None else self.kinetic_friction

    @classmethod
    def named(cls, name: str, **changes: float) -> Material:
        """A material by its name in core/material.py, with some properties changed. Raises BadInput."""
        return cls(**{**material_named(name), **changes})

    @classmethod
    def moving(cls, name: str, height: float) -> Material:
        """The same for a body of this height [m] that moves by itself: a small one is softer. Raises BadInput."""
        return cls(**moving_named(name, height))


def material_named(name: str) -> dict[str, float]:
    """A copy of the material's properties. Raises BadInput that lists the names."""
    if name not in MATERIALS:
        raise BadInput(f"material {name!r} is unknown; one of {', '.join(MATERIALS)}")
    return dict(MATERIALS[name])


def moving_named(name: str, height: float) -> dict[str, float]:
    """A material's properties for a body of this height [m] that moves by itself, at the pace of a grown person.

    Stresses of inertia, rho a L, grow with the square of the size: a small one holds its shape with less stiffness, and
    can then be simulated by as few substeps as a large one. Raises BadInput.
    """
    properties = material_named(name)
    share = min(height / STATURE, 1.0) ** 2
    return properties | {"young": max(share * properties["young"], SOFTEST)}


def run(args) -> None:
    """vrgs.py materials: print the table."""
    print(f"{'':8} {'young [Pa]':>10} {'poisson':>8} {'density [kg/m^3]':>17} {'friction':>9} {'sliding':>8}")
    for name, m in MATERIALS.items():
        friction = f"{m['friction']:9} {m['kinetic_friction']:8}"
        print(f"{name:8} {m['young']:10.0e} {m['poisson']:8} {m['density']:17} {friction}")
