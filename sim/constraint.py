"""Base class of the constraints that the integrators solve: contacts (sim/contact) and rigid bodies (sim/rigid).

A constraint corrects the increments dx of the substep in progress (see sim/state.py): that is all it does. The
velocity follows from dx once, at the commit, so that no correction is lost however small it is. Corrections are
weighted by the inverse mass; vertices of inverse mass 0 are prescribed, and what is added to their dx is ignored.

A sweep of an integrator corrects every vertex for itself (`project_vertex`), then runs the phases: loops in which all
elements of one phase are done before any of the next (`solve_phase`), whose sums the vertices take at last
(`apply_impulses`). Sums over elements are fixed in order or made of integers: repeated CPU runs agree bit for bit.

The integrator that runs the substep is handed to the phases, because they depend on three of its attributes:

    effective_inv_mass  f32[V]  displacement of a vertex within the substep per impulse [1/kg]
    warm_started        bool    dx contains the impulses of the last substep from the beginning
    iterations          int     sweeps a substep
"""

from typing import TYPE_CHECKING

import taichi as ti

if TYPE_CHECKING:
    from sim.model import Model


@ti.data_oriented
class Constraint:
    """A constraint that does nothing. Attributes of Python objects are compile-time constants of the device functions.

    has_vertex   the vertex functions do something
    has_pairs    the phases do something
    phase_sizes  capacity of each phase, in elements
    max_groups   capacity in groups, which are solved in each later phase, by a warp each
    """

    has_vertex = False
    has_pairs = False
    phase_sizes: tuple[int, ...] = ()
    max_groups = 0

    def check_capacity(self, model: "Model") -> None:
        """Raise CapacityError if these bodies do not fit."""

    def load(self, model: "Model") -> None:
        """Take other bodies into the same fields and kernels; contacts and grasps are forgotten."""

    def begin_frame(self, hands: list, dt: float, substeps: int) -> None:
        """Prepare a frame of dt [s] that ends with these hands; 0 substeps: only grasps are decided."""

    def detect(self) -> None:
        """Search for contacts of the next state.detect_dt [s], `collision_passes` times a frame, from x and v."""

    def reset(self) -> None:
        """Forget contacts and grasps."""

    def warm_up(self) -> None:
        """Compile kernels that a frame may need later, by calls that change nothing."""

    @ti.func
    def project_vertex(self, i, dx, first: ti.template()):
        """XPBD: the corrected increment of vertex i, whose w > 0; `first`: in the first sweep of a substep.

        Runs in the integrator's loop over vertices, with dx in registers; state.dx[i] must not be touched.
        """
        return dx

    @ti.func
    def evaluate_vertex(self, i):
        """VBD, at the begin of a substep: evaluate what its sweeps need of the committed state of vertex i."""

    @ti.func
    def external_displacement(self, i, dx):
        """VBD, at the begin of a substep: displacement [m] that hands give vertex i if it moves by dx otherwise."""
        return ti.Vector([0.0, 0.0, 0.0])

    @ti.func
    def project_vertex_implicit(self, i, dx, H, A, prior):
        """VBD: as `project_vertex` in the metric H [N/m] = A^-1, `prior` [N] being the force of the last sweep.

        Returns the increment, the force that it took [N], and the contact stiffness [N/m], 0 without contact.
        """
        return dx, ti.Vector([0.0, 0.0, 0.0]), 0.0

    @ti.func
    def evaluate(self, k):
        """Evaluate what element k of phase 0 needs of the committed state; before that phase, in the first sweep."""

    @ti.func
    def solve_phase(self, integrator: ti.template(), later: ti.template(), phase, k, first: ti.template()):
        """Solve element k < phase_sizes[phase]; `later`: phase > 0, so that one compiled loop does for all of these."""

    @ti.func
    def solve_group(self, phase, g, lane):
        """Solve group g < group_count() in a later phase; all lanes of a warp come together (core/lanes.py)."""

    @ti.func
    def release_group(self, g):
        """End the sweep for group g, after the last phase that solves it."""

    @ti.func
    def continues(self, phase):
        """Return whether a later phase has anything to do; if it has not, those after it have not either."""
        return True

    @ti.func
    def group_count(self):
        """Number of groups until the next search."""
        return 0

    @ti.func
    def phase_count(self, phase: ti.template()):
        """Number of elements of a phase until the next search."""
        return 0

    @ti.func
    def any_active(self):
        """Return whether any phase has an element until the next search."""
        return False

    @ti.func
    def apply_impulses(self, i, dx):
        """Add the sums of all phases to the increment of vertex i, and clear them."""
        return dx
