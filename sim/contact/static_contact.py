"""Narrow phase against static shapes: the shapes that each contact sample is near, and what they do to it.

A vertex meets them at once and exactly, one after the other; a point on a triangle becomes a contact constraint
(sim/contact/constraints.py).
"""

from typing import TYPE_CHECKING

import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup
from sim.contact.response import CONTACT_STIFFNESS, contact_impulse, isotropic_contact_impulse, min_normal_motion
from sim.contact.signed_distance import UNKNOWN_DISTANCE, known

if TYPE_CHECKING:
    from sim.contact.constraints import ContactConstraints, ContactForces
    from sim.state import State

MAX_NEAR = 8  # static shapes that one sample can be near at once; of more, the nearest count


@ti.data_oriented
class StaticContact:
    """near i32[P,8]: shapes near sample p, near_count i32[P].

    Of a substep of VBD: contact_count i32[P], shapes that sample p may touch, and of each phi f32[P,8] [m], normal
    vec3[P,8], friction vec2[P,8] = (mu_s, mu_k). The sweeps read these: they are the same in all of them.
    """

    def __init__(
        self, state: "State", samples, shapes, bounds, constraints: "ContactConstraints", forces: "ContactForces"
    ):
        self.state, self.samples, self.shapes, self.bounds = state, samples, shapes, bounds
        self.constraints, self.forces = constraints, forces
        group = self._group = FieldGroup()
        self.near = group.scalar(samples.capacity, MAX_NEAR, dtype=ti.i32)
        self.near_count = group.scalar(samples.capacity, dtype=ti.i32)
        self.contact_count = group.scalar(samples.capacity, dtype=ti.i32)
        with group.interleaved(samples.capacity, MAX_NEAR):
            self.phi, self.normal, self.friction = group.scalar(), group.vector(), group.vector(n=2)
        group.build()

    def clear(self) -> None:
        """Forget all contacts."""
        self.near_count.fill(0)
        self.contact_count.fill(0)

    @ti.func
    def find(self, p, count):
        """List which of the first `count` shapes sample p can touch before the next search; returns their number."""
        margin = self.bounds.max_speed[self.samples.body[p]] * self.state.detect_dt[None]
        x, n = self.samples.blend(p, self.state.x), 0
        for k in range(count):
            if known(self.shapes.distance_within(k, x, margin - self.samples.skin[p])):
                if n < MAX_NEAR:
                    self.near[p, n] = k
                    n += 1
                else:
                    self._replace_farthest(p, k, x)
        self.near_count[p] = n
        return n

    @ti.func
    def _replace_farthest(self, p, k, x):
        """In sample p's full list, let shape k take the place of the farthest, if that is farther than k."""
        most, _ = self.shapes.distance(k, x)
        slot = -1
        for j in range(MAX_NEAR):
            phi, _n = self.shapes.distance(self.near[p, j], x)
            if phi > most:
                most, slot = phi, j
        if slot >= 0:
            self.near[p, slot] = k

    @ti.func
    def _contact(self, i, p, shape):
        """Distance [m], maybe unknown, normal and friction of vertex i, which is sample p, and a shape."""
        s = self.state
        phi, n = self.shapes.distance(shape, s.x[i])
        friction = ti.sqrt(s.frictions(self.samples.body[p]) * self.shapes.friction[shape])
        if known(phi):
            phi += self.samples.skin[p] + n.dot(s.x_lo[i])
        return phi, n, friction

    @ti.func
    def project_vertex(self, i, dx, first: ti.template()):
        """The increment dx of vertex i [m], moved out of all shapes near it; constraints push as in the last sweep."""
        s, d = self.state, dx
        p = self.samples.of_vertex[i]
        later = ti.static(0 if first else 1)  # what the first sweep checked is postponed to the next substep at least
        if p >= 0 and self.near_count[p] > 0 and s.substep_index[None] + later >= self.constraints.next_check[p]:
            y = d - s.x_lo[i] + self.constraints.last_correction[i]
            clearance, correction = UNKNOWN_DISTANCE, vec3(0.0)
            for k in range(self.near_count[p]):
                phi, n, friction = self._contact(i, p, self.near[p, k])
                if known(phi):
                    holding = min_normal_motion(phi, s.dt[None]) * n - y
                    c = isotropic_contact_impulse(holding, n, 1.0, friction, s.dt[None])
                    y += c
                    correction += c
                    clearance = ti.min(clearance, phi)
                else:
                    clearance = 0.0  # a grid that has no distance here may have one in a moment
            d += correction
            self.forces.add(i, correction, first)
            self.constraints.postpone(p, clearance, self.bounds.max_speed[self.samples.body[p]])
        return d

    @ti.func
    def evaluate_vertex(self, i):
        """Find the distances of vertex i to all shapes near it, for the sweeps of a substep of VBD."""
        s = self.state
        p = self.samples.of_vertex[i]
        if p >= 0:
            count = 0
            if self.near_count[p] > 0 and s.substep_index[None] >= self.constraints.next_check[p]:
                clearance = UNKNOWN_DISTANCE
                for k in range(self.near_count[p]):
                    phi, n, friction = self._contact(i, p, self.near[p, k])
                    if known(phi):
                        self.phi[p, count], self.normal[p, count], self.friction[p, count] = phi, n, friction
                        clearance = ti.min(clearance, phi)
                        count += 1
                    else:
                        clearance = 0.0  # a grid that has no distance here may have one in a moment
                self.constraints.postpone(p, clearance, self.bounds.max_speed[self.samples.body[p]])
            if count == 0 and self.contact_count[p] > 0:
                self.forces.clear(i)
            self.contact_count[p] = count

    @ti.func
    def project_vertex_metric(self, i, dx, H, A, prior):
        """The increment dx of vertex i [m] moved out of all shapes near it in the metric of H = A^-1.

        prior [N]: the contact force of the last sweep. Returns also the force now [N], and its stiffness [N/m].
        """
        s = self.state
        d, force, stiffness = dx, vec3(0.0), 0.0
        p = self.samples.of_vertex[i]
        if p >= 0 and self.contact_count[p] > 0:
            contact_stiffness = CONTACT_STIFFNESS * s.body_mass[self.samples.body[p]] / s.dt[None] ** 2
            for k in range(self.contact_count[p]):
                n = self.normal[p, k]
                y, A_n = d - s.x_lo[i], A @ n
                y_n, w_n = n.dot(y), n.dot(A_n)
                lacking = min_normal_motion(self.phi[p, k], s.dt[None]) - y_n
                if lacking > 0.0:
                    most = ti.max(n.dot(prior), 0.0) + contact_stiffness * lacking
                    holding = H @ (ti.min(lacking, w_n * most) * n - (y - y_n * n))
                    f = contact_impulse(holding, n, A_n, A.trace() / 3.0, self.friction[p, k], s.dt[None])
                    d += A @ f
                    force += f
                    stiffness = ti.max(stiffness, ti.min(n.dot(H @ n), n.dot(f) / lacking))
            self.forces.add(i, s.dt[None] ** 2 / s.mass[i] * force, True)
        return d, force, stiffness

    @ti.func
    def evaluate(self, p):
        """Update the constraint of a point on a triangle, against the nearest shape; whether that has a distance."""
        s = self.state
        x = self.samples.blend(p, s.x)
        phi, normal, friction = UNKNOWN_DISTANCE, vec3(0.0), 0.0
        for k in range(self.near_count[p]):
            shape = self.near[p, k]
            d, n = self.shapes.distance(shape, x)
            if d < phi:
                phi, normal, friction = d, n, self.shapes.friction[shape]
        usable = known(phi)
        if usable:
            phi += self.samples.skin[p] + normal.dot(self.samples.blend(p, s.x_lo))
            body = self.samples.body[p]
            mu = ti.sqrt(friction * s.frictions(body))
            self.constraints.set_contact(p, phi, normal, mu, self.bounds.max_speed[body])
        return usable
