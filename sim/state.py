"""The flat device state of all simulated bodies, and how constraints plug into the solver.

One substep of length dt (`state.dt[None]`) works on *increments*, because in fp32 the quantities of one
substep (dt^2 g = 1e-7 m) are smaller than one unit in the last place of a position:

    predict   dx = dt (v + dt g) + carry                      `carry` is the part of x below its last bit
    sweeps    dx += elastic correction, then every constraint's correction      (`iterations` times)
    commit    v += dt g + (dx - prediction) / dt,  y = dt v + carry,  x' = x + y,  carry = y - (x' - x)

So the position that a constraint sees is x[i] + dx[i] (`state.at(i)`), and **all it does is change dx[i]**:
the velocity follows from that at the commit, once, and no correction is lost however small it is. The
motion of vertex i in this substep so far, for friction, is dx[i] - carry[i]. Corrections must be weighted
by w: vertices with w = 0 are prescribed, and move on with their v; what is added to their dx is ignored.

A constraint object is a `@ti.data_oriented` class that is built from the State (and whatever else it needs)
and handed to the Solver. It provides

    has_vertex, has_pairs       bool, fixed at construction: which of the two device functions below do anything
    begin_frame(hands, dt, substeps)
                                host; before the first substep of a frame of dt [s]; state.dt is set, tick = -1
    detect()                    host, launches kernels; `collision_passes` times a frame, at equal intervals of
                                state.detect_dt[None] [s]; reads x and v (committed), must not change them
    @ti.func project_vertex(self, i, dx, first: ti.template()) -> dx
                                vertex i against static shapes and hands. Called inside the solver's own vertex
                                loop, after the elastic correction and before all pairs, for i < vertex_count
                                with w[i] > 0. `dx` is vertex i's increment in registers; return the corrected
                                one; do not read or write state.dx[i]. `first` says, at compile time, whether
                                this is the substep's first sweep.
    @ti.func push_vertex(self, i, dx) -> vec3
                                descent path (sim/elastic/vbd.py) instead of project_vertex, once at the substep's begin:
                                displacement that hands give a vertex with increment dx if it moved freely
    @ti.func project_vertex_metric(self, i, dx, H, A, prior) -> dx, reaction, hold
                                descent path instead of project_vertex, in each sweep: vertex i against static shapes in
                                the metric H [N/m] = A^-1; also the force that this took [N], in the last sweep `prior`,
                                and the stiffness [N/m] with which the vertex is held where it touches, else 0
    stage_sizes                 ints, fixed at construction: elements of each stage of the pairs
    @ti.func project_stage(self, stage: ti.template(), k, first: ti.template())
                                element k < stage_sizes[stage] of a stage. All elements of a stage are done before any
                                of the next. Stages read state.dx and sum corrections (in a fixed order or as
                                integers: repeated CPU runs must agree bit for bit).
    @ti.func look(self, k)      what element k of stage 0 needs to know of the committed state alone; before that
                                stage, in the first sweep
    @ti.func stage_count(self, stage: ti.template()) -> i32,   @ti.func busy(self) -> bool
                                how many elements of a stage there are now, and whether there are any: at a stage's
                                begin, and from one search to the next
    @ti.func settle_vertex(self, i, dx) -> dx
                                like project_vertex, after all stages, if there are pairs: add their sums.
    reset()                     host; forget contacts and grips
    check_room(assembly)        host; BadInput if these bodies do not fit
    load(assembly)              host; other bodies from now on, in the same fields and kernels: so what is compile-time
                                must follow from the Room alone. Contacts and grips are forgotten
    grips() -> value, hold(value)
                                host; what hands hold, as an immutable value, and to hold that again

If bodies may be rigid, `state.coupled` is true and `state.movers` (sim/rigid/rigid_bodies.py) moves them in its stage, after all
others; their vertices, with w = 0, follow at the commit. `state.w` and `dx` say nothing of them.

Without has_pairs a substep is two loops (tets; vertices), with it three and one for each stage. Python
attributes are compile-time constants in both functions. `state.tick[None]` is the index of the current substep
in the frame, 0 .. substeps[None]-1, constant throughout both functions: a hand's pose in a substep is
the interpolation at (tick + 1) / substeps.

The object that holds the hands' grips also provides `gripped() -> list[int]` (host, small readback): the
body that each hand holds, -1 for none; it decides that in begin_frame, also if interaction is "transform", when
the solver moves gripped bodies itself and runs neither detect nor substeps (which then are 0). Its `seen() -> list`
are the hands as they counted there: where one is that the tracking has lost.

Loops run over the capacity and test `i < vertex_count[None]`: a range whose end is read from a field costs one
more launch, and equal capacities let scenes of different sizes share compiled kernels.
"""

import taichi as ti

from core.fields import Upload, round_up_capacity
from sim.model import MAX_BODIES, Capacity, Model, Sizes, fit

SERIAL_BELOW = 3000  # tets: under this, waking the CPU's worker threads costs more than they save


@ti.data_oriented
class State:
    """Positions, velocities, masses and topology of all bodies, flat, with the body of each element.

    Fields over vertices V, tets T, surface triangles S (capacities rounded up), bodies B; SI units:
        x, v, carry, v_carry  vec3[V]  position, velocity and what they lost to rounding
        dx, predicted         vec3[V]  increment of the substep in progress, relative to x, and as it was predicted
        rest                  vec3[V]  rest position in the body frame (scaled)
        w, mass               f32[V]   inverse mass (0 = prescribed), lumped mass [kg]
        mobility              f32[V]   what 1 kg m of impulse moves in a substep [1/kg]: w, or the descent path's own;
                                       `answers`: whether dx answers at once to what rows push (there it does)
        body_of_vertex        i32[V]
        tets                  vec4i[T] global vertex indices, positive volume at rest;   body_of_tet i32[T]
        triangles             vec3i[S] global vertex indices, outward;              body_of_triangle i32[S]
        vertex_begin, tet_begin, triangle_begin  i32[B+1]
        mu, lam, kappa        f32[B]   Lame constants of MATH 7 (lam = lambda_L + mu) [Pa]; max kappa [1/s^2]
        damping, density, body_mass, friction (of what holds), sliding_friction    f32[B]
        led f32[B]: mass of the prescribed vertices;   reach f32[B]: the farthest a vertex may move in one substep [m]
        inverted              i32[B]   set to 1 by elasticity where a tet is inside out
        dt, detect_dt, gravity, tick, substeps   of this frame
        vertex_count, tet_count, triangle_count, body_count   i32, device copies of `sizes`
    """

    def __init__(self, first: Sizes, room: Capacity = Capacity()):
        """Room for what is there `first` and what may come; `serial`: loops are better not spread over threads."""
        vertices, tets, triangles = (room.sized(n, getattr(first, n)) for n in ("vertices", "tets", "triangles"))
        self.serial = ti.lang.impl.current_cfg().arch != ti.cuda and tets < SERIAL_BELOW
        self.V, self.T, self.S = (round_up_capacity(n) for n in (vertices, tets, triangles))
        self.sizes = Sizes(0, 0, 0, 0)
        self.coupled, self.movers = (
            False,
            None,
        )  # sim/rigid/rigid_bodies.py Movers comes before any kernel is compiled, if ever
        self.builder = ti.FieldsBuilder()
        V, T, S, B = self.V, self.T, self.S, MAX_BODIES
        self.x, self.v, self.carry, self.v_carry = (self._vectors(V) for _ in range(4))
        self.dx, self.predicted, self.rest = (self._vectors(V) for _ in range(3))
        self.w, self.mass = self._scalars(V), self._scalars(V)
        self.mobility, self.answers = self.w, False
        self.body_of_vertex = self._scalars(V, ti.i32)
        self.tets, self.body_of_tet = self._vectors(T, 4, ti.i32), self._scalars(T, ti.i32)
        self.triangles, self.body_of_triangle = self._vectors(S, 3, ti.i32), self._scalars(S, ti.i32)
        self.vertex_begin, self.tet_begin, self.triangle_begin = (self._scalars(B + 1, ti.i32) for _ in range(3))
        self.mu, self.lam, self.kappa = (self._scalars(B) for _ in range(3))
        self.damping, self.friction, self.density, self.body_mass = (self._scalars(B) for _ in range(4))
        self.sliding_friction, self.led, self.reach = (self._scalars(B) for _ in range(3))
        self.inverted = self._scalars(B, ti.i32)
        self.dt, self.detect_dt, self.gravity = self._scalars(), self._scalars(), self._vectors()
        self.tick, self.substeps = self._scalars(dtype=ti.i32), self._scalars(dtype=ti.i32)
        self.vertex_count, self.tet_count, self.triangle_count, self.body_count = (
            self._scalars(dtype=ti.i32) for _ in range(4)
        )
        self.tree = self.builder.finalize()
        self._upload: Upload | None = None

    def load(self, assembly: Model) -> None:
        """Take these bodies, of which only the motion is left to be set."""
        columns = assembly.columns()
        if self._upload is None:
            self._upload = Upload([getattr(self, name) for name in columns])
        self._upload(list(columns.values()))
        self.sizes = assembly.sizes

    def check_room(self, sizes: Sizes) -> None:
        """BadInput if this much does not fit."""
        capacities = {"vertices": self.V, "tets": self.T, "triangles": self.S, "bodies": MAX_BODIES}
        for what, most in capacities.items():
            fit(what, getattr(sizes, what), most)

    def _place(self, field, size: int | None):
        (self.builder if size is None else self.builder.dense(ti.i, size)).place(field)
        return field

    def _scalars(self, size: int | None = None, dtype=ti.f32):
        return self._place(ti.field(dtype), size)

    def _vectors(self, size: int | None = None, n: int = 3, dtype=ti.f32):
        return self._place(ti.Vector.field(n, dtype), size)

    @ti.func
    def at(self, i):
        """Position of vertex i in the substep in progress [m]."""
        return self.x[i] + self.dx[i]

    @ti.func
    def frictions(self, b):
        """(mu_s, mu_k) of body b; of two that touch, the geometric mean counts."""
        return ti.Vector([self.friction[b], self.sliding_friction[b]])

    @ti.kernel
    def begin_frame(self, dt: ti.f32, detect_dt: ti.f32, substeps: ti.i32, gravity: ti.types.vector(3, ti.f32)):
        """Set what holds for all substeps of a frame."""
        self.dt[None], self.detect_dt[None], self.gravity[None] = dt, detect_dt, gravity
        self.substeps[None], self.tick[None] = substeps, -1

    def destroy(self) -> None:
        """Free the device memory; no kernel may touch this state afterwards."""
        self.tree.destroy()
