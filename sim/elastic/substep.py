"""Parts of a substep that all integrators share: the constraints, their phases, and the grid of persistent kernels.

A constraint corrects the increments dx of the substep in progress (see sim/state.py): that is all it does. The
velocity follows from dx once, at the commit, so that no correction is lost however small it is. Corrections are
weighted by the inverse mass; vertices of inverse mass 0 are prescribed, and what is added to their dx is ignored.

A sweep of an integrator corrects every vertex by itself (`project_vertex`), then runs the phases: loops in which all
elements of one phase are done before any of the next (`solve_phase`). Finally the vertices take their sums
(`apply_impulses`). Sums over elements are fixed in order or made of integers: repeated CPU runs agree bit for bit.

The integrator that runs the substep is handed to the phases, because they depend on three of its attributes:

    effective_inv_mass  f32[V]  displacement of a vertex within the substep per impulse [1/kg]
    warm_started        bool    dx contains the impulses of the last substep from the beginning
    iterations          int     sweeps a substep
"""

import ctypes
import sys
from functools import cache

import taichi as ti

from core.fields import FieldGroup
from core.lanes import lane_count, sum_lanes
from sim.model import Model
from sim.state import State


@ti.data_oriented
class Constraint:
    """Base class of what the integrators solve beside elasticity: contacts (sim/contacts.py), rigid bodies (sim/rigid).

    This one does nothing. Attributes of Python objects are compile-time constants of the device functions.

    has_vertex   it has the functions of one vertex as well, see Contacts
    has_pairs    the phases do something
    phase_sizes  capacity of each phase, in elements
    max_groups   capacity in groups, which are solved in each later phase, by a warp each
    """

    has_vertex = False
    has_pairs = False
    phase_sizes: tuple[int, ...] = ()
    max_groups = 0

    def check_capacity(self, model: Model) -> None:
        """Raise CapacityError if these bodies do not fit."""

    def load(self, model: Model) -> None:
        """Take other bodies into the same fields and kernels; contacts and grasps are forgotten."""

    def detect(self) -> None:
        """Search for contacts of the next state.detect_dt [s], `collision_passes` times a frame, from x and v."""

    def reset(self) -> None:
        """Forget contacts and grasps."""

    def warm_up(self) -> None:
        """Compile kernels that a frame may need later, by calls that change nothing."""

    @ti.func
    def evaluate(self, k):
        """Evaluate what element k of phase 0 needs of the committed state; before that phase, once a substep."""

    @ti.func
    def solve_phase(self, integrator: ti.template(), later: ti.template(), phase, k):
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


# Threads of a block. Taichi compiles for two blocks on a multiprocessor (minnctapersm), so that a thread of a block of
# 256 has 128 registers. With 512 threads it has 64, and the kernels keep most of their variables in memory.
BLOCK = 256
MAX_POLLS = 1 << 17  # of a probe: a tenth of a second, in which all blocks that find a place have long begun


def multiprocessors() -> int:
    """Number of multiprocessors of the first CUDA device."""
    cuda = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    count, device, MULTIPROCESSOR_COUNT = ctypes.c_int(), ctypes.c_int(), 16
    for call in (
        lambda: cuda.cuInit(0),
        lambda: cuda.cuCtxGetDevice(ctypes.byref(device)),
        lambda: cuda.cuDeviceGetAttribute(ctypes.byref(count), MULTIPROCESSOR_COUNT, device),
    ):
        status = call()
        if status != 0:
            raise RuntimeError(f"the CUDA driver says {status} when asked for its multiprocessors")
    return count.value


@ti.data_oriented
class PersistentGrid:
    """Grid of threads that stays on a CUDA device for many substeps: its blocks meet at barriers instead of ending.

    A launch costs about 5 us, a barrier among all blocks 1.2 us. All blocks must run at once, or the barrier would wait
    forever: one block always fits on a multiprocessor; whether more do, `probe` finds out.

    There are `per_multiprocessor` blocks of `block` threads for each; `begin` must run before the loop, in its kernel.
    On the CPU it is one block of one thread, which is a warp of its own: for tests. What is shared memory on CUDA,
    f32[words] and f64[points], then are `words` and `points`.
    """

    def __init__(self, words: int, points: int = 0, *, per_multiprocessor: int = 1):
        self.on_cuda = ti.cfg.arch == ti.cuda
        self.block, self.blocks = (BLOCK, per_multiprocessor * multiprocessors()) if self.on_cuda else (1, 1)
        self.warp = min(32, self.block)
        self.threads = self.blocks * self.block
        self.warps = self.threads // self.warp
        g = self._group = FieldGroup()
        self.arrived, self.released = (g.scalar(32, dtype=ti.i32) for _ in range(2))  # a cache line each
        self.missing = g.scalar(dtype=ti.i32)  # 1 if some blocks had to wait for others to end in a probe
        self.words, self.points = g.scalar(words), g.scalar(max(points, 1), dtype=ti.f64)
        g.build()

    @ti.func
    def begin(self):
        self.arrived[0], self.released[0] = 0, 0

    @ti.func
    def probe(self, thread):
        """Find out if all blocks run at once, on CUDA; nothing else may be done in that run.

        Whether they do depends on the registers and the shared memory of the kernel that calls this.
        """
        if thread % self.block == 0 and self.missing[None] == 0:
            ti.atomic_add(self.arrived[0], 1)
            polls = 0
            while polls < MAX_POLLS and ti.atomic_add(self.arrived[0], 0) < self.blocks:
                polls += 1
            if polls == MAX_POLLS:
                self.missing[None] = 1

    @ti.func
    def sync(self):
        """Wait for all threads of the block."""
        if ti.static(self.on_cuda):
            ti.simt.block.sync()

    @ti.func
    def meet(self, thread, rounds, counter: ti.template(), add: ti.template()):
        """Wait for all threads of all blocks, after `rounds` such barriers; the last to come adds to counter[None].

        Returns the number of barriers passed.
        """
        if ti.static(self.on_cuda):
            ti.simt.block.sync()
            if thread % self.block == 0:
                ti.simt.grid.memfence()
                if ti.atomic_add(self.arrived[0], 1) == (rounds + 1) * self.blocks - 1:
                    if ti.static(add != 0):
                        counter[None] += add
                        ti.simt.grid.memfence()
                    ti.atomic_add(self.released[0], 1)
                while ti.atomic_add(self.released[0], 0) <= rounds:
                    pass
                ti.simt.grid.memfence()
            ti.simt.block.sync()
        else:
            counter[None] += add
        return rounds + 1

    @ti.func
    def scattered(self, thread):
        """A number for each thread, such that the first ones are on different multiprocessors, then different warps.

        A few hundred rows in neighbouring threads would keep two multiprocessors busy and all others waiting.
        """
        block, warp, lane = thread // self.block, thread % self.block // self.warp, thread % self.warp
        last = self.block // self.warp - 1 - warp  # a block's first warps have the most vertices
        return (lane * (self.block // self.warp) + last) * self.blocks + block

    @ti.func
    def warp_index(self, thread):
        """Number of the warp of this thread, such that the first ones are on different multiprocessors."""
        return thread % self.block // self.warp * self.blocks + thread // self.block

    @ti.func
    def sum_lanes(self, value, lanes: ti.template()):
        """Sum of a float over each group of `lanes` neighbouring threads, in the first of them."""
        return sum_lanes(value, ti.static(lanes if self.on_cuda else 1))

    def destroy(self) -> None:
        self._group.destroy()


ALL_PASSES = 1 << 20  # more than there are


@ti.func
def commit(integrator: ti.template(), i, d):
    """Commit the increment d of vertex i; a vertex of a rigid body follows its pose instead.

    Returns the position [m], the velocity [m/s] and the prediction of the next increment [m].
    """
    s = integrator.state
    follows, x, v, predicted = False, d, d, d
    if ti.static(integrator.has_rigid):
        follows = integrator.rigid.kind[s.body_of_vertex[i]] != 0
        if follows:
            integrator.rigid.place_vertex(i)
            x, v, predicted = s.x[i], s.v[i], s.dx[i]
    if not follows:
        x, v, predicted = s.commit(i, d)
    return x, v, predicted


@ti.func
def any_active(integrator: ti.template()):
    """Return whether any constraint of a persistent kernel has an element; that changes only in a search."""
    active = False
    for c in ti.static(integrator.in_pairs):
        if c.any_active():
            active = True
    return active


@ti.func
def evaluate_candidates(integrator: ti.template(), thread):
    """Evaluate all constraints of a persistent kernel, spread over the threads of its grid."""
    for c in ti.static(integrator.in_pairs):
        k = integrator.grid.scattered(thread)
        while k < c.phase_count(0):
            c.evaluate(k)
            k += integrator.grid.threads


@ti.func
def solve_phases(integrator: ti.template(), thread, rounds, passes):
    """Solve the phases of a persistent kernel's constraints, at most 1 + `passes` of each, and meet after each of them.

    Returns `rounds` and the number of barriers passed.
    """
    s, passed = integrator.state, rounds
    for c in ti.static(integrator.in_pairs):
        solve_elements(integrator, c, 0, 0, thread)
        passed = integrator.grid.meet(thread, passed, s.substep_index, 0)
        if ti.static(len(c.phase_sizes) > 1):
            phase, end = 1, 1 + ti.min(ti.static(len(c.phase_sizes) - 1), passes)
            while phase < end:
                solve_groups(integrator, c, phase, thread)
                solve_elements(integrator, c, 1, phase, thread)
                passed = integrator.grid.meet(thread, passed, s.substep_index, 0)
                phase += 1
                if phase < end and not c.continues(phase):
                    phase = end
            release_groups(integrator, c, thread)
    return passed


@ti.func
def solve_elements(integrator: ti.template(), c: ti.template(), later: ti.template(), phase, thread):
    """Solve the elements of a phase, spread over the threads of the grid."""
    k, end = integrator.grid.scattered(thread), c.phase_count(later)
    while k < end:
        c.solve_phase(integrator, later, phase, k)
        k += integrator.grid.threads


@ti.func
def solve_groups(integrator: ti.template(), c: ti.template(), phase, thread):
    """Solve the groups of a phase, a warp each."""
    if ti.static(c.max_groups > 0):
        g = integrator.grid.warp_index(thread)
        while g < c.group_count():
            c.solve_group(phase, g, thread % integrator.grid.warp)
            g += integrator.grid.warps


@ti.func
def release_groups(integrator: ti.template(), c: ti.template(), thread):
    """End the sweep for all groups."""
    if ti.static(c.max_groups > 0):
        g = integrator.grid.warp_index(thread)
        while g < c.group_count():
            c.release_group(g)
            g += integrator.grid.warps


@ti.func
def own_vertices(integrator: ti.template(), thread):
    """First vertex and end of the equal part of all vertices that a thread of a persistent kernel steps through."""
    blocks, size, count = integrator.grid.blocks, integrator.grid.block, integrator.state.vertex_count[None]
    length = (count + blocks - 1) // blocks
    begin = thread // size * length
    return begin + thread % size, ti.min(begin + length, count)


def phase_kernels(s: State, integrator, c: Constraint, passes=(ALL_PASSES,)) -> list[list]:
    """The phases of constraint c as kernels of their own: a list for each of `passes`, the most after the first phase.

    With rigid bodies a single kernel for a CPU would take minutes to compile.
    """
    lanes = lane_count()

    @cache
    def kernel(phase: int, last: bool):
        @ti.kernel
        def run():
            if ti.static(phase > 0 and c.max_groups > 0):
                ti.loop_config(serialize=s.few)
                for k in range(c.group_count() * lanes):
                    c.solve_group(phase, k // lanes, k % lanes)
                    if ti.static(last):
                        c.release_group(k // lanes)
            ti.loop_config(serialize=s.few)
            for k in range(c.phase_count(ti.static(phase > 0))):
                c.solve_phase(integrator, ti.static(phase > 0), phase, k)

        return run

    lists = []
    for most in passes:
        end = min(1 + most, len(c.phase_sizes))
        lists.append([kernel(phase, phase == end - 1) for phase in range(end)])
    return lists


def evaluation_kernel(s: State, c: Constraint):
    """Kernel that evaluates all elements of constraint c."""

    @ti.kernel
    def evaluation():
        ti.loop_config(serialize=s.few)
        for k in range(c.phase_count(0)):
            c.evaluate(k)

    return evaluation
