"""Plastic flow: the rest shape of a tet follows where it is strained beyond the yield strain of its material.

With F = D_s B = U diag(s) V^T, J = det F and logarithmic strains e_k = ln s_k - ln J / 3 without the change of volume,

    |e| = sqrt(2/3 sum e_k^2) > Y:   B <- B V diag(exp((Y / |e| - 1) e_k)) V^T

is the return to the yield surface |e| = Y of multiplicative plasticity, F = F_e F_p with B = D_m^-1 F_p^-1 and det F_p
= 1 (Weber and Anand 1990; Irving et al. 2004). J stays and tr F^T F becomes less, so that the elastic energy does, too
(sim/elastic/energy.py). B is the whole state: x, masses, volumes, and the embedding, whose rest shape is the one that
was prepared, are not touched. A rest shape flows no farther than the substep allows that was chosen for its bound of
stiffness (BodyModel.kappa); a tet that would have to is elastic beyond.
"""

import numpy as np
import taichi as ti

from core.errors import BadInput
from core.fields import FieldGroup, Upload
from sim.elastic.energy import CRUSHED_DJ, Elasticity, row
from sim.model import MAX_BODIES, Model
from sim.state import State
from sim.time_step import lame, stiffness_bounds

INTERVAL = 1 / 180  # [s] from one flow to the next at most: a body that strikes something yields while it does
TOLERANCE = 1e-3  # of the volumes and stiffness bounds of the rest shapes of a snapshot; float32 rounds them by 1e-6


@ti.data_oriented
class PlasticFlow:
    """`run` lets the rest shapes flow, which only `active` bodies need: those of a material with a yield strain.

    limits vec3[B]: yield strain Y, 0 of an elastic body; I1 J^-2/3 below which |e| < Y in any direction; the largest
    V sum_a |grad N_a|^2 / m_a of a tet [m/kg]
    """

    def __init__(self, state: State, elasticity: Elasticity):
        self.state, self.elasticity = state, elasticity
        g = self._group = FieldGroup()
        self.limits = g.vector(MAX_BODIES)
        g.build()
        self._upload, self._write = Upload([self.limits]), Upload([elasticity.rest_inverse])
        self.active = False

    def load(self, model: Model) -> None:
        """Take other bodies."""
        self.model = model
        yields = np.array([p.material.yield_strain or 0.0 for p in model.bodies])
        self.active = bool(yields.any())
        stiffness = np.array([p.kappa.max(initial=0.0) / sum(lame(p.material)) for p in model.bodies])
        # pressed along one axis, I1 is the least of all strains of this |e|
        self._upload([np.stack([yields, np.exp(-2 * yields) + 2 * np.exp(yields), stiffness], axis=1)])

    def read(self) -> np.ndarray | None:
        """D_m^-1 of all tets as they are now [1/m], (T, 3, 3) float32; None without an active body."""
        return self.elasticity.rest_inverse.to_numpy()[: self.model.sizes.tets] if self.active else None

    def write(self, rest_inverse: np.ndarray | None, patches) -> None:
        """Take what `read` returned, for bodies that yield; None: as they were made. `patches` as in `run`."""
        if self.active:
            self._write([checked_rest_shapes(self.model, rest_inverse).reshape(-1, 9)])
            self._copy_to(patches)

    def run(self, patches) -> None:
        """Let the rest shapes flow; `patches` are those of the integrator, which hold copies, or None."""
        if self.active:
            self._run()
            self._copy_to(patches)

    def _copy_to(self, patches) -> None:
        if patches is not None:
            patches.take_rest_shapes()

    def warm_up(self) -> None:
        """Compile, see Solver.warm_up."""
        self._run()
        self._write([self.elasticity.rest_inverse.to_numpy()])

    @ti.kernel
    def _run(self):
        s = self.state
        ti.loop_config(serialize=s.serial)
        for t in range(s.T):
            if s.awake_tet(t) and self.limits[s.body_of_tet[t]][0] > 0.0:
                self._flow(t)

    @ti.func
    def _flow(self, t):
        s, e, a = self.state, self.elasticity, self.state.tets[t]
        limits, B = self.limits[s.body_of_tet[t]], e.rest_inverse[t]
        edges = ti.Matrix.cols([(s.x[a[k]] - s.x[a[0]]) + (s.x_lo[a[k]] - s.x_lo[a[0]]) for k in ti.static((1, 2, 3))])
        F = edges @ B
        J = F.determinant()
        # what is crushed has another term of energy, and an inverted tet no logarithm
        if J > 1.0 + CRUSHED_DJ and F.norm_sqr() > limits[1] * J ** (2.0 / 3.0):
            _U, S, V = ti.svd(F)
            strains = ti.log(ti.Vector([S[0, 0], S[1, 1], S[2, 2]])) - ti.log(J) / 3.0
            strain = ti.sqrt(2.0 / 3.0 * strains.norm_sqr())
            if strain > limits[0]:
                back = ti.exp((limits[0] / strain - 1.0) * strains)
                B = B @ V @ ti.Matrix([[back[0], 0.0, 0.0], [0.0, back[1], 0.0], [0.0, 0.0, back[2]]]) @ V.transpose()
                B *= (6.0 * e.volume[t] * B.determinant()) ** (-1.0 / 3.0)  # or rounding would add up
                g1, g2, g3 = row(B, 0), row(B, 1), row(B, 2)
                stiffness = (g1 + g2 + g3).norm_sqr() / s.mass[a[0]] + g1.norm_sqr() / s.mass[a[1]]
                stiffness += g2.norm_sqr() / s.mass[a[2]] + g3.norm_sqr() / s.mass[a[3]]
                if e.volume[t] * stiffness <= limits[2]:  # NaN is not
                    e.rest_inverse[t] = B


def checked_rest_shapes(model: Model, rest_inverse: np.ndarray | None) -> np.ndarray:
    """D_m^-1 of all tets (T, 3, 3): those given for bodies that yield, of all others as made. Raises BadInput."""
    shapes = np.concatenate([np.zeros((0, 3, 3)), *(s.inverse for s in model.shapes)])
    if rest_inverse is None:
        return shapes
    given = np.asarray(rest_inverse, np.float64)
    if given.shape != shapes.shape or not np.isfinite(given).all():
        raise BadInput(f"snapshot: rest_inverse must be finite and of shape {shapes.shape}, not {given.shape}")
    for p, B, rest in zip(model.bodies, model.split_tets(given), model.split_tets(shapes), strict=True):
        if p.material.yield_strain is not None:
            volumes = p.shape.volumes
            kept = np.abs(6 * volumes * np.linalg.det(B) - 1).max(initial=0.0) < TOLERANCE
            stiff = stiffness_bounds(B, volumes, 1 / p.mass[p.shape.tets], p.material) > (1 + TOLERANCE) * p.kappa
            if not kept or stiff.any():
                raise BadInput(f"snapshot: rest_inverse of {p.body.name} is none that it can flow to")
            rest[:] = B
    return shapes
