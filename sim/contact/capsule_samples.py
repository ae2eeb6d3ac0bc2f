"""Spots on the axes of thin static capsules, so that nothing thin slips between the samples of a body."""

import numpy as np
import taichi as ti

from core.fields import Upload, round_up_capacity
from scenes.scene import Capsule
from sim.model import MAX_BODIES

MAX_CAPSULES = 32


@ti.data_oriented
class CapsuleSamples:
    """Points on the axes of thin static capsules: place vec3, radius f32 [m], friction f32, group i32.

    Per capsule: low, high vec3 the box of its axis, thickness f32 its radius [m].
    """

    def __init__(self, capsules: list[Capsule], spacing: float):
        thin = [c for c in capsules if c.radius < 2 * spacing][:MAX_CAPSULES]  # thicker ones cannot slip through
        rows, low, high = [], np.zeros((MAX_CAPSULES, 3)), np.zeros((MAX_CAPSULES, 3))
        for k, c in enumerate(thin):
            a, b = np.asarray(c.a, np.float64), np.asarray(c.b, np.float64)
            n = int(np.clip(np.ceil(np.linalg.norm(b - a) / (0.5 * spacing)), 1, 256))
            rows += [(*(a + (b - a) * i / n), c.radius, c.friction, MAX_BODIES + k) for i in range(n + 1)]
            low[k], high[k] = np.minimum(a, b), np.maximum(a, b)
        table = np.array(rows).reshape(-1, 6)
        self.size, self.groups = len(table), len(thin)
        n = round_up_capacity(max(self.size, 1))
        self.place, self.low, self.high = (ti.Vector.field(3, ti.f32) for _ in range(3))
        self.radius, self.friction, self.thickness = ti.field(ti.f32), ti.field(ti.f32), ti.field(ti.f32)
        self.group = ti.field(ti.i32)
        self.builder = ti.FieldsBuilder()
        self.builder.dense(ti.i, n).place(self.place, self.radius, self.friction, self.group)
        self.builder.dense(ti.i, MAX_CAPSULES).place(self.low, self.high, self.thickness)
        self.count, self.group_count = ti.field(ti.i32), ti.field(ti.i32)
        self.builder.place(self.count, self.group_count)
        self.tree = self.builder.finalize()
        columns = [(self.place, table[:, :3]), (self.radius, table[:, 3]), (self.friction, table[:, 4])]
        columns += [(self.group, table[:, 5]), (self.low, low), (self.high, high)]
        columns += [
            (self.thickness, [c.radius for c in thin]),
            (self.count, self.size),
            (self.group_count, self.groups),
        ]
        Upload([f for f, _ in columns])([v for _, v in columns])

    def destroy(self) -> None:
        self.tree.destroy()
