"""Contact between deformable bodies: a sample in (or near) a foreign tet is pushed out along that body's distance grid.

With barycentric weights b of the sample in the host tet, X = sum_j b_j X_j is where it sits in the host's rest shape.
The rest distance phi_0 there and its gradient N give, with F = dx/dX of the tet,

    n = F^-T N / |F^-T N|,   F^-T N = sum_j grad b_j (X_j . N),   phi = phi_0 |N| / |F^-T N|

and the contact acts on the sample with its weights, and on the tet's corners with -b.
"""

import numpy as np
import taichi as ti

from core.distance_grid import DistanceGrid
from core.fields import Upload
from scenes.scene import Capsule
from sim.body_model import RestShape
from sim.contact.broad_phase import BodyBounds
from sim.contact.capsule_samples import CapsuleSamples
from sim.contact.constraints import ContactConstraints
from sim.contact.contact_samples import ContactSamples
from sim.contact.device_grids import FAR, DistanceGrids
from sim.contact.nearest_tet import NearestTets
from sim.contact.rest_distance import rest_grid
from sim.contact.self_collision import SelfCollision
from sim.contact.static_shapes import Shape
from sim.contact.vertex_normals import VertexNormals
from sim.model import MAX_BODIES, Capacity, Model, fit
from sim.state import State

FLAT = 1e-3  # of its rest volume; a tet crushed flatter has no usable normal
# Of the surfaces' normals, the cosine above which two surfaces do not face each other: a point that was forced right
# through a body is let back in. Were it held on the far side, what is entangled would stay so.
ALONG = 0.3
NOTHING = DistanceGrid(np.full((2, 2, 2), FAR, np.float32), np.zeros(3), 1e-3)  # of what needs no grid
OUTSIDE = -0.01  # the barycentric weight at which a sample moves on to the next tet


@ti.data_oriented
class DeformableContact:
    """Fills the rows of points near foreign tets: row begin + p for point p (see sim/contact/nearest_tet.py)."""

    def __init__(
        self,
        state: State,
        first: Model,
        samples: ContactSamples,
        shapes: list[Shape],
        bounds: BodyBounds,
        folding: SelfCollision | None,
        capacity: Capacity = Capacity(),
        fingers: bool = False,
    ):
        self.folding, self.folds = folding, folding is not None
        self.state, self.samples, self.bounds, self.begin = state, samples, bounds, samples.capacity
        self.spots = CapsuleSamples([s for s in shapes if isinstance(s, Capsule)], samples.spacing)
        self.rigid = first.rigid or capacity.rigid
        self.needed = capacity.sized("bodies", first.sizes.bodies) > 1 or self.spots.size > 0 or self.folds
        self.needed = self.needed or fingers  # these look for tets and distances, too
        self.needed = self.needed and (first.soft or capacity.grows)  # rigid bodies alone have no tets to be in
        self.grids = DistanceGrids(self._grids(first), capacity)
        self.hosts = NearestTets(state, samples, self.spots, bounds, folding)
        self.normals = VertexNormals(state)
        self.rim = ti.field(ti.f32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, MAX_BODIES).place(self.rim)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.rim])

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
            self._upload([[s.once(rim_of) for s in model.shapes]])

    @property
    def size(self) -> int:
        """Rows at most."""
        return self.hosts.hash.points if self.needed else 0

    def detect(self, rows: ContactConstraints) -> None:
        """List the rows of points that are near a foreign tet; needs up-to-date Bounds."""
        if self.needed:
            self.normals.update()
            self.hosts.find(rows, self.begin)

    @ti.func
    def meet(self, r, rows: ti.template()):
        """Take row r's distance, normal and vertices anew; whether the host's grid says anything there."""
        s = self.state
        p = r - self.begin
        sampled = p < self.samples.count[None]
        t = self.hosts.host[p]
        a = s.tets[t]
        x0, X0 = s.x[a[0]], s.rest[a[0]]
        e1, e2, e3 = s.x[a[1]] - x0, s.x[a[2]] - x0, s.x[a[3]] - x0
        E1, E2, E3 = s.rest[a[1]] - X0, s.rest[a[2]] - X0, s.rest[a[3]] - X0
        det = e1.dot(e2.cross(e3))
        usable = rows.claimed[r] != 0  # a tet crushed flat has no normal: its contact stays as it was
        if det > FLAT * E1.dot(E2.cross(E3)):
            g1, g2, g3 = e2.cross(e3) / det, e3.cross(e1) / det, e1.cross(e2) / det  # grad b_j
            d = self.hosts.place(p) - x0
            b1, b2, b3 = g1.dot(d), g2.dot(d), g3.dot(d)
            b = ti.Vector([1.0 - b1 - b2 - b3, b1, b2, b3])
            host = s.body_of_tet[t]
            pace = self.bounds.pace[host]
            if sampled:
                pace += self.bounds.pace[self.samples.body[p]]
            X = X0 + b1 * E1 + b2 * E2 + b3 * E3
            phi, N = self.grids.sample(host, X)
            normal = g1 * E1.dot(N) + g2 * E2.dot(N) + g3 * E3.dot(N)
            length, slope = normal.norm(), N.norm()
            usable = phi < 0.5 * FAR and slope > 0.1 and length > 1e-3 * slope
            if usable and sampled and self.samples.blend(p, self.normals.normal).dot(normal) > ALONG * length:
                usable = False
                rows.rest(r, phi * slope / length, pace)
            if ti.static(self.folds):
                apart = 0.5 * self.folding.apart(host)
                if usable and sampled and self.samples.body[p] == host:
                    pace = self.folding.pace(host)
                    away = (X - self.samples.blend(p, s.rest)).norm()
                    if away < apart:  # it is just where it belongs
                        usable = False
                        rows.rest(r, apart - away, pace)
            self._walk(p, t, b)
            if usable:
                b = ti.max(b, 0.0)
                self._fill(r, p, t, b / b.sum(), phi * slope / length, normal / length, pace, rows)
            elif phi >= 0.5 * FAR:  # outside the grid, whose rim is outside the body
                rows.rest(r, self.rim[host] + self.grids.box_distance(host, X), pace)
        return usable

    @ti.func
    def _fill(self, r, p, t, b, distance, normal, pace, rows: ti.template()):
        """Write row r: point p at a distance from tet t's body, with weights b in the tet."""
        s = self.state
        a = s.tets[t]
        host = s.body_of_tet[t]
        phi, friction, first = distance, s.frictions(host), 0
        if p < self.samples.count[None]:
            phi += self.samples.skin[p] + normal.dot(self.samples.blend(p, s.x_lo))
            friction *= s.frictions(self.samples.body[p])
            self.samples.put(p, r, rows)
            first = 3
            if ti.static(rows.coupled):
                body = self.samples.body[p]
                rows.ends[r] = 0
                if rows.movers.kind[body] != 0:
                    rows.set_end(r, 0, body, self.samples.blend(p, s.x), 1.0)
                    rows.ends[r], first = 1, 0
        else:
            phi -= ti.min(self.hosts.reach(p), self.rim[host])
            friction *= self.spots.friction[p - self.samples.count[None]]
        for j in ti.static(range(4)):
            phi -= b[j] * normal.dot(s.x_lo[a[j]])
            rows.set_vertex(r, first + j, a[j], -b[j])
        rows.set_size(r, first + 4)
        rows.set(r, phi, normal, ti.sqrt(friction), pace)

    @ti.func
    def _walk(self, p, t, b):
        """From the next substep on, point p belongs to the tet across the face that it lies furthest outside of."""
        if b.min() < OUTSIDE:
            for j in ti.static(range(4)):
                if b[j] == b.min() and self.hosts.neighbor[t][j] >= 0:
                    self.hosts.host[p] = self.hosts.neighbor[t][j]

    def destroy(self) -> None:
        self.tree.destroy()
        for part in (self.grids, self.hosts, self.spots, self.normals):
            part.destroy()


def grid_of(shape: RestShape) -> DistanceGrid:
    """The distance grid of a rest shape: its body's own, else one made of the mesh."""
    if shape.boxed:  # its distance has a formula
        return NOTHING
    if shape.sdf is not None:
        return shape.sdf
    if shape.root is not shape:
        return shape.root.once(grid_of).scaled(shape.factor)
    return rest_grid(shape.vertices, shape.solid, shape.surface)


def rim_of(shape: RestShape) -> float:
    return rim(shape.once(grid_of))


def rim(grid) -> float:
    """How far around the surface a grid surely reaches [m]: the least distance on its outermost nodes."""
    v = np.asarray(grid.values, np.float64)
    return float(max(0.0, min(face.min() for k in range(3) for face in (v.take(0, k), v.take(-1, k)))))
