"""Narrow phase of deformable bodies: a sample in (or near) a tet of another body is pushed out along its distance grid.

With barycentric weights b of the sample in the host tet, X = sum_j b_j X_j is where it sits in the host's rest shape.
The rest distance phi_0 there and its gradient N give, with F = dx/dX of the tet,

    n = F^-T N / |F^-T N|,   F^-T N = sum_j grad b_j (X_j . N),   phi = phi_0 |N| / |F^-T N|

and the contact acts on the sample with its weights, and on the tet's corners with -b.
"""

from typing import TYPE_CHECKING

import taichi as ti
from taichi.math import vec3

from core.distance_grid import DistanceGrid
from core.fields import FieldGroup
from core.vocabulary import Capsule
from sim.contact.contact_samples import CapsuleSamples
from sim.contact.nearest_tet import NearestTets
from sim.contact.signed_distance import UNKNOWN_DISTANCE, DistanceGrids, grid_of, known
from sim.contact.tet_geometry import deformed_gradient, rest_coordinates
from sim.model import MAX_BODIES, Capacity, fit

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.contact.constraints import ContactConstraints
    from sim.contact.contact_samples import ContactSamples
    from sim.contact.self_collision import SelfCollision
    from sim.contact.static_shapes import Shape
    from sim.hands.finger_capsules import FingerCapsules
    from sim.model import Model
    from sim.state import State

# Cosine of the surfaces' normals above which two surfaces do not face each other: a point that was forced right through
# a body may return through it. If it were held on the far side, entangled bodies would stay so.
MAX_FACING_COSINE = 0.3
NORMAL_STEPS = 2.0**20  # of a unit normal in integer sums, which do not depend on the order


@ti.data_oriented
class DeformableContact:
    """Contact of points and tets of other bodies: constraint begin + p for point p of sim/contact/query_points.py."""

    def __init__(
        self,
        state: "State",
        first: "Model",
        samples: "ContactSamples",
        shapes: "list[Shape]",
        bounds: "BodyBounds",
        self_collision: "SelfCollision | None",
        begin: int,
        capacity: Capacity = Capacity(),
        fingers: "FingerCapsules | None" = None,
    ):
        self.self_collision, self.self_collides = self_collision, self_collision is not None
        self.state, self.samples, self.bounds, self.begin = state, samples, bounds, begin
        self.fingers, self.has_fingers = fingers, fingers is not None
        self.capsules = CapsuleSamples([s for s in shapes if isinstance(s, Capsule)], samples.spacing)
        self.rigid = first.rigid or capacity.rigid
        several = capacity.sized("bodies", first.sizes.bodies) > 1
        partners = several or self.capsules.size > 0 or self.self_collides or self.has_fingers
        self.needed = partners and (first.soft or capacity.grows)  # rigid bodies alone have no tets to be in
        self.grids = DistanceGrids(self._grids(first), capacity)
        self.hosts = NearestTets(state, samples, self.capsules, bounds, self_collision, fingers)
        self.normals = VertexNormals(state)

    def _grids(self, model: "Model") -> list[DistanceGrid]:
        return [s.once(grid_of) for s in model.shapes] if self.needed or self.rigid else []

    def check_capacity(self, model: "Model") -> None:
        if model.soft:
            fit("bodies in contact", model.sizes.bodies, MAX_BODIES if self.needed else 1)
        if model.rigid:
            fit("rigid bodies", 1, int(self.rigid))
        self.grids.check_capacity(self._grids(model))

    def load(self, model: "Model") -> None:
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

    def detect(self, constraints: "ContactConstraints") -> None:
        """Make the constraints of points near a tet of another body candidates; `normals` must be up to date too."""
        if self.needed:
            self.hosts.find(constraints, self.begin)

    @ti.func
    def distance(self, t, x):
        """Signed distance of the body of tet t at a point x in or near it, by the equations above.

        Returns whether the tet has enough volume for that; phi [m], UNKNOWN_DISTANCE without a usable gradient, and n;
        the weights b in the tet; the rest position X [m], and how far [m] that is outside the body's grid.
        """
        phi, normal, beyond = UNKNOWN_DISTANCE, vec3(0.0), 0.0
        thick, b, X, g1, g2, g3, E1, E2, E3 = rest_coordinates(self.state, t, x)
        if thick:
            rest_phi, N, beyond = self.grids.extrapolated(self.state.body_of_tet[t], X)
            gradient = deformed_gradient(N, g1, g2, g3, E1, E2, E3)
            length = gradient.norm()
            if known(rest_phi) and length > 0.0:
                phi, normal = rest_phi * N.norm() / length, gradient / length
        return thick, phi, normal, b, X, beyond

    @ti.func
    def evaluate(self, r, constraints: ti.template()):
        """Update constraint r's distance, normal and vertices; whether the host's grid has a distance there."""
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
        """Make the corners of tet t, with weights b, the last vertices of constraint r, from its `first`.

        Returns what of the distance their x_lo take [m].
        """
        s = self.state
        a, weight, low = s.tets[t], ti.max(b, 0.0), 0.0
        weight /= weight.sum()
        for j in ti.static(range(4)):
            low += weight[j] * normal.dot(s.x_lo[a[j]])
            constraints.set_vertex(r, first + j, a[j], -weight[j])
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
                constraints.body_count[r] = 0
                if constraints.rigid_bodies.kind[body] != 0:
                    constraints.set_body(r, 0, body, self.samples.blend(p, s.x), 1.0)
                    constraints.body_count[r], first = 1, 0
        elif self.hosts.points.is_finger(p):
            if ti.static(self.has_fingers):
                q = p - self.hosts.points.first_finger
                phi -= self.fingers.radius[q]  # skin has a coefficient of friction of 1
                self.fingers.set_push(r, q, self.fingers.max_force_on(q, s.mu[host]), constraints)
            if ti.static(constraints.coupled):
                constraints.body_count[r] = 0
        else:
            k = p - self.samples.count[None]
            phi -= self.capsules.radius[k]
            friction *= self.capsules.friction[k]
        phi -= self.set_host(r, first, t, b, normal, constraints)
        constraints.set_contact(r, phi, normal, ti.sqrt(friction), closing_speed)


@ti.data_oriented
class VertexNormals:
    """Normals of the bodies' surfaces at their vertices, as they are at a search.

    normal vec3[V]: unit mean of the normals of a vertex's triangles, 0 inside;   sum vec3i[V], in NORMAL_STEPS
    """

    def __init__(self, state: "State"):
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
