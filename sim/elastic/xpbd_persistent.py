"""XPBD substeps on CUDA as one kernel that stays: the equations of sim/elastic/xpbd.py.

A substep without contact is one barrier: each block projects the tets of its patches (sim/elastic/patches.py) into
shared memory, then moves its vertices. Other backends replay loops, and tests compare the two.
"""

import taichi as ti

from sim.constraint import Constraint
from sim.elastic.patches import SHARED_WORDS, Patches
from sim.elastic.persistent_grid import PersistentGrid
from sim.elastic.substep import ALL_PASSES, any_active, commit, evaluate_candidates, own_vertices, solve_phases
from sim.model import Model
from sim.state import State


@ti.data_oriented
class PersistentXPBD:
    """`run(n)` makes n substeps of one sweep each."""

    max_substeps = 128  # behind one call: damping acts between calls
    warm_started, iterations = False, 1

    def __init__(self, state: State, constraints: list[Constraint], rigid):
        self.state, self.grid = state, PersistentGrid(SHARED_WORDS)
        self.rigid, self.has_rigid = rigid, rigid is not None
        self.patches = Patches(state, self.grid.blocks)
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
                    d = c.project_vertex(i, d, True)
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

    def destroy(self) -> None:
        self.grid.destroy()
        self.patches.destroy()
