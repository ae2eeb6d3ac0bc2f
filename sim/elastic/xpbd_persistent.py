"""The substep on CUDA as one kernel that stays: its blocks meet at barriers instead of ending (MATH: same equations).

A launch costs about 5 us, a barrier among all blocks 1.2 us, and a substep has one to five of them. All blocks must
run at once: there is one for each multiprocessor, of a size that always fits. Other backends replay the same functions
as loops (sim/elastic/xpbd.py), and tests compare the two.
"""

import ctypes
import sys

import taichi as ti

from core.fields import FieldGroup
from sim.constraint import Constraint
from sim.elastic.vertex_gather import VertexGather
from sim.model import Model
from sim.state import State

BLOCK = 512  # threads: at most 128 registers each, so that one block fits on any multiprocessor
LANES_PER_VERTEX = 8  # threads that share the tets of a vertex


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
class PersistentXPBD:
    """`run(n)` makes n substeps of one sweep each."""

    max_substeps = 128  # behind one call: damping acts between calls
    warm_started, iterations = False, 1

    def __init__(self, state: State, constraints: list[Constraint]):
        self.state, self.gather = state, VertexGather(state)
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        self.effective_inv_mass = state.inv_mass
        self.blocks = multiprocessors()
        self.threads = self.blocks * BLOCK
        g = self._group = FieldGroup()
        self.arrived, self.released = (g.scalar(32, dtype=ti.i32) for _ in range(2))  # a cache line each
        g.build()

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.gather.load(model)

    def run(self, substeps: int) -> None:
        self._run(substeps)

    def reset(self) -> None:
        """Nothing outlives a substep but what the state holds."""

    @ti.func
    def _meet(self, thread, round_, ends: ti.template()):
        """Wait for all threads of all blocks, for the round_-th time; the last to come `ends` the substep."""
        ti.simt.block.sync()
        if thread % BLOCK == 0:
            ti.simt.grid.memfence()
            if ti.atomic_add(self.arrived[0], 1) == round_ * self.blocks - 1:
                if ti.static(ends):
                    self.state.substep_index[None] += 1
                    ti.simt.grid.memfence()
                ti.atomic_add(self.released[0], 1)
            while ti.atomic_add(self.released[0], 0) < round_:
                pass
            ti.simt.grid.memfence()
        ti.simt.block.sync()

    @ti.func
    def _gathered(self, i, lane, parity):
        """Sum of the corrections of vertex i, complete in lane 0 of the LANES_PER_VERTEX threads that share it."""
        s = self.state
        g = self.gather
        total = ti.Vector([0.0, 0.0, 0.0])
        if i < s.vertex_count[None]:
            b = s.body_of_vertex[i]
            mu, lam = s.mu[b], s.lam[b]
            here = g.position[parity, i]
            k = g.begin[i] + lane
            while k < g.begin[i + 1]:
                total += g.correction(k, parity, here, mu, lam)
                k += LANES_PER_VERTEX
        for half in ti.static([LANES_PER_VERTEX >> (n + 1) for n in range(LANES_PER_VERTEX.bit_length() - 1)]):
            for c in ti.static(range(3)):
                total[c] += ti.simt.warp.shfl_down_f32(ti.u32(0xFFFFFFFF), total[c], half)
        return total

    @ti.kernel
    def _run(self, substeps: ti.i32):
        s = self.state
        g = self.gather
        self.arrived[0], self.released[0] = 0, 0
        s.substep_index[None] += 1
        for i in range(s.V):
            g.publish(i, 0)
        ti.loop_config(block_dim=BLOCK)
        for thread in range(self.threads):
            lane, parity, rounds = thread % LANES_PER_VERTEX, 0, 0
            paired = self._paired()
            begin, end = self._chunk(thread)
            for _ in range(substeps):
                if paired:
                    for c in ti.static(self.in_pairs):
                        k = self._scattered(thread)
                        while k < c.phase_count(0):
                            c.evaluate(k)
                            k += self.threads
                i = begin + thread % BLOCK // LANES_PER_VERTEX
                while i < end:
                    total = self._gathered(i, lane, parity)
                    if lane == 0 and i < s.vertex_count[None]:
                        d = s.dx[i]
                        if s.inv_mass[i] > 0.0:
                            d += s.inv_mass[i] * total
                            for c in ti.static(self.on_vertex):
                                d = c.project_vertex(i, d, True)
                        if paired:
                            s.dx[i] = d
                        else:
                            for c in ti.static(self.in_pairs):
                                d = c.apply_impulses(i, d)  # clears the sums of the last constraints
                            s.commit(i, d)
                            g.publish(i, 1 - parity)
                    i += BLOCK // LANES_PER_VERTEX
                if paired:
                    rounds = self._pairs(thread, rounds, parity)
                parity = 1 - parity
                rounds += 1
                self._meet(thread, rounds, True)
        s.substep_index[None] -= 1

    @ti.func
    def _scattered(self, thread):
        """A number for each thread, such that the first ones are on different multiprocessors, then different warps.

        A few hundred rows in neighbouring threads would keep two multiprocessors busy and all others waiting.
        """
        block, warp, lane = thread // BLOCK, thread % BLOCK // 32, thread % 32
        last = BLOCK // 32 - 1 - warp  # a block's first warps have the most vertices
        return (lane * (BLOCK // 32) + last) * self.blocks + block

    @ti.func
    def _chunk(self, thread):
        """The vertices of this thread's block: a run, so that its neighbours are mostly its own; of whole warps."""
        together = ti.static(32 // LANES_PER_VERTEX)
        length = (self.state.vertex_count[None] + self.blocks * together - 1) // (self.blocks * together) * together
        begin = thread // BLOCK * length
        return begin, begin + length

    @ti.func
    def _paired(self):
        """Return whether any constraint is active; that changes only in a search."""
        paired = False
        for c in ti.static(self.in_pairs):
            if c.any_active():
                paired = True
        return paired

    @ti.func
    def _pairs(self, thread, rounds, parity):
        """All stages of all pairs, then each vertex's commit; returns the number of barriers passed."""
        s = self.state
        passed = rounds
        for c in ti.static(self.in_pairs):
            for phase in ti.static(range(len(c.phase_sizes))):
                passed += 1
                self._meet(thread, passed, False)
                k, end = self._scattered(thread), c.phase_count(phase)
                while k < end:
                    c.solve_phase(self, phase, k, True)
                    k += self.threads
        passed += 1
        self._meet(thread, passed, False)
        begin, end = self._chunk(thread)
        i = begin + thread % BLOCK
        while i < ti.min(end, s.vertex_count[None]):
            d = s.dx[i]
            if s.inv_mass[i] > 0.0:
                for c in ti.static(self.in_pairs):
                    d = c.apply_impulses(i, d)
            s.commit(i, d)
            self.gather.publish(i, 1 - parity)
            i += BLOCK
        return passed

    def destroy(self) -> None:
        self._group.destroy()
        self.gather.destroy()
