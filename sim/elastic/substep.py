"""Parts of a substep that all integrators share."""

from functools import cache

import taichi as ti

from core.lanes import lane_count
from sim.constraint import Constraint
from sim.state import State

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
        for later in ti.static(range(min(len(c.phase_sizes), 2))):
            turns = 1
            if ti.static(later):
                turns = ti.min(ti.static(len(c.phase_sizes) - 1), passes)
            turn = 0
            while turn < turns:
                if ti.static(later and c.max_groups > 0):
                    g = integrator.grid.warp_index(thread)
                    while g < c.group_count():
                        c.solve_group(later + turn, g, thread % integrator.grid.warp)
                        g += integrator.grid.warps
                k, end = integrator.grid.scattered(thread), c.phase_count(later)
                while k < end:
                    c.solve_phase(integrator, later, later + turn, k, True)
                    k += integrator.grid.threads
                passed = integrator.grid.meet(thread, passed, s.substep_index, 0)
                turn += 1
                if ti.static(later):  # noqa: SIM102
                    if turn < turns and not c.continues(later + turn):
                        turn = turns
            if ti.static(later and c.max_groups > 0):
                g = integrator.grid.warp_index(thread)
                while g < c.group_count():
                    c.release_group(g)
                    g += integrator.grid.warps
    return passed


@ti.func
def own_vertices(integrator: ti.template(), thread):
    """First vertex and end of the equal part of all vertices that a thread of a persistent kernel steps through."""
    blocks, size, count = integrator.grid.blocks, integrator.grid.block, integrator.state.vertex_count[None]
    length = (count + blocks - 1) // blocks
    begin = thread // size * length
    return begin + thread % size, ti.min(begin + length, count)


def phase_kernels(s: State, integrator, c: Constraint, *, first: bool, passes=(ALL_PASSES,)) -> list[list]:
    """The phases of constraint c as kernels of their own: a list for each of `passes`, the most after the first phase.

    With rigid bodies a single kernel for a CPU would take minutes to compile.
    """
    lanes = lane_count()

    @cache
    def kernel(phase: int, last: bool):
        @ti.kernel
        def run():
            if ti.static(phase > 0 and c.max_groups > 0):
                ti.loop_config(serialize=s.serial)
                for k in range(c.max_groups * lanes):
                    if k // lanes < c.group_count():
                        c.solve_group(phase, k // lanes, k % lanes)
                        if ti.static(last):
                            c.release_group(k // lanes)
            ti.loop_config(serialize=s.serial)
            for k in range(c.phase_sizes[phase]):
                c.solve_phase(integrator, ti.static(phase > 0), phase, k, first)

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
        ti.loop_config(serialize=s.serial)
        for k in range(c.phase_sizes[0]):
            c.evaluate(k)

    return evaluation


def block_size(s: State, n: int) -> int | None:
    """Block size of a loop over n, a power of two: warps on the GPU, two to four blocks for each CPU thread.

    None for a loop that runs serially.
    """
    if s.serial:
        return None
    cfg = ti.lang.impl.current_cfg()
    if cfg.arch == ti.cuda:
        return 128
    return max(64, 1 << (n // (2 * cfg.cpu_max_num_threads)).bit_length() - 1)
