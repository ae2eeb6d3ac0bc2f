"""VBD substeps on CUDA as one kernel that stays (sim/elastic/substep.py): the equations of sim/elastic/vbd.py.

A colour is a barrier. Each block moves the vertices of its patches (sim/elastic/patches.py), several threads
each; then come the phases of the constraints, and the modal correction (sim/elastic/modal_correction.py).
"""

import taichi as ti

from core.fields import FieldGroup
from sim.elastic.energy import Elasticity
from sim.elastic.modal_correction import MODES, ModalCorrection
from sim.elastic.patches import LAG, LAM, MU, OTHERS, OWN, PLACES, POINTS, RESIDENT, WORDS, ColorPatches
from sim.elastic.substep import (
    ALL_PASSES,
    Constraint,
    PersistentGrid,
    any_active,
    evaluate_candidates,
    own_vertices,
    solve_phases,
)
from sim.elastic.vbd import EARLY_PASSES, VertexDescent
from sim.elastic.whole_bodies import WholeBodies
from sim.model import MAX_BODIES, Model
from sim.reductions import ReductionBlocks
from sim.state import State
from sim.time_step import SWEEPS

LANES = 8  # threads that share the tets of a vertex
ALL_COLORS = -1


@ti.data_oriented
class PersistentVBD:
    """`run(n)` takes n substeps of two sweeps each, if the grid `fits`."""

    max_substeps = 64  # behind one call
    warm_started, iterations = True, SWEEPS["vbd"]

    def __init__(
        self,
        state: State,
        elasticity: Elasticity,
        constraints: list[Constraint],
        rigid,
        blocks: ReductionBlocks,
        *,
        per_multiprocessor: int = 1,
    ):
        """per_multiprocessor: blocks for each; see `fits`."""
        self.state = state
        self.grid = PersistentGrid(WORDS, POINTS, per_multiprocessor=per_multiprocessor)
        self.lanes = min(LANES, self.grid.block)
        self.patches = ColorPatches(state, elasticity, self.grid.blocks)
        self.descent = d = VertexDescent(state, constraints, rigid)
        self.in_pairs, self.effective_inv_mass = d.in_pairs, d.effective_inv_mass
        self.whole = WholeBodies(state, blocks, d, self.grid.warp)
        self.modal = ModalCorrection(state, elasticity, blocks, d, self.grid.warp)
        g = self._group = FieldGroup()
        # Point of each body about which moments are summed: of the last substep, because x is just being moved
        self.origin = g.vector(MAX_BODIES)
        g.build()

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.patches.load(model)
        self.modal.load(model)

    def fits(self) -> bool:
        """Return whether all blocks run at once on this device; if not, `run` would never end."""
        self._run(0, 0)
        return self.grid.missing[None] == 0

    def run(self, substeps: int) -> None:
        self._run(substeps, self.patches.colors)

    def reset(self) -> None:
        """Forget the last substep: its accelerations and contacts."""
        self.descent.reset()

    @ti.kernel
    def _run(self, substeps: ti.i32, colors: ti.i32):
        s = self.state
        self.grid.begin()
        s.substep_index[None] += 1
        for i in range(s.V):
            if s.awake_vertex(i) and not any_active(self):  # the sums of the last constraints no longer act
                self.descent.release(i)
        for b in range(MAX_BODIES):
            if b < s.body_count[None]:
                self.origin[b] = s.x[s.vertex_begin[b]]
        self.patches.list_awake()
        ti.loop_config(block_dim=self.grid.block)
        for thread in range(self.grid.threads):
            if ti.static(self.grid.on_cuda):
                points = ti.simt.block.SharedArray((POINTS,), ti.f64)
                words = ti.simt.block.SharedArray((WORDS,), ti.f32)
                if substeps == 0:
                    self.grid.probe(thread)
                else:
                    self._stay(thread, substeps, colors, points, words)
            else:
                self._stay(thread, substeps, colors, self.grid.points, self.grid.words)
        s.substep_index[None] -= 1

    @ti.func
    def _stay(self, thread, substeps, colors, points: ti.template(), words: ti.template()):
        """All substeps of one thread: end one and begin the next, descend colour by colour, move along the modes.

        What a thread passes on is read after the next `meet` of all threads, or `sync` of its block.
        """
        s, p, blocks = self.state, self.patches, self.grid.blocks
        rounds, paired = 0, any_active(self)
        mine = (p.awake_count[None] - thread // self.grid.block + blocks - 1) // blocks  # patches of this block
        several = p.awake_count[None] > RESIDENT * blocks  # then they have to be fetched again and again
        self._enter(thread, 0, ti.min(mine, RESIDENT), colors, points, words)
        for n in range(substeps + 1):
            self._turn(thread, n > 0, n < substeps)
            rounds = self.grid.meet(thread, rounds, s.substep_index, 0)
            if n < substeps:
                self._find_contacts(thread, mine)
                self._stage(thread, mine, several, ALL_COLORS, points, words)
                if paired:
                    evaluate_candidates(self, thread)
                self._fit_rotations(thread)
                rounds = self._descend(thread, rounds, mine, several, paired, colors, points, words)
                rounds = self._correct(thread, rounds, mine, several, colors, points, words)

    @ti.func
    def _turn(self, thread, ends, begins):
        """End a substep, begin the next one: commit, predict; and the moments for rotations."""
        s, m = self.state, self.modal
        j, lane = self.grid.warp_index(thread), thread % self.grid.warp
        while j < m.blocks.begin[s.body_count[None]]:
            span = m.blocks.span[j]
            if not s.asleep[span[2]]:
                i = span[0] + lane
                while i < span[1]:
                    predicted = s.dx_predicted[i]
                    if ends:
                        predicted = self.descent.end(i, s.dx[i])
                    if begins:
                        self.descent.begin(i, predicted)
                    i += self.grid.warp
                if begins:
                    m.sum_moments(j, self.origin[span[2]], lane)
            j += self.grid.warps

    @ti.func
    def _fit_rotations(self, thread):
        """R of each body, by a warp each."""
        s, b = self.state, self.grid.warp_index(thread)
        while b < s.body_count[None]:
            self.origin[b] = s.x[s.vertex_begin[b]]  # all threads of the warp write the same
            self.modal.fit_rotation(b, thread % self.grid.warp)
            b += self.grid.warps

    @ti.func
    def _descend(self, thread, rounds, mine, several, paired, colors, points: ti.template(), words: ti.template()):
        """The sweeps: a barrier for each colour, then the phases of the constraints. Returns as `meet`."""
        passed = rounds
        for sweep in range(self.iterations):
            for turn in range(colors):
                color = turn if sweep % 2 == 0 else colors - 1 - turn  # there and back: no direction is favoured
                k = 0
                while k < mine:
                    here = self._turn_to(thread, k, mine, several, colors, points, words)
                    self._sweep(thread, here, color, points, words)
                    k += RESIDENT
                passed = self.grid.meet(thread, passed, self.state.substep_index, 0)
                self._stage(thread, mine, several, color, points, words)
            if paired:
                passed = self._balance(thread, passed)
                passed = self._pairs(thread, passed, sweep == self.iterations - 1)
                self._stage(thread, mine, several, ALL_COLORS, points, words)
        return passed

    @ti.func
    def _balance(self, thread, rounds):
        """Move bodies as wholes. Returns as `meet`."""
        s, whole = self.state, self.whole
        self._each_block(thread, whole.sum_block)
        passed = self.grid.meet(thread, rounds, s.substep_index, 0)
        b = self.grid.warp_index(thread)
        while b < s.body_count[None]:
            whole.solve(b, thread % self.grid.warp)
            b += self.grid.warps
        passed = self.grid.meet(thread, passed, s.substep_index, 0)
        i, end = own_vertices(self, thread)
        while i < end:
            if s.awake_vertex(i):
                whole.move(i)
            i += self.grid.block
        return self.grid.meet(thread, passed, s.substep_index, 0)

    @ti.func
    def _correct(self, thread, rounds, mine, several, colors, points: ti.template(), words: ti.template()):
        """The step along the modes, shortened, and then that of whole bodies. Returns as `meet`."""
        s, passed = self.state, rounds
        for trial in range(2):  # the residual before the step, then after it
            k = 0
            while k < mine:
                here = self._turn_to(thread, k, mine, several, colors, points, words)
                self._residual(thread, here, colors, trial, points, words)
                k += RESIDENT
            passed = self.grid.meet(thread, passed, s.substep_index, 0)
            if trial == 0:
                self._each_block(thread, self.modal.project)
                passed = self.grid.meet(thread, passed, s.substep_index, 0)
                bk = self.grid.warp_index(thread)
                while bk < s.body_count[None] * MODES:
                    self.modal.find_amplitude(bk, thread % self.grid.warp)
                    bk += self.grid.warps
                passed = self.grid.meet(thread, passed, s.substep_index, 0)
                self._each_block(thread, self._find_step)
                passed = self.grid.meet(thread, passed, s.substep_index, 0)
                self._each_block(thread, self._move)
                passed = self.grid.meet(thread, passed, s.substep_index, 0)
                self._stage(thread, mine, several, ALL_COLORS, points, words)
            else:
                self._each_block(thread, self.modal.sum_products)
                passed = self.grid.meet(thread, passed, s.substep_index, 1)
        self._each_block(thread, self._shorten)
        return self._balance(thread, passed)

    @ti.func
    def _each_block(self, thread, step: ti.template()):
        """Take a step of the modal correction for all blocks of vertices that are awake, by a warp each."""
        j, blocks = self.grid.warp_index(thread), self.modal.blocks
        while j < blocks.begin[self.state.body_count[None]]:
            if not self.state.asleep[blocks.span[j][2]]:
                step(j, thread % self.grid.warp)
            j += self.grid.warps

    @ti.func
    def _find_step(self, j, lane):
        """d of the vertices of block j, and its sums; each lane sums what it has written itself."""
        i = self.modal.blocks.span[j][0] + lane
        while i < self.modal.blocks.span[j][1]:
            self.modal.find_step(i)
            i += self.grid.warp
        self.modal.sum_products(j, lane)

    @ti.func
    def _move(self, j, lane):
        """Move the vertices of block j by the trial's step; all warps of a body find the same length of it."""
        m, span = self.modal, self.modal.blocks.span[j]
        b = m.find_trial(span[2], lane)
        if lane == 0 and j == m.blocks.begin[span[2]]:
            m.trial[span[2]] = b
        i = span[0] + lane
        while i < span[1]:
            m.move(i, b)
            i += self.grid.warp

    @ti.func
    def _shorten(self, j, lane):
        """Keep of the step of block j what its body may. Each lane sums in `_balance` what it has written itself."""
        m, span = self.modal, self.modal.blocks.span[j]
        kept = m.shortening(span[2], lane)
        i = span[0] + lane
        while i < span[1]:
            self.state.dx[i] += (kept - 1.0) * m.step[i]
            i += self.grid.warp

    @ti.func
    def _turn_to(self, thread, k, mine, several, colors, points: ti.template(), words: ti.template()):
        """Go on to the block's patches from number k on, and fetch them unless they are here; returns their number."""
        resident = ti.min(mine - k, RESIDENT)
        if several:
            self._enter(thread, k, resident, colors, points, words)
        return resident

    @ti.func
    def _enter(self, thread, k, resident, colors, points: ti.template(), words: ti.template()):
        """Fetch all of so many of the block's awake patches, from number k on, to shared memory."""
        p, block = self.patches, ti.static(self.grid.block)
        self.grid.sync()
        for r in range(resident):
            p.enter(
                p.awake[thread // block + (k + r) * self.grid.blocks], r, thread % block, block, colors, points, words
            )
        self.grid.sync()

    @ti.func
    def _stage(self, thread, mine, several, color, points: ti.template(), words: ti.template()):
        """Fetch the positions of the resident patches, unless they are fetched as a whole in each turn.

        Of ALL_COLORS those of all vertices, else of those of this colour that belong to other patches. Each patch has
        an equal share of the threads.
        """
        if not several:
            p, own, resident = self.patches, thread % self.grid.block, ti.min(mine, RESIDENT)
            share = self._share(self.grid.block, resident, 1)
            r = own // share
            while r < resident:
                begin, end = r * PLACES, r * PLACES + p.count_of(r, words)
                if color != ALL_COLORS:
                    begin, end = p.color_range(OTHERS, r, color, words)
                at = begin + own % share
                while at < end:
                    p.stage(at, r, points, words)
                    at += share
                r += self.grid.block // share
        self.grid.sync()

    @ti.func
    def _share(self, workers, resident, together: ti.template()):
        """Number of workers for each resident patch, a multiple of `together`."""
        return ti.max(workers // ti.max(resident, 1) // together, 1) * together

    @ti.func
    def _find_contacts(self, thread, mine):
        """Evaluate static contacts of the vertices of the block's own patches."""
        p, own, k = self.patches, thread % self.grid.block, 0
        while k < mine:
            resident = ti.min(mine - k, RESIDENT)
            share = self._share(self.grid.block, resident, 1)
            r = own // share
            while r < resident:
                patch = p.awake[thread // self.grid.block + (k + r) * self.grid.blocks]
                at = p.local_begin[patch] + own % share
                while at < p.own_end[patch]:
                    self.descent.find_contacts(p.local[at])
                    at += share
                r += self.grid.block // share
            k += RESIDENT

    @ti.func
    def _sweep(self, thread, resident, color, points: ti.template(), words: ti.template()):
        """Move the resident patches' own vertices of a colour."""
        p, groups = self.patches, ti.static(self.grid.block // self.lanes)
        share = self._share(groups, resident, ti.static(self.grid.warp // self.lanes))  # a warp has one patch
        group, lane = thread % self.grid.block // self.lanes, thread % self.lanes
        r = group // share
        while r < resident:
            begin, end = p.color_range(OWN, r, color, words)
            for turn in range((end - begin + share - 1) // share):  # as many for all threads of a warp
                at = begin + turn * share + group % share
                f, xx, yy = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
                i, mass = 0, 0.0
                x, v, dx, target, prior = f, f, f, f, f
                if at < end:
                    i = p.vertex(at, words)
                    x, v = self.state.x[i], self.state.v[i]
                    dx, target, prior, mass = self.descent.load(i)  # before the tets: the loads take a while
                    mu, lam = words[MU + r], words[LAM + r]
                    slot, last = p.slot(at, words) + lane, p.slot(at + 1, words)
                    while slot < last:
                        force, diagonal, c, _dJ, stiffness = p.terms(slot, r, mu, lam, points)
                        f += force
                        xx += diagonal + stiffness * c * c  # of H: xx, yy, zz, then xy, yz, zx
                        yy += stiffness * ti.Vector([c.x * c.y, c.y * c.z, c.z * c.x])
                        slot += self.lanes
                for c in ti.static(range(3)):
                    f[c] = self.grid.sum_lanes(f[c], self.lanes)
                    xx[c], yy[c] = self.grid.sum_lanes(xx[c], self.lanes), self.grid.sum_lanes(yy[c], self.lanes)
                if lane == 0 and at < end:
                    H = ti.Matrix([[xx[0], yy[0], yy[2]], [yy[0], xx[1], yy[1]], [yy[2], yy[1], xx[2]]])
                    d = self.descent.descend(i, dx, target, prior, mass, f, H)
                    p.put(at, x, self.state.lagging(d, v, words[LAG + r]), points)
            r += groups // share

    @ti.func
    def _residual(self, thread, resident, colors, trial, points: ti.template(), words: ti.template()):
        """Residual force of each of the resident patches' own vertices."""
        s, p, d, groups = self.state, self.patches, self.descent, ti.static(self.grid.block // self.lanes)
        share = self._share(groups, resident, ti.static(self.grid.warp // self.lanes))
        group, lane = thread % self.grid.block // self.lanes, thread % self.lanes
        r = group // share
        while r < resident:
            begin = r * PLACES
            _begin, end = p.color_range(OWN, r, colors - 1, words)
            for turn in range((end - begin + share - 1) // share):
                at = begin + turn * share + group % share
                f = ti.Vector([0.0, 0.0, 0.0])
                if at < end:
                    mu, lam = words[MU + r], words[LAM + r]
                    slot, last = p.slot(at, words) + lane, p.slot(at + 1, words)
                    while slot < last:
                        force, _diagonal, _c, dJ, _stiffness = p.terms(slot, r, mu, lam, points)
                        if dJ < -1.0:
                            s.inverted[s.body_of_vertex[p.vertex(at, words)]] = 1
                        f += force
                        slot += self.lanes
                for c in ti.static(range(3)):
                    f[c] = self.grid.sum_lanes(f[c], self.lanes)
                if lane == 0 and at < end:
                    i = p.vertex(at, words)
                    f += d.reaction[i] + s.mass[i] / s.dt[None] ** 2 * (d.target[i] - s.dx[i])
                    if s.inv_mass[i] == 0.0:
                        f = ti.Vector([0.0, 0.0, 0.0])
                    if trial == 0:
                        self.modal.force[i] = self.modal.rotation[s.body_of_vertex[i]].transpose() @ f
                    else:
                        self.modal.set_products(i, f)
            r += groups // share

    @ti.func
    def _pairs(self, thread, rounds, last):
        """Phases of all pairs, in the last sweep all of them, and each vertex's push; returns as `solve_phases`."""
        s = self.state
        passed = solve_phases(self, thread, rounds, ALL_PASSES if last else EARLY_PASSES)
        i, end = own_vertices(self, thread)
        while i < end:
            if s.awake_vertex(i):
                self.descent.push(i)
            i += self.grid.block
        return self.grid.meet(thread, passed, s.substep_index, 0)

    def destroy(self) -> None:
        for part in (self.grid, self.patches, self.descent, self.whole, self.modal, self._group):
            part.destroy()
