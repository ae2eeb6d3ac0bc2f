"""Device state of all simulated bodies, flat, and how a substep advances it.

A substep of length dt works on *increments*, because in fp32 the quantities of one substep (dt^2 g = 1e-7 m) are
smaller than one unit in the last place of a position:

    predict   dx = dt (v + dt g) + x_lo
    solve     dx += corrections of elasticity and constraints (sim/elastic/substep.py)
    commit    v += dt g + (dx - dx_predicted) / dt,   y = dt v + x_lo,   x' = x + y,   x_lo = y - (x' - x)

The stress is evaluated at x + share dx - lag v. With share = 1, lag = 0 the methods are implicit Euler or like it:
vibrations of w rad/s lose energy at the rate w^2 dt, and in XPBD a spinning body its spin, whatever the material. With
share = beta, lag = beta dt they keep energy and momenta: XPBD's single sweep is symplectic Euler then, VBD the Newmark
scheme of this beta and gamma = 1/2. Between, the Kelvin-Voigt time of the inner friction is share dt - lag.

The position in the substep in progress is x + dx, and the motion of a vertex in it so far, for friction, is dx - x_lo.
Vertices of inverse mass 0 are prescribed and move on with their v.

Loops run over the capacity and test `i < vertex_count[None]`: a range whose end is read from a field costs one more
launch, and equal capacities let scenes of different sizes share compiled kernels. Those of the CPU's substeps end at
the count: it costs nothing there, and what is used of a capacity would be the part of the first thread alone.
"""

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import Download, FieldGroup, Upload, round_up_capacity, two_sum
from sim.model import MAX_BODIES, Capacity, Model, Sizes, fit
from sim.time_step import STABILITY_LIMIT

NEWMARK_BETA = 0.25  # the trapezoidal rule; less is not stable at every dt, more makes vibrations slower
# dt sqrt(max kappa) up to which the stress may lag, seven times what XPBD bears. Beyond, the sweeps of VBD leave too
# much undone: of undamped bars of 8 x 3 x 3 cells, energy stayed within 5% at 2.5, and grew a millionfold at 3.
MAX_LAGGING_STABILITY = 2.2
MOTION = ("x", "x_lo", "v", "v_lo")  # arrays of a snapshot; x_lo and v_lo are what float32 does not hold of x and v
# Tets of the first bodies, below which no loop of a CPU is shared: waking threads takes 30 us, and to fetch positions
# that another core has written takes longer than to compute them where cores are far apart, 250 ns a cache line
SERIAL_BELOW = 10_000
FEW_BELOW = 6000  # vertices of the first bodies, of whose loops the same is true


@ti.data_oriented
class State:
    """Fields over vertices V, tets T, surface triangles S (capacities, rounded up) and bodies B; SI units.

    `sizes` is how many of each there are. `serial`: loops are better not spread over threads; `few`: those over
    vertices and contacts are not.
    """

    def __init__(self, first: Sizes, capacity: Capacity = Capacity()):
        """Allocate the capacity that `first` and `capacity` ask for; `load` fills it."""
        vertices, tets, triangles = (capacity.sized(n, getattr(first, n)) for n in ("vertices", "tets", "triangles"))
        on_cpu = ti.cfg.arch != ti.cuda
        self.serial = on_cpu and first.tets < SERIAL_BELOW
        self.few = on_cpu and first.vertices < FEW_BELOW
        self.V, self.T, self.S = (round_up_capacity(n) for n in (vertices, tets, triangles))
        self.sizes = Sizes(0, 0, 0, 0)
        V, T, S, B = self.V, self.T, self.S, MAX_BODIES
        g = self.fields = FieldGroup()
        # Motion of the vertices
        self.x = g.vector(V)  # position [m]
        self.v = g.vector(V)  # velocity [m/s]
        self.x_lo = g.vector(V)  # part of the position below the last bit of x [m] (Kahan compensation)
        self.v_lo = g.vector(V)  # part of the velocity below the last bit of v [m/s]
        self.dx = g.vector(V)  # increment of the substep in progress [m]
        self.dx_predicted = g.vector(V)  # the same as it was predicted [m]
        # Constants of the vertices
        self.rest = g.vector(V)  # rest position in the body's frame, scaled [m]
        self.mass = g.scalar(V)  # lumped mass [kg]
        self.inv_mass = g.scalar(V)  # 1/kg, 0 where prescribed; w of the papers
        self.body_of_vertex = g.scalar(V, dtype=ti.i32)
        # Topology
        self.tets = g.vector(T, n=4, dtype=ti.i32)  # vertices, of positive volume at rest
        self.body_of_tet = g.scalar(T, dtype=ti.i32)
        self.triangles = g.vector(S, dtype=ti.i32)  # vertices of the surface, outward
        self.body_of_triangle = g.scalar(S, dtype=ti.i32)
        # Bodies
        self.vertex_begin = g.scalar(B + 1, dtype=ti.i32)
        self.tet_begin = g.scalar(B + 1, dtype=ti.i32)
        self.mu = g.scalar(B)  # second Lame constant [Pa]
        self.lam = g.scalar(B)  # lambda_L + mu [Pa], lambda of the energy (sim/elastic/energy.py)
        self.kappa = g.scalar(B)  # largest stiffness bound of a tet [1/s^2]
        self.damping = g.scalar(B)  # rate of the damping towards rigid motion [1/s]
        self.retardation = g.scalar(B)  # Kelvin-Voigt time of the inner friction [s]
        self.density = g.scalar(B)  # kg/m^3
        self.body_mass = g.scalar(B)  # kg
        self.prescribed_mass = g.scalar(B)  # of the prescribed vertices [kg]
        self.friction = g.scalar(B)  # static coefficient
        self.sliding_friction = g.scalar(B)  # kinetic coefficient
        self.max_step = g.scalar(B)  # the farthest that a vertex may move in a stable substep of XPBD [m]
        self.speed_limit = g.scalar(B)  # of this frame's substeps [m/s]
        self.untangling = g.scalar(B, dtype=ti.i32)  # 1 while it is moved to its rest shape, through itself
        self.inverted = g.scalar(B, dtype=ti.i32)  # bit 0 is set by elasticity where a tet is inverted
        self.stress_lag = g.scalar(B)  # [s] of this frame's substeps; of damped bodies exactly 0
        self.asleep = g.scalar(B, dtype=ti.i32)  # 1 while it is not simulated (sim/sleeping.py)
        self.rest_time = g.scalar(B)  # since when it has been at rest [s]
        # The frame
        self.dt = g.scalar()  # length of a substep [s]
        self.detect_dt = g.scalar()  # time between two searches for contacts [s]
        self.gravity = g.vector()  # m/s^2
        self.substeps = g.scalar(dtype=ti.i32)  # of the frame
        self.substep_index = g.scalar(dtype=ti.i32)  # in the frame, 0 .. substeps-1; -1 before the first
        # Device copies of `sizes`
        self.vertex_count = g.scalar(dtype=ti.i32)
        self.tet_count = g.scalar(dtype=ti.i32)
        self.triangle_count = g.scalar(dtype=ti.i32)
        self.body_count = g.scalar(dtype=ti.i32)
        g.build()
        self._upload: Upload | None = None
        motion = [getattr(self, name) for name in MOTION]
        self._download_motion = Download(motion)
        self.write_motion = Upload(motion)  # of all vertices, four arrays (V, 3)

    def load(self, model: Model) -> None:
        """Take these bodies; only their motion remains to be set."""
        columns = model.columns()
        if self._upload is None:
            self._upload = Upload([getattr(self, name) for name in columns])
        self._upload(list(columns.values()))
        self.sizes = model.sizes

    def read_motion(self) -> np.ndarray:
        """The motion of all vertices, (4, V, 3) float32 in the order of MOTION."""
        return self._download_motion(self.sizes.vertices)

    def check_capacity(self, sizes: Sizes) -> None:
        """Raise CapacityError if this much does not fit."""
        capacities = {"vertices": self.V, "tets": self.T, "triangles": self.S, "bodies": MAX_BODIES}
        for name, capacity in capacities.items():
            fit(name, getattr(sizes, name), capacity)

    @ti.func
    def at(self, i):
        """Position of vertex i in the substep in progress [m]."""
        return self.x[i] + self.dx[i]

    @ti.func
    def strain_increment(self, i, lag):
        """Increment of vertex i at which the stress is evaluated [m], `lag` being the body's stress_lag."""
        return self.lagging(self.dx[i], self.v[i], lag)

    @ti.func
    def lagging(self, dx, v, lag):
        """share dx - lag v [m] of a vertex's increment [m] and velocity [m/s]."""
        d = dx
        if lag > 0.0:  # a branch: what rounding moves in damped bodies flickers
            d -= (1.0 - self.stress_share(lag)) * dx + lag * v
        return d

    @ti.func
    def stress_share(self, lag):
        """Share of a substep's increment that the stress sees, for a body's stress_lag."""
        return 1.0 - (1.0 / NEWMARK_BETA - 1.0) * lag / self.dt[None]

    @ti.func
    def awake_vertex(self, i):
        """True if there is a vertex i and its body is awake."""
        return i < self.vertex_count[None] and not self.asleep[self.body_of_vertex[i]]

    @ti.func
    def awake_tet(self, t):
        """True if there is a tet t and its body is awake."""
        return t < self.tet_count[None] and not self.asleep[self.body_of_tet[t]]

    @ti.func
    def awake_body(self, b):
        """True if there is a body b and it is awake."""
        return b < self.body_count[None] and not self.asleep[b]

    @ti.func
    def each_vertex(self, step: ti.template()):
        """Take step(i) for each vertex i that is awake. Outermost level of a kernel."""
        ti.loop_config(serialize=self.serial)
        for i in range(self.V):
            if self.awake_vertex(i):
                step(i)

    @ti.func
    def frictions(self, b):
        """(mu_s, mu_k) of body b; between two bodies the geometric mean counts."""
        return ti.Vector([self.friction[b], self.sliding_friction[b]])

    @ti.func
    def predict(self, i):
        """dx = dt (v + dt g) + x_lo of a free vertex, dt v + x_lo of a prescribed one, 0 of one that sleeps."""
        d = self._prediction(self.v[i], self.v_lo[i], self.x_lo[i], self.inv_mass[i])
        if self.asleep[self.body_of_vertex[i]]:
            d = ti.Vector([0.0, 0.0, 0.0])
        self.dx_predicted[i] = d
        self.dx[i] = d

    @ti.func
    def _prediction(self, v, v_lo, x_lo, inv_mass):
        dt = self.dt[None]
        d = dt * v + x_lo
        if inv_mass > 0.0:
            d = dt * (v + (v_lo + dt * self.gravity[None])) + x_lo
        return d

    @ti.func
    def commit(self, i, d):
        """Turn the final increment d of vertex i, which is awake, into its new velocity and position; predict the next.

        Returns the position, the velocity and the predicted increment. Everything is loaded before anything is stored:
        a load that waits for a store costs a GPU more than all of the arithmetic.
        """
        dt, w = self.dt[None], self.inv_mass[i]
        v, v_lo, x_lo, predicted = self.v[i], self.v_lo[i], self.x_lo[i], self.dx_predicted[i]
        x, limit = self.x[i], self.speed_limit[self.body_of_vertex[i]]
        if w > 0.0:
            v, v_lo = two_sum(v, v_lo + (dt * self.gravity[None] + (d - predicted) / dt))
            speed = v.norm()
            if speed > limit:
                v, v_lo = v * (limit / speed), 0.0 * v
        x, x_lo = two_sum(x, dt * (v + v_lo) + x_lo)
        predicted = self._prediction(v, v_lo, x_lo, w)
        if w > 0.0:
            self.v[i], self.v_lo[i] = v, v_lo
        self.x[i], self.x_lo[i] = x, x_lo
        self.dx_predicted[i], self.dx[i] = predicted, predicted
        return x, v, predicted

    @ti.kernel
    def begin_frame(self, dt: ti.f32, detect_dt: ti.f32, substeps: ti.i32, g_x: ti.f32, g_y: ti.f32, g_z: ti.f32):
        """Set the constants of all substeps of a frame."""
        self.dt[None], self.detect_dt[None], self.gravity[None] = dt, detect_dt, ti.Vector([g_x, g_y, g_z])
        self.substeps[None], self.substep_index[None] = substeps, -1
        for b in range(MAX_BODIES):
            # A longer substep, of VBD, makes no body slower: its own elements do not limit how fast it may fly
            stable = STABILITY_LIMIT / ti.sqrt(ti.max(self.kappa[b], 1e-12))
            self.speed_limit[b] = self.max_step[b] / ti.min(dt, stable)
            converges = dt * ti.sqrt(self.kappa[b]) <= MAX_LAGGING_STABILITY
            self.stress_lag[b] = NEWMARK_BETA * ti.max(dt - self.retardation[b], 0.0) if converges else 0.0


def motion_of(snapshot: dict, vertices: int) -> list[np.ndarray]:
    """The four arrays of a snapshot with at least "x" and "v", which may be float64. Raises BadInput."""
    motion = []
    for name, low in (("x", "x_lo"), ("v", "v_lo")):
        value = np.asarray(snapshot[name])
        if value.shape != (vertices, 3) or not np.isfinite(value).all():
            raise BadInput(f"snapshot: {name} must be finite and of shape {(vertices, 3)}, not {value.shape}")
        high = value.astype(np.float32)
        motion += [high, snapshot.get(low, value - high)]
    return motion


@ti.func
def inverse_mass_matrix(arm, inv_mass, inverse_inertia):
    """1/m - [r] I^-1 [r] [1/kg]: the motion of a body's point at lever arm r for a unit impulse there, (3, 3)."""
    cross = ti.Matrix([[0.0, -arm.z, arm.y], [arm.z, 0.0, -arm.x], [-arm.y, arm.x, 0.0]])
    return cross.transpose() @ inverse_inertia @ cross + inv_mass * ti.Matrix.identity(ti.f32, 3)
