"""Hands: what they grip, and the springs that hold it.

A gripped vertex i is tied to its place in the hand's frame by a critically damped spring. The springs of one hand
together carry the whole body, of mass M, at FREQUENCY (or faster, a body lighter than LIGHTEST):

    kappa = omega^2 max(M, LIGHTEST) / m_held,   gamma = 2 sqrt(kappa M / m_held),   |force_i| <= FORCE m_i / m_held

per mass of vertex, and are integrated implicitly in each substep, with the hand's pose interpolated to the substep:

    dx' = dx + dt^2 (kappa (p - x - dx') + gamma (p_dot - x_dot')),   x_dot' = (dx' - carry) / dt
"""

import math
from dataclasses import replace

import numpy as np
import taichi as ti

from assets.gaussians import matrices_of_quats
from scenes.scene import Hand
from sim.assembly import Assembly, stacked
from sim.grips import Grip, Grips, pose, unit
from sim.samples import Samples
from sim.state import Download, State

FREQUENCY = 20.0  # [Hz] of the whole body on its springs: stiffer than an arm, softer than a pin
LIGHTEST = 0.2  # [kg]; lighter bodies are held as firmly, with 3 N/mm, so that they too can be squeezed
FORCE = 80.0  # [N] of one hand at most: a firm pull
FEWEST = 4  # vertices that fix a body's attitude with some to spare
WIDER = 1.5  # times the reach, where a coarse cage has fewer than FEWEST within reach
OMEGA = 2.0 * math.pi * FREQUENCY


@ti.data_oriented
class Hands:
    """Grips of up to `count` hands.

    held i32[V]: bit h = hand h holds the vertex;   place vec3[H,V]: where, in the hand's frame [m]
    position vec3[H,2], rotation vec4[H,2]: poses at the start and at the end of the frame
    kappa [1/s^2], gamma [1/s], mass f32[H] = m_held [kg];   pulled vec3[H,V]: last correction of a vertex [m]
    total i64[H,3]: force sums [1e-6 N]
    """

    def __init__(self, state: State, samples: Samples, count: int):
        self.state, self.samples, self.count = state, samples, count
        H = max(count, 1)
        self.builder = ti.FieldsBuilder()
        self.held, self.place, self.pulled = ti.field(ti.i32), ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.f32)
        self.builder.dense(ti.i, state.V).place(self.held)
        self.builder.dense(ti.ij, (H, state.V)).place(self.place, self.pulled)
        self.position, self.rotation = ti.Vector.field(3, ti.f32), ti.Vector.field(4, ti.f32)
        self.builder.dense(ti.ij, (H, 2)).place(self.position, self.rotation)
        self.kappa, self.gamma, self.mass, self.total = (ti.field(t) for t in (ti.f32, ti.f32, ti.f32, ti.i64))
        self.builder.dense(ti.i, H).place(self.kappa, self.gamma, self.mass)
        self.builder.dense(ti.ij, (H, 3)).place(self.total)
        self.tree = self.builder.finalize()
        self._positions = Download([state.x])

    def load(self, assembly: Assembly) -> None:
        """Other bodies from now on."""
        self.assembly, self.offsets = assembly, assembly.vertex_begin
        self.masses = stacked([p.mass for p in assembly.parts])
        self.reset()

    def reset(self) -> None:
        """Open all hands and forget where they were."""
        self.hold(Grips((None,) * self.count, (None,) * self.count))

    def gripped(self) -> list[int]:
        """The body that each hand holds, -1 for none."""
        return [-1 if grip is None else grip.body for grip in self.held_by]

    def grips(self) -> Grips:
        """What each hand holds, and where it was."""
        return Grips(tuple(self.held_by), tuple(self.last))

    def hold(self, grips: Grips) -> None:
        """Hold this and nothing else."""
        self.held_by, self.last = list(grips.held), list(grips.last)
        self.held.fill(0)
        for h, grip in enumerate(self.held_by):
            if grip is not None:
                self._hold(h, grip)

    def begin_frame(self, hands: list[Hand]) -> None:
        """Take the hands' new poses; grip and release. A hand that is no longer given opens."""
        poses = np.zeros((max(self.count, 1), 2, 7), np.float32)
        for h in range(self.count):
            now, before = (hands[h] if h < len(hands) else None), self.last[h]
            if self.held_by[h] is not None and (now is None or not now.grip):
                self._hold(h, None)
            elif now is not None and now.grip and not (before is not None and before.grip):
                self._grip(h, now)
                before = None  # places are measured at the present pose: nothing may jerk them there
            if now is not None:
                poses[h, 0], poses[h, 1] = pose(now if before is None else before), pose(now)
            self.last[h] = None if now is None else replace(now)
        if any(grip is not None for grip in self.held_by):
            self._set_poses(poses)

    def _grip(self, h: int, hand: Hand) -> None:
        """Hold the vertices within reach of the nearest body that has its surface or inside within reach."""
        count = int(self.offsets[-1])
        if count == 0:
            return
        x = self._positions(count)[0].astype(np.float64)
        away = np.linalg.norm(x - np.asarray(hand.position), axis=1)
        ids, weights = self.samples.host_ids, self.samples.host_weights
        surface = np.linalg.norm((x[ids] * weights[..., None]).sum(1) - np.asarray(hand.position), axis=1)
        first = int(np.argmin(surface))
        touched = int(np.argmin(away)) if away.min() <= surface[first] else int(ids[first, 0])
        if min(away.min(), surface[first]) > hand.reach:
            return
        body = int(np.searchsorted(self.offsets, touched, side="right")) - 1
        mine = np.arange(self.offsets[body], self.offsets[body + 1])
        taken = mine[away[mine] <= hand.reach]
        if len(taken) < FEWEST:
            nearest = mine[np.argsort(away[mine], kind="stable")][:FEWEST]
            taken = nearest[away[nearest] <= WIDER * hand.reach]
        if len(taken) == 0:  # a triangle far larger than the hand
            taken = np.unique(ids[first])
        places = (x[taken] - np.asarray(hand.position)) @ matrices_of_quats(unit(hand.rotation)[None])[0]
        self._hold(h, Grip(body, taken - int(self.offsets[body]), places))

    def _hold(self, h: int, grip: Grip | None) -> None:
        """Let hand h hold exactly this."""
        self.held_by[h] = grip
        rows = 1 if grip is None else len(grip.vertices)  # Taichi takes no empty arrays
        vertices, places = np.zeros(rows, np.int32), np.zeros((rows, 3), np.float32)
        strength = ti.Vector([0.0, 0.0, 0.0])
        if grip is not None:
            first, last = self.offsets[grip.body : grip.body + 2]
            vertices[:], places[:] = grip.vertices + first, grip.places
            held, whole = float(self.masses[vertices].sum()), float(self.masses[first:last].sum())
            kappa = OMEGA**2 * max(whole, LIGHTEST) / held
            strength = ti.Vector([held, kappa, 2 * math.sqrt(kappa * whole / held)])
        self._set_held(h, 0 if grip is None else rows, vertices, places, strength)

    @ti.kernel
    def _set_held(
        self,
        h: ti.i32,
        count: ti.i32,
        taken: ti.types.ndarray(ti.i32, 1),
        places: ti.types.ndarray(ti.f32, 2),
        strength: ti.types.vector(3, ti.f32),
    ):
        for i in self.held:
            self.held[i] &= ~(1 << h)
        self.mass[h], self.kappa[h], self.gamma[h] = strength[0], strength[1], strength[2]
        for k in range(count):
            self.held[taken[k]] |= 1 << h
            self.pulled[h, taken[k]] = ti.Vector([0.0, 0.0, 0.0])
            self.place[h, taken[k]] = ti.Vector([places[k, 0], places[k, 1], places[k, 2]])

    @ti.kernel
    def _set_poses(self, poses: ti.types.ndarray(ti.f32, 3)):
        for h, k in ti.ndrange(poses.shape[0], 2):
            self.position[h, k] = ti.Vector([poses[h, k, c] for c in range(3)])
            self.rotation[h, k] = ti.Vector([poses[h, k, c] for c in range(3, 7)])

    @ti.func
    def _target(self, h, i, fraction):
        """Where hand h wants vertex i, at a fraction of the frame: positions blended, rotations too (shorter arc)."""
        a, b = self.rotation[h, 0], self.rotation[h, 1]
        q = ti.math.mix(a, b if a.dot(b) >= 0.0 else -b, fraction).normalized()
        r, u = self.place[h, i], ti.Vector([q[1], q[2], q[3]])
        t = 2.0 * u.cross(r)
        return ti.math.mix(self.position[h, 0], self.position[h, 1], fraction) + r + q[0] * t + u.cross(t)

    @ti.func
    def _spring(self, h, i, d):
        """Correction [m] of vertex i's increment d by the spring of hand h."""
        s = self.state
        dt, tick, n = s.dt[None], s.tick[None], ti.cast(s.substeps[None], ti.f32)
        p = self._target(h, i, (tick + 1) / n)
        step = p - self._target(h, i, tick / n)
        kappa, gamma = self.kappa[h] * dt * dt, self.gamma[h] * dt
        a = (kappa * (p - s.x[i] - d) + gamma * (step + s.carry[i] - d)) / (1.0 + kappa + gamma)
        most = FORCE / self.mass[h] * dt * dt
        return a * ti.min(1.0, most / ti.max(a.norm(), 1e-20))

    @ti.func
    def pull(self, i, d):
        """The increment d of vertex i with the springs of all hands that hold it."""
        pulled = d
        if ti.static(self.count > 0):
            held = self.held[i]
            if held != 0:
                for h in range(self.count):
                    if (held >> h) & 1:
                        a = self._spring(h, i, d)
                        self.pulled[h, i] = a
                        pulled += a
        return pulled

    @ti.func
    def lag(self, i):
        """How far vertex i is from where hands want it at the end of the frame [m]."""
        most = 0.0
        for h in range(self.count):
            if (self.held[i] >> h) & 1:
                most = ti.max(most, (self._target(h, i, 1.0) - self.state.x[i]).norm())
        return most

    def forces(self) -> list[np.ndarray]:
        """Force of each hand on what it holds in the last substep [N], (3,) each; zero for an open hand."""
        self._sum()
        return list(self.total.to_numpy()[: self.count] * 1e-6)

    @ti.kernel
    def _sum(self):
        s = self.state
        for h, c in self.total:
            self.total[h, c] = 0
        for i in self.held:
            for h in range(self.count):
                if (self.held[i] >> h) & 1 and s.dt[None] > 0.0:
                    force = s.mass[i] / s.dt[None] ** 2 * self.pulled[h, i]
                    for c in ti.static(range(3)):
                        ti.atomic_add(self.total[h, c], ti.cast(force[c] * 1e6, ti.i64))

    def destroy(self) -> None:
        self.tree.destroy()
