"""The solver: all elastic bodies of a scene, stepped a frame at a time (VR-GS, Sec. 4.1)."""

import math

import numpy as np
import taichi as ti

from assets.errors import BadInput
from scenes.scene import BodyState, Hand
from sim.body import SoftBody
from sim.colliders import Shape
from sim.contact import Contacts
from sim.damping import Chunks, Damping
from sim.elastic import Elastic
from sim.stability import LIMIT, choose_substep, lame, stiffness_bounds
from sim.state import Sizes, State, Upload
from sim.substep import Substeps
from sim.summary import Summary
from sim.transform import Transform

LONGEST_FRAME = 1 / 20  # [s] after a hitch the bodies fall behind rather than the frame rate
REACH = 0.5  # of an edge; a vertex that crosses more in a substep has lost its elements (5e4 Pa: at 30-100 m/s)
PIECE = 16  # substeps behind one call from Python, at most
MOST_SUBSTEPS = 5000  # a frame; beyond, the mesh or the material is not meant for this
INTERACTIONS = ("physics", "transform")


class Solver:
    """Simulates `bodies`.

    substep [s] is forced, or None for the longest that the stability rule allows; iterations are full sweeps a
    substep; collision_passes is how often a frame contacts are searched; hands is how many may grip; frame_dt [s] is
    the usual frame. With interaction "transform" gripped bodies follow the hand rigidly and nothing else moves.
    Without contacts, bodies pass through all else and no hand grips: to measure elasticity alone.
    """

    def __init__(
        self,
        bodies: list[SoftBody],
        colliders: list[Shape] = (),
        *,
        gravity=(0.0, -9.81, 0.0),
        substep: float | None = None,
        iterations: int = 1,
        collision_passes: int = 1,
        hands: int = 2,
        interaction: str = "physics",
        contacts: bool = True,
        frame_dt: float = 1 / 60,
    ):
        if not bodies:
            raise BadInput("nothing to simulate: no body has a cage and a material")
        for b in bodies:
            b.check()
        if iterations < 1 or collision_passes < 1:
            raise BadInput(f"iterations and collision_passes must be at least 1, not {iterations}, {collision_passes}")
        self._bodies, self._passes, self.interaction = list(bodies), collision_passes, interaction
        self.vertex_offset = [0, *np.cumsum([len(b.vertices) for b in bodies]).tolist()]
        self._fill_state()
        self._substep = choose_substep(self._kappa, substep)
        nominal = math.ceil(frame_dt / self._substep)
        if nominal > MOST_SUBSTEPS:
            stiffest = bodies[int(np.argmax(self._kappas))].name
            raise BadInput(f"{stiffest}: {nominal} substeps a frame: too stiff for its finest tetrahedra")
        self.gravity = tuple(float(g) for g in gravity)
        s = self.state
        self.x, self.v, self.rest, self.w, self.tets, self.body_of_vertex = (
            s.x, s.v, s.rest, s.w, s.tets, s.body_of_vertex,
        )  # fmt: skip
        self._constraints = [Contacts(s, self._bodies, list(colliders), hands=hands)] if contacts else []
        pieces = max(collision_passes, -(-nominal // PIECE))
        length = -(-nominal // pieces)
        chunks = Chunks(s, np.array(self.vertex_offset))
        self._damping = Damping(s, chunks)
        self._substeps = Substeps(s, self._elastic, self._constraints, iterations=iterations, length=length)
        self._summary = Summary(s, chunks, self._bodies)
        self._transform = Transform(s)
        self._last = (0, 0.0)  # substeps and their length in the last frame
        self.reset()

    def _fill_state(self) -> None:
        bodies, begin = self._bodies, self.vertex_offset
        each = [(len(b.vertices), len(b.tets), len(b.surface)) for b in bodies]
        sizes = Sizes(*(sum(n) for n in zip(*each, strict=True)), bodies=len(bodies))
        rest = np.concatenate([np.asarray(b.vertices, np.float64) for b in bodies])
        tets = np.concatenate([np.asarray(b.tets, np.int64) + o for b, o in zip(bodies, begin, strict=False)])
        faces = np.concatenate([np.asarray(b.surface, np.int64) + o for b, o in zip(bodies, begin, strict=False)])
        masses = [b.masses() for b in bodies]
        inverse = [1 / m for m in masses]
        for b, w in zip(bodies, inverse, strict=True):
            if b.pinned is not None:
                w[np.asarray(b.pinned, np.int64)] = 0.0
        kappas = [
            stiffness_bounds(np.asarray(b.vertices, np.float64), np.asarray(b.tets), w, b.material)
            for b, w in zip(bodies, inverse, strict=True)
        ]
        self._kappas = np.array([k.max() for k in kappas])
        self._kappa = float(self._kappas.max())
        self._start = np.concatenate([b.start() for b in bodies])
        self._start_velocity = np.repeat(
            np.array([b.velocity for b in bodies], np.float64), [n for n, _, _ in each], axis=0
        )
        self._start_velocity[np.concatenate(inverse) == 0.0] = 0.0

        s = self.state = State(sizes)
        counts = np.array(each)
        ends = np.concatenate([np.zeros((1, 3), int), np.cumsum(counts, axis=0)])
        index = np.arange(len(bodies))
        material = [b.material for b in bodies]
        values = [
            (s.rest, rest),
            (s.w, np.concatenate(inverse)),
            (s.mass, np.concatenate(masses)),
            (s.tets, tets),
            (s.triangles, faces),
            (s.body_of_vertex, np.repeat(index, counts[:, 0])),
            (s.body_of_tet, np.repeat(index, counts[:, 1])),
            (s.body_of_triangle, np.repeat(index, counts[:, 2])),
            (s.vertex_begin, ends[:, 0]),
            (s.tet_begin, ends[:, 1]),
            (s.triangle_begin, ends[:, 2]),
            (s.mu, [lame(m)[0] for m in material]),
            (s.lam, [lame(m)[1] for m in material]),
            (s.kappa, self._kappas),
            (s.reach, [REACH * b.edge() for b in bodies]),
            (s.damping, [m.damping for m in material]),
            (s.friction, [m.friction for m in material]),
            (s.density, [m.density for m in material]),
            (s.body_mass, [m.sum() for m in masses]),
            (s.led, [m[w == 0.0].sum() for m, w in zip(masses, inverse, strict=True)]),
        ]
        Upload([f for f, _ in values])([v for _, v in values])
        self._motion = Upload([s.x, s.carry, s.v, s.v_carry])
        self._elastic = Elastic(s, rest, tets, np.concatenate(kappas))

    def step(self, dt: float, hands: list[Hand] = ()) -> None:
        """Advance by a frame of dt [s], clamped to [0, LONGEST_FRAME]."""
        dt = min(max(float(dt), 0.0), LONGEST_FRAME)
        if self.interaction == "transform":
            self._step_transform(dt, hands)
            return
        if dt == 0.0:
            return
        length = self._substeps.length
        pieces = max(1, math.ceil(dt / (self._substep * length) - 1e-6))
        n = pieces * length
        self.state.begin_frame(dt / n, dt / min(self._passes, pieces), n, ti.Vector(self.gravity))
        for c in self._constraints:
            c.begin_frame(hands, dt, n)
        for p in range(pieces):
            if p == 0 or p * self._passes // pieces != (p - 1) * self._passes // pieces:
                for c in self._constraints:
                    c.detect()
            self._damping.run(dt / pieces)
            self._substeps.run()
        self._last = (n, dt / n)

    def _step_transform(self, dt: float, hands: list[Hand]) -> None:
        gripped = []
        for c in self._constraints:
            if hasattr(c, "gripped"):
                c.begin_frame(hands, dt, 1)
                gripped = c.gripped()
        self._transform.step(hands, gripped)
        self._last = (0, 0.0)

    def reset(self) -> None:
        """Back to the start; grips and contacts are forgotten."""
        self.restore({"x": self._start, "v": self._start_velocity})

    def snapshot(self) -> dict[str, np.ndarray]:
        """Everything that `restore` needs to go on from here exactly; grips are not kept."""
        s, n = self.state, self.state.sizes.vertices
        return {name: getattr(s, name).to_numpy()[:n] for name in ("x", "v", "carry", "v_carry")}

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Set positions and velocities, (V, 3) each; what fp32 cannot hold of float64 values goes to the carries."""
        n = self.state.sizes.vertices
        values = []
        for name, low in (("x", "carry"), ("v", "v_carry")):
            value = np.asarray(snapshot[name])
            if value.shape != (n, 3) or not np.isfinite(value).all():
                raise BadInput(f"snapshot: {name} must be finite and of shape {(n, 3)}, not {value.shape}")
            high = value.astype(np.float32)
            values += [high, snapshot.get(low, value - high)]
        self._motion(values)
        for c in self._constraints:
            c.reset()
        self._transform.reset()

    def bodies(self) -> list[BodyState]:
        """Centroid, velocity, bounds, axis of each body, and whether a hand holds it."""
        held = set()
        for c in self._constraints:
            if hasattr(c, "gripped"):
                held |= set(c.gripped())
        return self._summary.bodies([b in held for b in range(len(self._bodies))])

    def pick(self, origin, direction) -> tuple[float, int] | None:
        """Distance [m] along a ray to the nearest surface triangle and its body's index, or None."""
        return self._summary.pick(origin, direction)

    def moved(self) -> bool:
        """Whether any vertex moved more than 1e-5 m since this last returned True."""
        return self._summary.moved()

    @property
    def interaction(self) -> str:
        """ "physics", or "transform": gripped bodies follow the hand rigidly and time stands still."""
        return self._interaction

    @interaction.setter
    def interaction(self, value: str) -> None:
        if value not in INTERACTIONS:
            raise BadInput(f"interaction must be one of {', '.join(INTERACTIONS)}, not {value!r}")
        self._interaction = value

    @property
    def stats(self) -> dict:
        """Sizes, substeps of the last frame, dt sqrt(max kappa) with its limit; `finite` reads the device back."""
        n, dt = self._last
        dt_or_planned = float(dt or self._substep)
        return {
            "vertices": self.state.sizes.vertices,
            "tets": self.state.sizes.tets,
            "substeps": n,
            "dt": dt_or_planned,
            "stability": dt_or_planned * math.sqrt(self._kappa),
            "stability_limit": LIMIT,
            "path": "jacobi",
            "finite": self._summary.finite(),
        }
