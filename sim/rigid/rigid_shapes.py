"""Collision shapes of rigid bodies: exact boxes, or distance grids, in the body's frame."""

from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from taichi.math import vec3

from core.fields import FieldGroup, Upload
from sim.contact.contact_samples import points_of
from sim.contact.response import CONTACT_SLOP
from sim.contact.signed_distance import UNKNOWN_DISTANCE
from sim.contact.static_shapes import box_distance
from sim.model import MAX_BODIES

if TYPE_CHECKING:
    from sim.contact.contact_samples import ContactSamples
    from sim.contact.signed_distance import DistanceGrids
    from sim.model import Model, RestShape
    from sim.rigid.rigid_bodies import RigidBodies


@ti.data_oriented
class RigidShapes:
    """boxed i32[B], half vec3[B] [m];   outward vec3[P]: surface normal of a rigid body at a sample, in its frame.

    On a corner or an edge `outward` is the mean of the faces that meet there; 0 for samples of soft bodies.
    """

    def __init__(self, rigid_bodies: "RigidBodies", samples: "ContactSamples", grids: "DistanceGrids"):
        self.rigid_bodies, self.samples, self.grids = rigid_bodies, samples, grids
        group = self._group = FieldGroup()
        self.boxed, self.half = group.scalar(MAX_BODIES, dtype=ti.i32), group.vector(MAX_BODIES)
        self.outward = group.vector(samples.capacity)
        group.build()
        self._upload = Upload([self.boxed, self.half, self.outward])

    def load(self, model: "Model") -> None:
        """Take the shapes of these bodies."""
        shapes = model.shapes
        half = [s.vertices.max(0) if s.boxed else np.zeros(3) for s in shapes]
        outward = [s.once(outward_of, self.samples.spacing) for s in shapes]
        self._upload([[s.boxed for s in shapes], half, np.concatenate([np.zeros((0, 3)), *outward])])

    @ti.func
    def normal(self, p):
        """Surface normal at sample p in the world; 0 on soft bodies."""
        n = vec3(0.0)
        b = self.samples.body[p]
        if self.rigid_bodies.kind[b] != 0:
            n = self.rigid_bodies.R[b] @ self.outward[p]
        return n

    @ti.func
    def distance(self, b, x, facing):
        """Signed distance [m] from x to body b and outward unit normal; UNKNOWN_DISTANCE, 0 where a grid has none."""
        m = self.rigid_bodies
        R = m.R[b]
        q = R.transpose() @ ((x - m.x[b]) - m.x_lo[b]) + m.center[b]
        phi, normal = UNKNOWN_DISTANCE, vec3(0.0)
        if self.boxed[b]:
            phi, normal = bearing_distance(q, self.half[b], R.transpose() @ facing)
        else:
            value, gradient = self.grids.sample(b, q)
            length = gradient.norm()
            if length > 0.0:
                phi, normal = value, gradient / length
        return phi, R @ normal


@ti.func
def bearing_distance(p, half, facing):
    """Distance and normal of the box |p| <= half for a point of a surface that faces `facing` (0: unknown).

    Inside the box, and up to CONTACT_SLOP beside it, the nearest of those faces counts that the surface can rest on.
    Without this, the corners of a box that stands on an equal one would be pushed off sideways.
    """
    phi, normal = box_distance(p, half)
    q = abs(p) - half
    if q.max() < CONTACT_SLOP:
        best = -UNKNOWN_DISTANCE
        for k in ti.static(range(3)):
            side = 1.0 if p[k] >= 0.0 else -1.0
            if side * facing[k] < 0.0 and q[k] > best:
                best = q[k]
                normal = vec3(0.0)
                normal[k] = side
        phi = best if best > -UNKNOWN_DISTANCE else phi
    return phi, normal


def outward_of(shape: "RestShape", spacing: float) -> np.ndarray:
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
