"""Which static shapes each contact sample is near, and what they do to it.

A vertex meets them at once and exactly, one after the other; a point on a triangle becomes a row (sim/contact/constraints.py).
"""

import taichi as ti

from sim.contact.constraints import ContactConstraints
from sim.contact.contact_forces import ContactForces
from sim.contact.contact_samples import ContactSamples
from sim.contact.device_grids import FAR, corner
from sim.contact.response import FIRM, least, respond, respond_metric
from sim.contact.static_shapes import StaticShapes
from sim.state import State

NEAR = 8  # static shapes that one sample can be near at once; of more, the nearest count


@ti.data_oriented
class StaticContact:
    """near i32[P,8]: shapes near sample p, near_count i32[P]. `paces` f32[B] [m/s] are those of sim/contact/broad_phase.py."""

    def __init__(
        self,
        state: State,
        samples: ContactSamples,
        colliders: StaticShapes,
        rows: ContactConstraints,
        forces: ContactForces,
        paces,
    ):
        self.state, self.samples, self.colliders, self.rows, self.forces = state, samples, colliders, rows, forces
        self.paces = paces
        self.near, self.near_count = ti.field(ti.i32), ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, samples.capacity).dense(ti.j, NEAR).place(self.near)
        self.builder.dense(ti.i, samples.capacity).place(self.near_count)
        self.tree = self.builder.finalize()

    def clear(self) -> None:
        self.near_count.fill(0)

    @ti.func
    def find(self, p, shapes):
        """List which of the first `shapes` shapes sample p can touch before the next search; how many."""
        margin = self.paces[self.samples.body[p]] * self.state.detect_dt[None]
        x, n = self.samples.blend(p, self.state.x), 0
        for k in range(shapes):
            if self.colliders.within(k, x, margin - self.samples.skin[p]):
                if n < NEAR:
                    self.near[p, n] = k
                    n += 1
                else:
                    self._replace(p, k, x)
        self.near_count[p] = n
        return n

    @ti.func
    def _replace(self, p, k, x):
        """Of sample p's full list, let shape k take the place of the farthest, if that is farther than k."""
        most, _ = self.colliders.distance(k, x)
        place = -1
        for j in range(NEAR):
            phi, _ = self.colliders.distance(self.near[p, j], x)
            if phi > most:
                most, place = phi, j
        if place >= 0:
            self.near[p, place] = k

    @ti.func
    def push_out(self, i, dx, first: ti.template()):
        """The increment dx of vertex i [m] with what the shapes near it add; the rows push as in the last sweep."""
        s, d = self.state, dx
        p = self.samples.of_vertex[i]
        later = ti.static(0 if first else 1)  # what the first sweep looked at is put off to the next substep at least
        if p >= 0 and self.near_count[p] > 0 and s.substep_index[None] + later >= self.rows.wake[p]:
            y = d - s.x_lo[i] + self.rows.last[i]
            clear, push = FAR, corner(0.0)
            for k in range(self.near_count[p]):
                shape = self.near[p, k]
                phi, n = self.colliders.distance(shape, s.x[i])
                if phi >= 0.5 * FAR:
                    clear = 0.0  # a grid that says nothing here may say something in a moment
                else:
                    phi += self.samples.skin[p] + n.dot(s.x_lo[i])
                    mu = ti.sqrt(s.frictions(self.samples.body[p]) * self.colliders.friction[shape])
                    c = respond(phi, n, y, mu, s.dt[None])
                    y += c
                    push += c
                    clear = ti.min(clear, phi)
            d += push
            self.forces.note(i, push, first)
            self.rows.rest(p, clear, self.paces[self.samples.body[p]])
        return d

    @ti.func
    def push_out_metric(self, i, dx, H, A, prior):
        """Vertex i out of all shapes near it in the metric of H = A^-1; the force of that [N], and how it yields [N/m].

        prior [N]: that force in the last sweep.
        """
        s = self.state
        d, reaction, hold = dx, ti.Vector([0.0, 0.0, 0.0]), 0.0
        p = self.samples.of_vertex[i]
        if p >= 0 and self.near_count[p] > 0 and s.substep_index[None] + 1 >= self.rows.wake[p]:  # every sweep
            clear = FAR
            firm = FIRM * s.body_mass[self.samples.body[p]] / s.dt[None] ** 2
            for k in range(self.near_count[p]):
                shape = self.near[p, k]
                phi, n = self.colliders.distance(shape, s.x[i])
                if phi >= 0.5 * FAR:
                    clear = 0.0
                else:
                    phi += self.samples.skin[p] + n.dot(s.x_lo[i])
                    mu = ti.sqrt(s.frictions(self.samples.body[p]) * self.colliders.friction[shape])
                    y = d - s.x_lo[i]
                    c, force = respond_metric(phi, n, y, mu, s.dt[None], H, A, prior, firm)
                    if force.norm_sqr() > 0.0:
                        d += c
                        reaction += force
                        lacking = least(phi, s.dt[None]) - n.dot(y)
                        hold = ti.max(hold, ti.min(n.dot(H @ n), n.dot(force) / lacking))
                    clear = ti.min(clear, phi)
            self.forces.note(i, s.dt[None] ** 2 / s.mass[i] * reaction, True)
            self.rows.rest(p, clear, self.paces[self.samples.body[p]])
        return d, reaction, hold

    @ti.func
    def meet(self, p):
        """Take the row of a point on a triangle anew, against the nearest of the shapes near it."""
        s = self.state
        x = self.samples.blend(p, s.x)
        phi, normal, friction = FAR, corner(0.0), 0.0
        for k in range(self.near_count[p]):
            shape = self.near[p, k]
            d, n = self.colliders.distance(shape, x)
            if d < phi:
                phi, normal, friction = d, n, self.colliders.friction[shape]
        usable = phi < 0.5 * FAR
        if usable:
            phi += self.samples.skin[p] + normal.dot(self.samples.blend(p, s.x_lo))
            body = self.samples.body[p]
            self.rows.set(p, phi, normal, ti.sqrt(friction * s.frictions(body)), self.paces[body])
        return usable

    def destroy(self) -> None:
        self.tree.destroy()
