"""Choice of the integrator for the bodies of a scene, and the integrators of a solver, each made at its first use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import taichi as ti

from sim.elastic.time_step import Integration, choose_integration
from sim.elastic.vbd import VBDSubsteps
from sim.elastic.xpbd import XPBDSubsteps
from sim.rigid.rigid_bodies import MAX_RIGID_SUBSTEP

if TYPE_CHECKING:
    from sim.constraint import Constraint
    from sim.elastic.energy import Elasticity
    from sim.model import Model
    from sim.reductions import ReductionBlocks
    from sim.rigid.rigid_bodies import RigidBodies
    from sim.state import State


def choose_for(model: Model, wanted: dict, *, rigid: bool) -> Integration:
    """Choose integrator, substep and sweeps for these bodies, or BadInput if what is `wanted` does not suit them.

    wanted: options of `choose_integration`; rigid: rigid bodies limit the substep.
    """
    kappas = model.kappas
    stiffest = model.bodies[int(np.argmax(kappas))].body.name if model.bodies else "nothing"
    device = "cuda" if ti.cfg.arch == ti.cuda else "cpu"
    options = {"stiffest": stiffest, "crossing": model.crossing, "device": device, **wanted}
    chosen = choose_integration(float(kappas.max(initial=0.0)), **options)
    longest = MAX_RIGID_SUBSTEP * chosen.iterations
    return replace(chosen, substep=min(chosen.substep, longest)) if rigid else chosen


class Integrators:
    """The integrators "xpbd" and "vbd" of one solver; on CUDA as persistent kernels."""

    def __init__(
        self,
        state: State,
        elasticity: Elasticity,
        constraints: Sequence[Constraint],
        rigid_bodies: RigidBodies | None,
        blocks: ReductionBlocks,
    ):
        self.state, self.elasticity, self.constraints = state, elasticity, list(constraints)
        self.rigid_bodies, self.blocks = rigid_bodies, blocks
        self.made: dict = {}

    def get(self, name: str, iterations: int):
        """The integrator of this name, with so many sweeps a substep."""
        if name not in self.made:
            self.made[name] = self._make(name, iterations)
        return self.made[name]

    def _make_persistent_vbd(self, iterations: int):
        """The VBD kernel that stays, with two blocks for each multiprocessor where these run at once."""
        from sim.elastic.vbd_persistent import PersistentVBD  # needs the CUDA driver

        parts = self.state, self.elasticity, self.constraints, self.rigid_bodies, self.blocks
        made = PersistentVBD(*parts, iterations=iterations, per_multiprocessor=2)
        if not made.fits():
            made.destroy()
            made = PersistentVBD(*parts, iterations=iterations)
        return made

    def _make(self, name: str, iterations: int):
        parts = self.state, self.elasticity, self.constraints, self.rigid_bodies
        on_cuda = ti.cfg.arch == ti.cuda
        if name == "vbd" and on_cuda:
            return self._make_persistent_vbd(iterations)
        if name == "vbd":
            return VBDSubsteps(*parts, self.blocks, iterations=iterations)
        if on_cuda and iterations == 1:
            from sim.elastic.xpbd_persistent import PersistentXPBD

            return PersistentXPBD(self.state, self.constraints, self.rigid_bodies)
        return XPBDSubsteps(*parts, iterations=iterations)
