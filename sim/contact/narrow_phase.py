"""Narrow phase: distance and normal of each contact sample near static shapes, and near deformable bodies."""

import taichi as ti
from taichi.math import vec3

from core.distance_grid import DistanceGrid
from core.fields import FieldGroup
from sim.contact.broad_phase import SelfCollision
from sim.contact.constraints import GENTLE, ContactConstraints, ContactForces
from sim.contact.contact_samples import ContactSamples, QueryPoints
from sim.contact.finger_capsules import MAX_SAMPLE_FORCE, YOUNG_PER_MU
from sim.contact.nearest_tet import NearestTets, rest_coordinates
from sim.contact.response import (
    CONTACT_STIFFNESS,
    contact_impulse,
    gentle_normal_motion,
    isotropic_contact_impulse,
    min_normal_motion,
)
from sim.contact.static_shapes import UNKNOWN_DISTANCE, DistanceGrids, grid_of, known
from sim.model import MAX_BODIES, Capacity, Model, fit
from sim.state import State

MAX_NEAR = 8  # static shapes that one sample can be near at once; of more, the nearest count
# Cosine of the surfaces' normals above which two surfaces do not face each other: a point that was forced right through
# a body may return through it. If it were held on the far side, entangled bodies would stay so.
MAX_FACING_COSINE = 0.3
NORMAL_STEPS = 2.0**20  # of a unit normal in integer sums, which do not depend on the order


@ti.data_oriented
class StaticContact:
    """The static shapes that each contact sample is near, and what they do to it.

    A vertex meets them at once and exactly, one after the other; a point on a triangle becomes a contact constraint
    (sim/contact/constraints.py).

    near i32[P,8]: shapes near sample p;   near_count i32[P]
    Of a substep of VBD, the same in all its sweeps: contact_count i32[P], shapes that sample p may touch, and of each
    phi f32[P,8] [m], normal vec3[P,8], friction vec2[P,8] = (mu_s, mu_k).
    """

    def __init__(self, samples: ContactSamples, shapes, bounds, constraints: ContactConstraints, forces: ContactForces):
        self.state, self.samples, self.shapes, self.bounds = samples.state, samples, shapes, bounds
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
        """Replace the farthest shape in sample p's full list by shape k, if k is nearer."""
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
        """Distance [m] (may be unknown), normal and friction of vertex i, which is sample p, against a shape."""
        s = self.state
        phi, n = self.shapes.distance(shape, s.x[i])
        friction = ti.sqrt(s.frictions(self.samples.body[p]) * self.shapes.friction[shape])
        if known(phi):
            phi += self.samples.skin[p] + n.dot(s.x_lo[i])
        return phi, n, friction

    @ti.func
    def project_vertex(self, i, dx):
        """The increment dx of vertex i [m], moved out of all shapes near it; constraints push as in the last sweep."""
        s, d = self.state, dx
        p = self.samples.of_vertex[i]
        if p >= 0 and self.near_count[p] > 0 and s.substep_index[None] >= self.constraints.next_check[p]:
            y = d - s.x_lo[i] + self.constraints.last_correction[i]
            clearance, correction, any_gentle = UNKNOWN_DISTANCE, vec3(0.0), False
            pushed = self.forces.correction[i].norm_sqr() > 0.0
            time = self.constraints.active[p] * s.dt[None]
            for k in range(self.near_count[p]):
                phi, n, friction = self._contact(i, p, self.near[p, k])
                if known(phi):
                    gentle = self.constraints.is_gentle(p, phi, pushed)
                    any_gentle = any_gentle or gentle
                    least = min_normal_motion(phi, s.dt[None])
                    if gentle:
                        least = gentle_normal_motion(phi, n.dot(y), time, s.dt[None])
                    holding = least * n - y
                    c = isotropic_contact_impulse(holding, n, 1.0, friction, s.dt[None])
                    y += c
                    correction += c
                    clearance = ti.min(clearance, phi)
                else:
                    clearance = 0.0  # a grid that has no distance here may have one in a moment
            d += correction
            self.forces.correction[i] = correction
            self.constraints.mark(p, False, any_gentle)
            self.constraints.postpone(p, clearance, self.bounds.max_speed[self.samples.body[p]])
        return d

    @ti.func
    def evaluate_vertex(self, i):
        """Find the distances of vertex i to all shapes near it, for the sweeps of a substep of VBD."""
        s = self.state
        p = self.samples.of_vertex[i]
        if p >= 0:
            count, any_gentle, pushed = 0, False, self.forces.correction[i].norm_sqr() > 0.0
            if self.near_count[p] > 0 and s.substep_index[None] >= self.constraints.next_check[p]:
                clearance = UNKNOWN_DISTANCE
                for k in range(self.near_count[p]):
                    phi, n, friction = self._contact(i, p, self.near[p, k])
                    if known(phi):
                        self.phi[p, count], self.normal[p, count], self.friction[p, count] = phi, n, friction
                        clearance = ti.min(clearance, phi)
                        any_gentle = any_gentle or self.constraints.is_gentle(p, phi, pushed)
                        count += 1
                    else:
                        clearance = 0.0  # a grid that has no distance here may have one in a moment
                self.constraints.postpone(p, clearance, self.bounds.max_speed[self.samples.body[p]])
            self.constraints.mark(p, False, any_gentle)
            if count == 0 and self.contact_count[p] > 0:
                self.forces.clear(i)
            self.contact_count[p] = count

    @ti.func
    def project_vertex_metric(self, i, dx, H, A, prior):
        """The increment dx of vertex i [m] moved out of all shapes near it in the metric of H = A^-1.

        prior [N]: the contact force of the last sweep. Returns also the force now [N], the stiffness along the normal
        [N/m], and the matrix K [N/m] of all: if dx changes by u, the force changes by -K u. Where it sticks, tangential
        motion is held; where it slides, friction changes with the normal force.

        A force whose normal part is larger than CONTACT_STIFFNESS allows is scaled as a whole: so it stays in Coulomb's
        cone, and still only takes energy. Were only the normal motion bounded, vertices of stiff bodies would jam: what
        stops one against the motion of its body presses it into the shape as well, so any force lies in the cone.
        """
        s = self.state
        d, force, stiffness, K = dx, vec3(0.0), 0.0, ti.Matrix.zero(ti.f32, 3, 3)
        p = self.samples.of_vertex[i]
        if p >= 0 and self.contact_count[p] > 0:
            gentle, time = self.constraints.active[p] >= GENTLE, self.constraints.active[p] * s.dt[None]
            contact_stiffness = CONTACT_STIFFNESS * s.body_mass[self.samples.body[p]] / s.dt[None] ** 2
            for k in range(self.contact_count[p]):
                n = self.normal[p, k]
                y, A_n, H_n = d - s.x_lo[i], A @ n, H @ n
                y_n = n.dot(y)
                lacking = min_normal_motion(self.phi[p, k], s.dt[None]) - y_n
                if gentle:
                    lacking = gentle_normal_motion(self.phi[p, k], y_n, time, s.dt[None]) - y_n
                if lacking > 0.0:
                    most = ti.max(n.dot(prior), 0.0) + contact_stiffness * lacking
                    holding = H @ (lacking * n - (y - y_n * n))
                    f = contact_impulse(holding, n, A_n, A.trace() / 3.0, self.friction[p, k], s.dt[None])
                    f *= ti.min(most / ti.max(n.dot(f), 1e-30), 1.0)
                    d += A @ f
                    force += f
                    f_n = n.dot(f)
                    if f_n > 0.0:
                        along = ti.min(n.dot(H_n), f_n / lacking)
                        stiffness = ti.max(stiffness, along)
                        K_k = along / f_n * f.outer_product(n)
                        if (f - holding).norm_sqr() == 0.0:  # along n n^T + (1 - n n^T) H (1 - n n^T)
                            K_k = H + ((n.dot(H_n) + along) * n - H_n).outer_product(n) - n.outer_product(H_n)
                        K += K_k - K_k @ (A @ K)  # what the contacts before it leave of u
            self.forces.correction[i] = s.dt[None] ** 2 / s.mass[i] * force
        return d, force, stiffness, K

    @ti.func
    def evaluate(self, p):
        """Update the constraint of a point on a triangle and the nearest shape; returns whether that has a distance."""
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


@ti.data_oriented
class DeformableContact:
    """Contact of points and tets of other bodies: constraint begin + p for point p of the QueryPoints.

    A sample in (or near) a tet of another body is pushed out along that body's distance grid. With barycentric weights
    b of the sample in the host tet, X = sum_j b_j X_j is where it sits in the host's rest shape. The rest distance
    phi_0 there and its gradient N give, with F = dx/dX of the tet,

        n = F^-T N / |F^-T N|,   F^-T N = sum_j grad b_j (X_j . N),   phi = phi_0 |N| / |F^-T N|

    and the contact acts on the sample with its weights, and on the tet's corners with -b.
    """

    def __init__(
        self, first: Model, points: QueryPoints, self_collision: SelfCollision | None, begin: int, capacity: Capacity
    ):
        self.self_collision, self.self_collides = self_collision, self_collision is not None
        self.state, self.samples, self.bounds, self.begin = points.state, points.samples, points.bounds, begin
        self.fingers, self.has_fingers, self.capsules = points.fingers, points.has_fingers, points.capsules
        self.rigid = first.rigid or capacity.rigid
        several = capacity.sized("bodies", first.sizes.bodies) > 1
        partners = several or self.capsules.size > 0 or self.self_collides or self.has_fingers
        self.needed = partners and (first.soft or capacity.grows)  # rigid bodies alone have no tets to be in
        self.grids = DistanceGrids(self._grids(first), capacity)
        self.hosts = NearestTets(points, self_collision)
        self.normals = VertexNormals(self.state)

    def _grids(self, model: Model) -> list[DistanceGrid]:
        return [s.once(grid_of) for s in model.shapes] if self.needed or self.rigid else []

    def check_capacity(self, model: Model) -> None:
        if model.soft:
            fit("bodies in contact", model.sizes.bodies, MAX_BODIES if self.needed else 1)
        if model.rigid:
            fit("rigid bodies", 1, int(self.rigid))
        self.grids.check_capacity(self._grids(model))

    def load(self, model: Model) -> None:
        """Take the grids and tets of these bodies."""
        if self.needed or self.rigid:
            self.grids.load(self._grids(model))
        if self.needed:
            self.hosts.load(model)

    @property
    def first_finger(self) -> int:
        """The first constraint of a finger."""
        return self.begin + (self.hosts.points.first_finger if self.needed else 0)

    @property
    def size(self) -> int:
        """Largest number of constraints."""
        return self.hosts.hash.points if self.needed else 0

    def detect(self, constraints: ContactConstraints) -> None:
        """Make candidates of points near a tet of another body; bounds and `normals` must be up to date."""
        if self.needed:
            self.hosts.find(constraints, self.begin)

    @ti.func
    def distance(self, t, x):
        """Signed distance of the body of tet t at a point x in or near it, by the equations above.

        Returns whether the tet has enough volume for that; phi [m], UNKNOWN_DISTANCE without a usable gradient, and n;
        the weights b in the tet; the rest position X [m], and how far [m] that is outside the body's grid.
        """
        phi, normal, beyond = UNKNOWN_DISTANCE, vec3(0.0), 0.0
        thick, b, X, G, E = rest_coordinates(self.state, t, x)
        if thick:
            rest_phi, N, beyond = self.grids.extrapolated(self.state.body_of_tet[t], X)
            gradient = G @ (E.transpose() @ N)
            length = gradient.norm()
            if known(rest_phi) and length > 0.0:
                phi, normal = rest_phi * N.norm() / length, gradient / length
        return thick, phi, normal, b, X, beyond

    @ti.func
    def evaluate(self, r, constraints: ti.template()):
        """Update constraint r's distance, normal and vertices; returns whether the host's grid has a distance there."""
        s = self.state
        p = r - self.begin
        sampled = p < self.samples.count[None]
        t = self.hosts.host[p]
        thick, phi, normal, b, X, beyond = self.distance(t, self.hosts.points.position(p, False))
        usable = constraints.active[r] != 0  # a tet crushed flat has no normal: its contact stays as it was
        if thick:
            host = s.body_of_tet[t]
            closing_speed = self.bounds.max_speed[host]
            usable = known(phi)
            if usable and sampled:
                closing_speed += self.bounds.max_speed[self.samples.body[p]]
                if beyond > 0.0:  # phi is an estimate there
                    usable = False
                    constraints.postpone(r, beyond, closing_speed)
                elif self.samples.blend(p, self.normals.normal).dot(normal) > MAX_FACING_COSINE:
                    usable = False
                    constraints.postpone(r, phi, closing_speed)
                if ti.static(self.self_collides):
                    min_distance = 0.5 * self.self_collision.min_rest_distance(host)
                    if usable and self.samples.body[p] == host:
                        closing_speed = self.self_collision.closing_speed(host)
                        distance = (X - self.samples.blend(p, s.rest)).norm()
                        if distance < min_distance:  # it is just where it belongs
                            usable = False
                            constraints.postpone(r, min_distance - distance, closing_speed)
            if ti.static(self.has_fingers):  # noqa: SIM102
                if self.hosts.points.is_finger(p):
                    closing_speed += self.fingers.speed_of(p - self.hosts.points.first_finger)
            self.hosts.host[p] = self.hosts.next_host(t, b)
            if usable:
                self._fill(r, p, t, b, phi, normal, closing_speed, constraints)
        return usable

    @ti.func
    def set_host(self, r, first, t, b, normal, constraints: ti.template()):
        """Make tet t, with weights b, the last vertices of row r; returns what their x_lo take of the distance [m]."""
        s = self.state
        a, weight, low = s.tets[t], ti.max(b, 0.0), 0.0
        weight /= weight.sum()
        for j in ti.static(range(4)):
            low += weight[j] * normal.dot(s.x_lo[a[j]])
            constraints.vertex[r, first + j], constraints.coefficient[r, first + j] = a[j], -weight[j]
        constraints.set_vertex_count(r, first + 4)
        return low

    @ti.func
    def _fill(self, r, p, t, b, distance, normal, closing_speed, constraints: ti.template()):
        """Write constraint r: point p at a distance [m] from the body of tet t, with weights b in the tet."""
        s = self.state
        host = s.body_of_tet[t]
        phi, friction, first = distance, s.frictions(host), 0
        if p < self.samples.count[None]:
            phi += self.samples.skin[p] + normal.dot(self.samples.blend(p, s.x_lo))
            friction *= s.frictions(self.samples.body[p])
            self.samples.set_vertices(p, r, constraints)
            first = 3
            if ti.static(constraints.coupled):
                body = self.samples.body[p]
                if constraints.rigid_bodies.kind[body] != 0:
                    constraints.set_body(r, 0, body, self.samples.blend(p, s.x), 1.0)
                    constraints.body_count[r], first = 1, 0
        elif self.hosts.points.is_finger(p):
            if ti.static(self.has_fingers):
                q = p - self.hosts.points.first_finger
                phi -= self.fingers.radius[q]  # skin has a coefficient of friction of 1
                softest = YOUNG_PER_MU * s.mu[host] * self.fingers.radius[q] ** 2
                self.fingers.set_push(r, q, ti.min(MAX_SAMPLE_FORCE, softest), constraints)
        else:
            k = p - self.samples.count[None]
            phi -= self.capsules.radius[k]
            friction *= self.capsules.friction[k]
        phi -= self.set_host(r, first, t, b, normal, constraints)
        constraints.set_contact(r, phi, normal, ti.sqrt(friction), closing_speed)


@ti.data_oriented
class VertexNormals:
    """Normals of the bodies' surfaces at their vertices, updated at each search.

    normal vec3[V]: unit mean of the normals of a vertex's triangles, 0 inside;   sum vec3i[V], in NORMAL_STEPS
    """

    def __init__(self, state: State):
        self.state, group = state, FieldGroup()
        with group.interleaved(state.V):
            self.normal, self.sum = group.vector(), group.vector(dtype=ti.i32)
        self._group = group
        group.build()

    @ti.func
    def update(self):
        """Normals at the positions as they are now. Outermost level of a kernel."""
        s = self.state
        for i in range(s.V):
            self.sum[i] = ti.Vector([0, 0, 0])
        for k in range(s.S):
            if k < s.triangle_count[None]:
                a = s.triangles[k]
                n = (s.x[a[1]] - s.x[a[0]]).cross(s.x[a[2]] - s.x[a[0]])
                length = n.norm()
                if length > 0.0:
                    step = ti.cast(n * (NORMAL_STEPS / length), ti.i32)
                    for j in ti.static(range(3)):
                        for axis in ti.static(range(3)):
                            ti.atomic_add(self.sum[a[j]][axis], step[axis])
        for i in range(s.V):
            n = ti.cast(self.sum[i], ti.f32)
            self.normal[i] = n / ti.max(n.norm(), 1.0)
