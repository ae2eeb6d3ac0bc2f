"""Elastic and plastic materials, and a table of them by name for bodies whose own is not known."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

from core.errors import BadInput

DEFAULT_MATERIAL = "plush"
ANIMATED_MATERIAL = "flesh"  # of a body with an animation of its own

YOUNG_MAX = 1e12  # [Pa] diamond
# [rad/s], 5 Hz: what bodies do as a whole is slower and damped by `damping` alone, what a blow or a contact excites is
# faster and damped by inner friction. Without that, dropped cubes shake on for seconds, and stacks never rest.
RAYLEIGH_FREQUENCY = 30.0
PERSON_HEIGHT = 1.75  # [m] of the person whose flesh the table has
ANIMATED_YOUNG_MIN = 1e3  # [Pa] an animated body must still bear its weight


@dataclass(frozen=True)
class Material:
    """An isotropic material with Coulomb friction, elastic up to its yield strain.

    young             Young's modulus [Pa]
    poisson           Poisson's ratio, below 0.5
    density           [kg/m^3]
    friction          coefficient of static friction
    damping           rate c [1/s] at which the energy of vibrations dies out, of fast ones faster (Rayleigh damping):
                      c + ret w^2 at w rad/s, ret = `retardation_time`; rigid motion is left alone
    kinetic_friction  coefficient of friction of what slides; None: the static one
    yield_strain      logarithmic strain, of a pull or a pressure that keeps the volume, beyond which the body keeps its
                      new shape (sim/elastic/plastic_flow.py); None: it always springs back
    """

    young: float
    poisson: float
    density: float
    friction: float = 0.5
    damping: float = 2.0
    kinetic_friction: float | None = None
    yield_strain: float | None = None

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of what slides, given or the static one."""
        return self.friction if self.kinetic_friction is None else self.kinetic_friction

    @property
    def retardation_time(self) -> float:
        """Kelvin-Voigt time [s]: stress is that of the strain plus so many times its rate; solvers may take less."""
        return self.damping / RAYLEIGH_FREQUENCY**2

    @property
    def lame_parameters(self) -> tuple[float, float]:
        """Lame's mu and lambda [Pa] of linear elasticity."""
        nu = self.poisson
        return self.young / (2 * (1 + nu)), self.young * nu / ((1 + nu) * (1 - 2 * nu))

    @classmethod
    def named(cls, name: str, **changes: float) -> Material:
        """A material of the table, with some properties changed. Raises BadInput that lists the names."""
        if name not in MATERIALS:
            raise BadInput(f"material {name!r} is unknown; one of {', '.join(MATERIALS)}")
        return replace(MATERIALS[name], **changes)

    def animated(self, height: float) -> Material:
        """The material for an animated body of this height [m]: softer for one that is smaller than a person.

        Inertial stresses rho a L grow with the square of the size where motions take the same time: a small body holds
        its shape with less stiffness, and can then be simulated by as few substeps as a large one.
        """
        ratio = min(height / PERSON_HEIGHT, 1.0) ** 2
        return replace(self, young=max(ratio * self.young, ANIMATED_YOUNG_MIN))

    def check(self, where: str) -> None:
        """Raise BadInput, naming `where`, for a material that no body can have."""
        for name, value in asdict(self).items():
            if value is not None and not math.isfinite(value):
                raise BadInput(f"{where}: the material's {name} is not finite")
        if self.young <= 0 or self.density <= 0:
            raise BadInput(f"{where}: the material's young and density must be positive")
        if self.young > YOUNG_MAX:
            raise BadInput(f"{where}: young = {self.young:.3g} Pa is too stiff: at most {YOUNG_MAX:.0e} Pa")
        if not 0 <= self.poisson < 0.5:
            raise BadInput(f"{where}: the material's poisson must lie in 0..0.5 (0.5 excluded)")
        if self.damping < 0 or self.friction < 0:
            raise BadInput(f"{where}: the material's damping and friction must not be negative")
        if self.yield_strain is not None and self.yield_strain <= 0:
            raise BadInput(f"{where}: the material's yield_strain must be positive")
        if not 0 <= self.sliding_friction <= self.friction:
            raise BadInput(f"{where}: the material's kinetic_friction must lie between 0 and its friction")


# Friction on a dry smooth table. All lie in the range that the solver is tested in, 1e2 to 1e8 Pa and Poisson's ratios
# up to 0.49: wood is softer than it is, rubber less incompressible.
MATERIALS = {
    # Flexible polyurethane: Gibson and Ashby, Cellular Solids (1997), E = E_s (rho / rho_s)^2 = 45 MPa (30 / 1200)^2.
    "foam": Material(young=3e4, poisson=0.3, density=30.0, friction=0.6, kinetic_friction=0.5),
    # Natural rubber: Ashby, Materials Selection in Mechanical Design: 1.5 to 2.5 MPa, 920 to 930 kg/m^3, 0.4999.
    "rubber": Material(young=2e6, poisson=0.48, density=930.0, friction=1.0, kinetic_friction=0.8),
    # A silicone elastomer softer than Smooth-On's Ecoflex 00-10 (0.055 MPa at 100% strain, 1,040 kg/m^3), with filler:
    # the rings of the ring toss. Real ones keep their volume; with 0.4 a thin ring stays cheap to simulate.
    "silicone": Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6),
    # A toy of 0.3 kg in 3 l, fibre fill in cloth; 10 N of a hand on 50 cm^2 press it in by about a fifth (an estimate).
    "plush": Material(young=1e4, poisson=0.2, density=100.0, friction=0.6, kinetic_friction=0.5),
    # A gelatine dessert of 3 to 5%: shear moduli of 1 to 3 kPa, so E = 3 G of 3 to 9 kPa; it is mostly water, and wet.
    "jelly": Material(young=5e3, poisson=0.48, density=1030.0, friction=0.2, kinetic_friction=0.1),
    # Pine, Wood Handbook (Forest Products Laboratory, 2010): 510 kg/m^3; 1e10 Pa along the grain, 5e8 to 1e9 Pa across.
    "wood": Material(young=1e8, poisson=0.35, density=510.0, friction=0.5, kinetic_friction=0.3),
    # Muscle at rest: some 10 kPa pressed, more pulled (McKee et al., Tissue Engineering B, 2011), many times as much at
    # work; 1,060 kg/m^3. At 30 kPa a dancing man's own inertia crumples his joints, at 100 kPa they hold their shape.
    # That it keeps its volume keeps a joint's inner side from turning inside out.
    "flesh": Material(young=1e5, poisson=0.45, density=1060.0, friction=0.6, kinetic_friction=0.5),
    # Modelling clay that hands can shape: it yields at some 15 kPa, and real ones at 10 to 100 kPa, after less strain.
    # Stiffer, it would need more substeps and look the same.
    "clay": Material(young=3e5, poisson=0.45, density=1700.0, friction=0.8, damping=10.0, yield_strain=0.05),
}
