"""Kinematic targets: prescribed vertices and kinematic rigid bodies are moved to given places by the end of a frame.

In between, positions are interpolated evenly over the substeps, with the velocity that friction feels; after the frame
they stand still, unless they are driven again. Vertices of inverse mass 0 move on at their v (sim/state.py), so it is
enough to set v = (target - x) / frame before the first substep, and v = 0 after the last one. `Skinning` computes the
places of vertices that follow a skeleton.
"""

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from core.vocabulary import IDENTITY
from sim.model import Model, body_index
from sim.rigid.rigid_bodies import RigidBodies
from sim.state import State


@ti.data_oriented
class KinematicTargets:
    """target vec3[V]: place of each vertex at the end of the next frame [m];   driven i32[V]: 1 if it goes there."""

    def __init__(self, state: State, rigid: RigidBodies | None):
        self.state, self.rigid = state, rigid
        g = self._group = FieldGroup()
        self.target, self.driven = g.vector(state.V), g.scalar(state.V, dtype=ti.i32)
        g.build()
        self.bodies: set[int] = set()  # those whose vertices are driven in the next frame

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.model, self.vertex_begin = model, model.vertex_begin.tolist()

    def drive(self, body: int, position, rotation=IDENTITY) -> None:
        """Move a kinematic rigid body to x = R(rotation) rest + position."""
        body = body_index(body, self.model.bodies)
        if self.rigid is None:
            raise BadInput(f"{self.model.bodies[body].body.name}: only a kinematic rigid body can be driven")
        self.rigid.drive(body, position, rotation)

    def drive_vertices(self, body: int, vertices, positions) -> None:
        """Move pinned vertices (n,) of a soft body to positions (n, 3) [m]."""
        p = self.model.bodies[body_index(body, self.model.bodies)]
        name, n = p.body.name, len(p.inv_mass)
        vertices, x = np.asarray(vertices, np.int64).reshape(-1), np.asarray(positions, np.float64)
        if len(vertices) and not 0 <= vertices.min() <= vertices.max() < n:
            raise BadInput(f"{name}: driven vertices must be in 0..{n - 1}")
        if p.body.rigid or (p.inv_mass[vertices] > 0.0).any():
            raise BadInput(f"{name}: only pinned vertices of a soft body can be driven")
        if x.shape != (len(vertices), 3) or not np.isfinite(x).all():
            raise BadInput(f"{name}: targets of {len(vertices)} vertices must be finite and (n, 3), not {x.shape}")
        if len(vertices):
            self._set(np.ascontiguousarray(vertices + self.vertex_begin[body], np.int32), x.astype(np.float32))
            self.bodies.add(body)

    def drive_surface(self, body: int) -> None:
        """Move all pinned vertices of a body to what `target` holds when the next frame begins."""
        body = body_index(body, self.model.bodies)
        self._mark(self.vertex_begin[body], self.vertex_begin[body + 1])
        self.bodies.add(body)

    @property
    def driven_bodies(self) -> set[int]:
        """Bodies that are driven in the next frame, kinematic ones included."""
        return self.bodies if self.rigid is None else self.bodies | set(self.rigid.targets)

    def begin_frame(self, dt: float) -> None:
        """Set the vertices off for a frame of dt [s]."""
        if self.bodies:
            self._start(dt)

    def end_frame(self) -> None:
        """Let the vertices stand still, and forget their targets."""
        if self.bodies:
            self._stop()
        self.bodies.clear()

    @ti.kernel
    def _set(self, vertices: ti.types.ndarray(ti.i32, 1), targets: ti.types.ndarray(ti.f32, 2)):
        for k in range(vertices.shape[0]):
            self.target[vertices[k]] = ti.Vector([targets[k, c] for c in range(3)])
            self.driven[vertices[k]] = 1

    @ti.kernel
    def _mark(self, first: ti.i32, last: ti.i32):
        for i in range(first, last):
            self.driven[i] = 1 if self.state.inv_mass[i] == 0.0 else 0

    @ti.kernel
    def _start(self, dt: ti.f32):
        s = self.state
        for i in range(s.V):
            if self.driven[i] != 0:
                # in double precision: in single, fast-math folds x_lo into x
                s.v[i] = ti.cast(ti.cast(self.target[i], ti.f64) - s.x[i] - s.x_lo[i], ti.f32) / dt
                s.v_lo[i] = 0.0

    @ti.kernel
    def _stop(self):
        for i in range(self.state.V):
            if self.driven[i] != 0:
                self.state.v[i] = 0.0
                self.driven[i] = 0


@ti.data_oriented
class Skinning:
    """Linear blend skinning of the kinematic vertices of one body; its NumPy twin is `linear_blend_skinning`.

    x_i = sum_k w_ik  M_j(i,k)  X_i,    M = world_from_body  world_j  inverse_bind_j

    vertices  indices of the kinematic vertices, from the body's first, (D,)
    points    their rest positions [m], (D, 3)
    joints    that move each, (D, 4); weights of these, (D, 4)
    count     number of joints
    """

    def __init__(self, vertices, points, joints, weights, count: int):
        D, f = len(vertices), FieldGroup()
        self.index, self.joint = f.scalar(D, dtype=ti.i32), f.vector(D, n=4, dtype=ti.i32)
        self.point, self.weight = f.vector(D), f.vector(D, n=4)
        self.matrix = f.matrix(count, n=3, m=4)
        f.build()
        Upload([self.index, self.joint, self.point, self.weight])([vertices, joints, points, weights])

    def pose(self, matrices: np.ndarray, targets, first: int) -> None:
        """Out: positions [m] of the vertices in the field `targets`, vec3 (V,), by the joints' matrices (J, 4, 4).

        `first`: index of the body's first vertex among the solver's.
        """
        self._pose(np.ascontiguousarray(matrices[:, :3], np.float32), first, targets)

    @ti.kernel
    def _pose(self, matrices: ti.types.ndarray(ti.f32, 3), first: ti.i32, targets: ti.template()):
        for j in self.matrix:
            for a, b in ti.static(ti.ndrange(3, 4)):
                self.matrix[j][a, b] = matrices[j, a, b]
        for i in self.index:
            x = self.point[i]
            y = ti.Vector([0.0, 0.0, 0.0])
            for k in ti.static(range(4)):
                M = self.matrix[self.joint[i][k]]
                y += self.weight[i][k] * (M @ ti.Vector([x[0], x[1], x[2], 1.0]))
            targets[first + self.index[i]] = y
