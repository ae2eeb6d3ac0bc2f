"""Bodies that move by themselves: before each frame, where its end has them goes to the solver."""

from __future__ import annotations

import numpy as np

from assets.animation import Animation
from assets.gaussians import matrices_of_quats
from scenes.scene import Body
from sim.skinning import Skinning
from sim.solver import LONGEST_FRAME, Solver


class Motion:
    """The motion of body number `body` of a solver, where it is placed; its own clock starts at rest.

    vertices  of the body at rest [m], scaled as it is placed, (V, 3)
    """

    def __init__(self, body: int, placed: Body, animation: Animation, vertices: np.ndarray, solver: Solver):
        self.body, self.animation, self.solver, self.time = body, animation, solver, 0.0
        q = np.asarray(placed.rotation, np.float64)
        self.world_from_body = np.eye(4)
        self.world_from_body[:3, :3] = matrices_of_quats((q / np.linalg.norm(q))[None])[0] * placed.scale
        self.world_from_body[:3, 3] = placed.position
        led = animation.driven
        mine = animation.vertices[led]
        self.skinning = Skinning(
            solver.vertex_offset[body],
            mine,
            vertices[mine] / placed.scale,
            animation.joints[led],
            animation.weights[led],
            len(animation.parents),
        )

    def drive(self, dt: float) -> None:
        """Lead the driven vertices through the frame of dt [s] that comes."""
        if self.solver.interaction == "transform":  # time stands still
            return
        self.time += min(dt, LONGEST_FRAME)
        self.skinning.pose(self.world_from_body @ self.animation.matrices(self.time), self.solver.targets)
        self.solver.drive_surface(self.body)

    def reset(self) -> None:
        """At rest again."""
        self.time = 0.0
