"""XPBD: a Jacobi sweep over all tets and vertices in each substep (VR-GS, Sec. 4.1; sim/elastic/energy.py).

On the CPU a sequence of kernels is recorded once and replayed, on CUDA one kernel stays for many substeps.
"""

import taichi as ti

from core.lanes import dealt
from core.runtime import Graph
from sim.elastic.energy import Elasticity
from sim.elastic.patches import SHARED_WORDS, Patches
from sim.elastic.substep import (
    ALL_PASSES,
    Constraint,
    PersistentGrid,
    any_active,
    commit,
    evaluate_candidates,
    evaluation_kernel,
    own_vertices,
    phase_kernels,
    solve_phases,
)
from sim.model import Model
from sim.state import State
from sim.time_step import SWEEPS


@ti.data_oriented
class XPBDSubsteps:
    """Substeps of one sweep each; `run(substeps)` replays several with one call from Python.

    begin     each tet writes its corrections; each vertex sums them, and meets static shapes and hands
    phases    of the constraints among vertices and bodies
    end       each vertex takes what the phases pushed, and is committed
    """

    max_substeps = 16  # behind one call
    warm_started, iterations = False, SWEEPS["xpbd"]
    patches = None  # its kernels read the rest shapes where plastic flow writes them

    def __init__(self, state: State, elasticity: Elasticity, constraints: list[Constraint], rigid):
        self.state, self.elasticity, self.rigid = state, elasticity, rigid
        self.has_rigid, self.effective_inv_mass = rigid is not None, state.inv_mass
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        self.kernels = self._kernels()
        self.graphs: dict[int, Graph] = {}

    def load(self, model: Model) -> None:
        """Take other bodies: the state and the elasticity hold all that these kernels read."""

    def run(self, substeps: int) -> None:
        """Take `substeps` substeps; each number has a graph of its own, of the same kernels, recorded in 0.3 ms."""
        if substeps not in self.graphs:
            self.graphs[substeps] = graph = Graph()
            for kernel in self.kernels * substeps:
                graph.launch(kernel)
        self.graphs[substeps].run()

    def reset(self) -> None:
        """Forget the last substep: nothing outlives it but what the state holds."""

    @ti.func
    def _begin(self):
        """Loops over tets and vertices. Outermost level of a kernel."""
        s = self.state
        s.substep_index[None] += 1
        ti.loop_config(serialize=s.serial)
        for k in range(s.tet_count[None]):
            t = dealt(k, s.tet_count[None])
            if s.awake_tet(t):
                self.elasticity.project_tet(t)
        ti.loop_config(serialize=s.few)
        for i in range(s.vertex_count[None]):
            if s.awake_vertex(i):
                d = s.dx[i]
                if s.inv_mass[i] > 0.0:
                    d += self.elasticity.correction(i)
                    for c in ti.static(self.on_vertex):
                        d = c.project_vertex(i, d)
                if ti.static(len(self.in_pairs) == 0):
                    commit(self, i, d)
                else:
                    s.dx[i] = d

    @ti.func
    def _end(self):
        """Loop over vertices. Outermost level of a kernel."""
        s = self.state
        ti.loop_config(serialize=s.few)
        for i in range(s.vertex_count[None]):
            if s.awake_vertex(i):
                d = s.dx[i]
                if s.inv_mass[i] > 0.0:
                    for c in ti.static(self.in_pairs):
                        d = c.apply_impulses(i, d)
                commit(self, i, d)

    def _kernels(self) -> list:
        """Kernels of a substep: one, or with rigid bodies several, as one would take minutes to compile for a CPU."""
        s, in_pairs = self.state, self.in_pairs

        @ti.kernel
        def substep():
            self._begin()
            for c in ti.static(in_pairs):
                for phase in ti.static(range(len(c.phase_sizes))):
                    ti.loop_config(serialize=s.few)
                    for k in range(c.phase_count(phase)):
                        if ti.static(phase == 0):
                            c.evaluate(k)
                        c.solve_phase(self, ti.static(phase > 0), phase, k)
            if ti.static(len(in_pairs) > 0):
                self._end()

        @ti.kernel
        def begin():
            self._begin()

        @ti.kernel
        def end():
            self._end()

        if not self.has_rigid:
            return [substep]
        kernels = [begin]
        for c in in_pairs:
            kernels += [evaluation_kernel(s, c), *phase_kernels(s, self, c)[0]]
        return [*kernels, end]


@ti.data_oriented
class PersistentXPBD:
    """The same substeps as one kernel that stays on CUDA; `run(n)` takes n of them.

    A substep without contact is one barrier: each block projects the tets of its patches (sim/elastic/patches.py) into
    shared memory, then moves its vertices. Other backends replay loops, and tests compare the two.
    """

    max_substeps = 128  # behind one call: damping acts between calls
    warm_started, iterations = False, SWEEPS["xpbd"]

    def __init__(self, state: State, elasticity: Elasticity, constraints: list[Constraint], rigid):
        self.state, self.grid = state, PersistentGrid(SHARED_WORDS)
        self.rigid, self.has_rigid = rigid, rigid is not None
        self.patches = Patches(state, elasticity, self.grid.blocks)
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        self.effective_inv_mass = state.inv_mass

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.patches.load(model)

    def run(self, substeps: int) -> None:
        self._run(substeps)

    def reset(self) -> None:
        """Nothing outlives a substep but what the state holds."""

    @ti.kernel
    def _run(self, substeps: ti.i32):
        s, p = self.state, self.patches
        self.grid.begin()
        s.substep_index[None] += 1
        for i in range(s.V):
            p.publish(i, s.x[i], s.v[i], s.dx[i], 0)
        ti.loop_config(block_dim=self.grid.block)
        for thread in range(self.grid.threads):
            if ti.static(self.grid.on_cuda):
                shared = ti.simt.block.SharedArray((SHARED_WORDS,), ti.f32)
                self._stay(thread, substeps, shared)
            else:
                self._stay(thread, substeps, self.grid.words)
        s.substep_index[None] -= 1

    @ti.func
    def _stay(self, thread, substeps, shared: ti.template()):
        """All substeps of one thread."""
        s, p, block = self.state, self.patches, ti.static(self.grid.block)
        own, parity, rounds, paired = thread % block, 0, 0, any_active(self)
        for _ in range(substeps):
            patch = thread // block
            while patch < p.count[None]:
                first = p.local_begin[patch]
                k, end = first + own, p.local_begin[patch + 1]
                while k < end:
                    p.stage(k, first, parity, shared)
                    k += block
                self.grid.sync()
                k, end = p.tet_begin[patch] + own, p.tet_begin[patch + 1]
                while k < end:
                    p.project(k, parity, shared)
                    k += block
                self.grid.sync()
                k, end = first + own, p.own_end[patch]
                while k < end:
                    self._move(k, parity, paired, shared)
                    k += block
                patch += self.grid.blocks
                if patch < p.count[None]:
                    self.grid.sync()
            if paired:
                evaluate_candidates(self, thread)
                rounds = self._pairs(thread, rounds, parity)
            parity = 1 - parity
            rounds = self.grid.meet(thread, rounds, s.substep_index, 1)

    @ti.func
    def _move(self, k, parity, paired, shared: ti.template()):
        """Move an own vertex of a patch by its corrections; without pairs, commit."""
        s, p = self.state, self.patches
        i = p.local[k]
        if s.awake_vertex(i):
            d = s.dx[i]
            if s.inv_mass[i] > 0.0:
                d += s.inv_mass[i] * p.gather(k, shared)
                for c in ti.static(self.on_vertex):
                    d = c.project_vertex(i, d)
            if ti.static(self.has_rigid) or paired:  # rigid bodies are always a pair of their own
                s.dx[i] = d
            else:
                for c in ti.static(self.in_pairs):
                    d = c.apply_impulses(i, d)  # clears the sums of the last constraints
                x, v, dx = s.commit(i, d)
                p.publish(i, x, v, dx, 1 - parity)

    @ti.func
    def _pairs(self, thread, rounds, parity):
        """All phases of all pairs, then each vertex's commit; returns the number of barriers passed."""
        s = self.state
        passed = solve_phases(self, thread, self.grid.meet(thread, rounds, s.substep_index, 0), ALL_PASSES)
        i, end = own_vertices(self, thread)
        while i < end:
            if s.awake_vertex(i):
                d = s.dx[i]
                if s.inv_mass[i] > 0.0:
                    for c in ti.static(self.in_pairs):
                        d = c.apply_impulses(i, d)
                x, v, dx = commit(self, i, d)
                self.patches.publish(i, x, v, dx, 1 - parity)
            i += self.grid.block
        return passed
