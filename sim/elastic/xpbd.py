"""The substep as a sequence of kernels, recorded once and replayed (see sim/state.py for its equations)."""

import taichi as ti

from core.fields import two_sum
from sim.elastic.energy import Elasticity
from sim.model import Model
from sim.rigid.rigid_motion import place
from sim.state import State


@ti.func
def predict(s: ti.template(), i):
    """dx = dt (v + dt g) + carry for a free vertex, dt v + carry for a prescribed one, which moves on at its v."""
    dt = s.dt[None]
    d = dt * s.v[i] + s.carry[i]
    if s.w[i] > 0.0:
        d = dt * (s.v[i] + (s.v_carry[i] + dt * s.gravity[None])) + s.carry[i]
    s.predicted[i] = d
    s.dx[i] = d


@ti.func
def commit(s: ti.template(), i, d):
    """Turn the final increment d of vertex i into its new velocity and position, and predict the next one."""
    rigid = False
    if ti.static(s.coupled):
        rigid = s.movers.kind[s.body_of_vertex[i]] != 0
        if rigid:
            place(s.movers, i)
    if not rigid:
        _commit(s, i, d)


@ti.func
def _commit(s: ti.template(), i, d):
    dt = s.dt[None]
    v, v_carry = s.v[i], s.v_carry[i]
    if s.w[i] > 0.0:
        gain = dt * s.gravity[None] + (d - s.predicted[i]) / dt
        v, v_carry = two_sum(v, v_carry + gain)
        speed, limit = v.norm(), s.reach[s.body_of_vertex[i]] / dt
        if speed > limit:
            v, v_carry = v * (limit / speed), 0.0 * v
        s.v[i], s.v_carry[i] = v, v_carry
    s.x[i], s.carry[i] = two_sum(s.x[i], dt * (v + v_carry) + s.carry[i])
    predict(s, i)


def jacobi(state: State, elastic: Elasticity, constraints: list, *, iterations: int):
    """Substeps in the form that suits the device: one kernel that stays on CUDA, where launches cost most."""
    if ti.cfg.arch == ti.cuda and iterations == 1 and not state.coupled:
        from sim.elastic.xpbd_persistent import PersistentXPBD

        return PersistentXPBD(state, constraints)
    return XPBDSubsteps(state, elastic, constraints, iterations=iterations)


class XPBDSubsteps:
    """Substeps of `iterations` sweeps each; `run(substeps)` replays several with one call from Python.

    One sweep: all tets; all vertices gather, and meet static shapes and hands; the constraints' pairs, and what these
    did to each vertex. What needs no loop of its own is fused: without pairs a substep of one sweep is two loops.
    """

    piece = 16  # substeps behind one call from Python, at most

    def __init__(self, state: State, elastic: Elasticity, constraints: list, *, iterations: int):
        self.state, self.elastic = state, elastic
        self.on_vertex = [c for c in constraints if c.has_vertex]
        self.in_pairs = [c for c in constraints if c.has_pairs]
        self.mobility, self.answers = state.w, False  # see State
        sweep = self.sweeps if state.coupled else lambda **when: [self.sweep(**when)]
        if iterations == 1:
            self.kernels = sweep(first=True, fused=True)
        else:  # two sweeps and the commit are compiled, instead of a third sweep that closes
            self.kernels = sweep(first=True, fused=False) + sweep(first=False, fused=False) * (iterations - 1)
            self.kernels.append(self.closing())
        self.graphs: dict[int, ti.graph.Graph] = {}

    def load(self, assembly: Model) -> None:
        """Take other bodies: all that these kernels read is the state's and the elements'."""

    def run(self, substeps: int) -> None:
        """Take so many substeps; each number has a graph of its own, of the same kernels, recorded in 0.3 ms."""
        if substeps not in self.graphs:
            graph = ti.graph.GraphBuilder()
            for kernel in self.kernels * substeps:
                graph.dispatch(kernel)
            self.graphs[substeps] = graph.compile()
        self.graphs[substeps].run({})

    def reset(self) -> None:
        """Nothing outlives a substep but what the state holds."""

    def sweep(self, *, first: bool, fused: bool):
        """A sweep as a kernel; `first` starts the multipliers and the substep, `fused` is its only one and commits."""
        s, e, on_vertex, in_pairs = self.state, self.elastic, self.on_vertex, self.in_pairs
        V, T = s.V, s.T
        tet_block, vertex_block = blocks(s, T), blocks(s, V)

        @ti.kernel
        def sweep():
            ti.loop_config(serialize=s.serial, block_dim=tet_block)
            for t in range(T):
                if t < s.tet_count[None]:
                    e.project_tet(t, first, fused)
                if ti.static(first) and t == 0:
                    s.tick[None] += 1
            ti.loop_config(serialize=s.serial, block_dim=vertex_block)
            for i in range(V):
                if i < s.vertex_count[None]:
                    d = s.dx[i]
                    if s.w[i] > 0.0:
                        d += e.summed(i)
                        for c in ti.static(on_vertex):
                            d = c.project_vertex(i, d, first)
                    if ti.static(fused and len(in_pairs) == 0):
                        commit(s, i, d)
                    else:
                        s.dx[i] = d
            for c in ti.static(in_pairs):
                for stage in ti.static(range(len(c.stage_sizes))):
                    block = ti.static(blocks(s, c.stage_sizes[stage]))
                    ti.loop_config(serialize=s.serial, block_dim=block)
                    for k in range(c.stage_sizes[stage]):
                        if ti.static(first and stage == 0):
                            c.look(k)
                        c.project_stage(stage, k, first)
            if ti.static(len(in_pairs) > 0):
                ti.loop_config(serialize=s.serial, block_dim=vertex_block)
                for i in range(V):
                    if i < s.vertex_count[None]:
                        d = s.dx[i]
                        if s.w[i] > 0.0:
                            for c in ti.static(in_pairs):
                                d = c.settle_vertex(i, d)
                        if ti.static(fused):
                            commit(s, i, d)
                        else:
                            s.dx[i] = d

        return sweep

    def sweeps(self, *, first: bool, fused: bool):
        """A sweep as several kernels: with rigid bodies, a single one would take minutes to compile."""
        s, e, on_vertex, in_pairs = self.state, self.elastic, self.on_vertex, self.in_pairs
        V, T = s.V, s.T

        @ti.kernel
        def begin():
            ti.loop_config(serialize=s.serial)
            for t in range(T):
                if t < s.tet_count[None]:
                    e.project_tet(t, first, fused)
                if ti.static(first) and t == 0:
                    s.tick[None] += 1
            ti.loop_config(serialize=s.serial)
            for i in range(V):
                if i < s.vertex_count[None] and s.w[i] > 0.0:
                    d = s.dx[i] + e.summed(i)
                    for c in ti.static(on_vertex):
                        d = c.project_vertex(i, d, first)
                    s.dx[i] = d

        @ti.kernel
        def end():
            ti.loop_config(serialize=s.serial)
            for i in range(V):
                if i < s.vertex_count[None]:
                    d = s.dx[i]
                    if s.w[i] > 0.0:
                        for c in ti.static(in_pairs):
                            d = c.settle_vertex(i, d)
                    if ti.static(fused):
                        commit(s, i, d)
                    else:
                        s.dx[i] = d

        return [begin, *(k for c in in_pairs for k in stages(s, c, first=first, look=first)), end]

    def closing(self):
        """The commit as a kernel of its own, after the last of several sweeps."""
        s = self.state

        @ti.kernel
        def close():
            ti.loop_config(serialize=s.serial)
            for i in range(s.V):
                if i < s.vertex_count[None]:
                    commit(s, i, s.dx[i])

        return close


def stages(s: State, c, *, first: bool, look: bool) -> list:
    """What constraint c looks at, if it does so now, and each of its stages, as kernels of their own."""

    @ti.kernel
    def see():
        ti.loop_config(serialize=s.serial)
        for k in range(c.stage_sizes[0]):
            c.look(k)

    def kernel(stage: int):
        @ti.kernel
        def run():
            ti.loop_config(serialize=s.serial)
            for k in range(c.stage_sizes[stage]):
                c.project_stage(stage, k, first)

        return run

    return [see] * look + [kernel(stage) for stage in range(len(c.stage_sizes))]


def blocks(s: State, n: int) -> int | None:
    """Block size of a loop over n, a power of two: warps on the GPU, two to four pieces for each CPU thread.

    None for a loop that runs serially.
    """
    if s.serial:
        return None
    cfg = ti.lang.impl.current_cfg()
    if cfg.arch == ti.cuda:
        return 128
    return max(64, 1 << (n // (2 * cfg.cpu_max_num_threads)).bit_length() - 1)
