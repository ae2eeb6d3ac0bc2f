"""Prescribed vertices that are moved: in each frame to given places, evenly over its substeps.

Vertices with w = 0 move on at their v (sim/elastic/xpbd.py), so all there is to do is to set v = (target - x) / frame
before the first substep, and v = 0 after the last one: then they stand still, exactly at the target but for rounding.
"""

import numpy as np
import taichi as ti

from sim.state import State


@ti.data_oriented
class KinematicTargets:
    """target vec3[V] [m]: where each vertex is to be;   wanted i32[V]: 1 if it is driven in this frame."""

    def __init__(self, state: State):
        self.state = state
        self.target, self.wanted = ti.Vector.field(3, ti.f32), ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, state.V).place(self.target)
        self.builder.dense(ti.i, state.V).place(self.wanted)
        self.tree = self.builder.finalize()
        self.busy = False
        self.bodies: set[int] = set()  # whose vertices are driven in this frame

    def drive(self, vertices: np.ndarray, targets: np.ndarray) -> None:
        """Move these vertices (n,), global indices, to targets (n, 3) [m] in the next frame."""
        if len(vertices):
            self._set(np.ascontiguousarray(vertices, np.int32), np.ascontiguousarray(targets, np.float32))
            self.busy = True

    def drive_range(self, first: int, last: int) -> None:
        """Move the prescribed ones of vertices first..last-1 to what is in `target` when the next frame begins."""
        self._mark(first, last)
        self.busy = True

    def begin_frame(self, dt: float) -> None:
        """Start for a frame of dt [s]."""
        if self.busy:
            self._start(dt)

    def end_frame(self) -> None:
        """Stand still."""
        if self.busy:
            self._stop()
        self.busy = False
        self.bodies.clear()

    def reset(self) -> None:
        """Forget what is to be driven."""
        if self.busy:
            self._stop()
        self.busy = False
        self.bodies.clear()

    @ti.kernel
    def _set(self, vertices: ti.types.ndarray(ti.i32, 1), targets: ti.types.ndarray(ti.f32, 2)):
        for k in range(vertices.shape[0]):
            self.target[vertices[k]] = ti.Vector([targets[k, c] for c in range(3)])
            self.wanted[vertices[k]] = 1

    @ti.kernel
    def _mark(self, first: ti.i32, last: ti.i32):
        for i in range(first, last):
            self.wanted[i] = 1 if self.state.inv_mass[i] == 0.0 else 0

    @ti.kernel
    def _start(self, dt: ti.f32):
        s = self.state
        for i in range(s.V):
            if self.wanted[i] != 0:
                s.v[i] = ((self.target[i] - s.x[i]) - s.x_lo[i]) / dt
                s.v_lo[i] = 0.0

    @ti.kernel
    def _stop(self):
        for i in range(self.state.V):
            if self.wanted[i] != 0:
                self.state.v[i] = 0.0
                self.wanted[i] = 0

    def destroy(self) -> None:
        self.tree.destroy()
