"""The shapes of rigid bodies as others meet them: exact boxes, or distance grids, in the body's frame."""

import numpy as np
import taichi as ti

from core.fields import Upload
from sim.body_model import RestShape
from sim.contact.contact_samples import ContactSamples, points_of
from sim.contact.device_grids import FAR, DistanceGrids, corner
from sim.contact.static_shapes import box_distance
from sim.model import MAX_BODIES, Model
from sim.rigid.rigid_bodies import RigidBodies

OVERHANG = 5e-4  # [m] a corner so far beyond a box's edge still stands on it: bodies as wide as each other are stacked
AGAINST = -0.05  # cosine; a face can bear a sample whose surface faces it by more than this


@ti.data_oriented
class RigidShapes:
    """boxed i32[B], half vec3[B] [m];   outward vec3[P]: where a rigid body's surface faces at a sample, in its frame.

    On a corner or an edge `outward` is the mean of the faces that meet there; 0 for samples of soft bodies.
    """

    def __init__(self, movers: RigidBodies, samples: ContactSamples, grids: DistanceGrids):
        self.movers, self.samples, self.grids = movers, samples, grids
        self.boxed, self.half, self.outward = ti.field(ti.i32), ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.f32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, MAX_BODIES).place(self.boxed, self.half)
        self.builder.dense(ti.i, samples.capacity).place(self.outward)
        self.tree = self.builder.finalize()
        self._upload = Upload([self.boxed, self.half, self.outward])

    def load(self, model: Model) -> None:
        """Take the shapes of these bodies."""
        shapes = model.shapes
        half = [s.vertices.max(0) if s.boxed else np.zeros(3) for s in shapes]
        outward = [s.once(outward_of, self.samples.spacing) for s in shapes]
        self._upload([[s.boxed for s in shapes], half, np.concatenate([np.zeros((0, 3)), *outward])])

    @ti.func
    def facing(self, p):
        """Where the surface faces at sample p, in the world; 0 on soft bodies."""
        n = corner(0.0)
        b = self.samples.body[p]
        if self.movers.kind[b] != 0:
            n = self.movers.R[b] @ self.outward[p]
        return n

    @ti.func
    def distance(self, b, x, facing):
        """Signed distance [m] from x to body b, and the outward unit normal; (FAR, 0) where a grid says nothing."""
        m = self.movers
        R = m.R[b]
        q = R.transpose() @ ((x - m.x[b]) - m.x_lo[b]) + m.center[b]
        phi, normal = FAR, corner(0.0)
        if self.boxed[b]:
            phi, normal = bearing_distance(q, self.half[b], R.transpose() @ facing)
        else:
            value, gradient = self.grids.sample(b, q)
            if value < 0.5 * FAR and gradient.norm() > 0.1:
                phi, normal = value / gradient.norm(), gradient.normalized()
        return phi, R @ normal

    def destroy(self) -> None:
        self.tree.destroy()


@ti.func
def bearing_distance(p, half, facing):
    """Distance and normal of the box |p| <= half for a point of a surface that faces `facing` (0: unknown).

    Inside the box, and up to OVERHANG beside it, the nearest of those faces counts that the surface can rest on.
    Without this, the corners of a box that stands on an equal one would be pushed off sideways.
    """
    phi, normal = box_distance(p, half)
    q = abs(p) - half
    if q.max() < OVERHANG:
        best = -FAR
        for k in ti.static(range(3)):
            side = 1.0 if p[k] >= 0.0 else -1.0
            if side * facing[k] < AGAINST and q[k] > best:
                best = q[k]
                normal = corner(0.0)
                normal[k] = side
        phi = best if best > -FAR else phi
    return phi, normal


def outward_of(shape: RestShape, spacing: float) -> np.ndarray:
    """Unit sum of the different face normals that meet at each sample of a rigid shape, (P, 3)."""
    points = shape.once(points_of, spacing)
    result = np.zeros((len(points.ids), 3))
    if not shape.rigid:
        return result
    x, surface = shape.vertices, shape.surface
    normals = np.cross(x[surface[:, 1]] - x[surface[:, 0]], x[surface[:, 2]] - x[surface[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    around: dict[int, set[int]] = {}
    for t, triangle in enumerate(surface.tolist()):
        for i in triangle:
            around.setdefault(i, set()).add(t)
    for p, (ids, weights) in enumerate(zip(points.ids.tolist(), points.weights, strict=True)):
        meeting = sorted(set.intersection(*(around[i] for i, w in zip(ids, weights, strict=True) if w > 0)))
        different = np.unique(np.round(normals[meeting], 6), axis=0)
        total = different.sum(0)
        result[p] = total / max(np.linalg.norm(total), 1e-9)
    return result
