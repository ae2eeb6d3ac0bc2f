"""Hands: what they grip, and the springs that hold it.

A gripped vertex i is tied to its place in the hand's frame by a critically damped spring. The springs of one hand
together carry the whole body, of mass M, at FREQUENCY (or faster, a body lighter than LIGHTEST):

    kappa = omega^2 max(M, LIGHTEST) / m_held,   gamma = 2 sqrt(kappa M / m_held),   |force_i| <= FORCE m_i / m_held

per mass of vertex, and are integrated implicitly in each substep, with the hand's pose interpolated to the substep:

    dx' = dx + dt^2 (kappa (p - x - dx') + gamma (p_dot - x_dot')),   x_dot' = (dx' - x_lo) / dt
"""

import math
from dataclasses import replace

import numpy as np
import taichi as ti

from core.fields import Download
from scenes.scene import Hand
from sim.contact.contact_samples import ContactSamples
from sim.hands.grasp_state import Grip, Grips, Trail, finite, longer, pose, take
from sim.hands.throw import AIM, change
from sim.model import Model, stacked
from sim.state import State

FREQUENCY = 20.0  # [Hz] of the whole body on its springs: stiffer than an arm, softer than a pin
LIGHTEST = 0.2  # [kg]; lighter bodies are held as firmly, with 3 N/mm, so that they too can be squeezed
FORCE = 80.0  # [N] of one hand at most: a firm pull
JUMP = 1.0  # [m] in a frame: no arm is so fast, the tracking was lost
PATIENCE = 0.25  # [s] that a hand is held where it was lost
OMEGA = 2.0 * math.pi * FREQUENCY


@ti.data_oriented
class Grasps:
    """Grips of up to `count` hands.

    held i32[V]: bit h = hand h holds the vertex;   place vec3[H,V]: where, in the hand's frame [m]
    position vec3[H,2], rotation vec4[H,2]: poses at the start and at the end of the frame
    kappa [1/s^2], gamma [1/s], mass f32[H] = m_held [kg];   pulled vec3[H,V]: last correction of a vertex [m]
    total i64[H,3]: force sums [1e-6 N]
    """

    def __init__(self, state: State, samples: ContactSamples, count: int):
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
        self._motion = Download([state.x, state.v])

    def load(self, model: Model) -> None:
        """Other bodies from now on."""
        self.model, self.offsets = model, model.vertex_begin
        self.masses = stacked([p.mass for p in model.bodies])
        self.reset()

    def reset(self) -> None:
        """Open all hands and forget where they were."""
        self.hold(Grips.none(self.count))

    def gripped(self) -> list[int]:
        """The body that each hand holds, -1 for none."""
        return [-1 if grip is None else grip.body for grip in self.held_by]

    def grips(self) -> Grips:
        """What each hand holds, and where it was."""
        return Grips(tuple(self.held_by), tuple(self.last), tuple(self.trails), tuple(self.lost))

    def hold(self, grips: Grips) -> None:
        """Hold this and nothing else."""
        self.held_by, self.last = list(grips.held), list(grips.last)
        self.trails, self.lost = list(grips.trails), list(grips.lost)
        self.held.fill(0)
        for h, grip in enumerate(self.held_by):
            if grip is not None:
                self._hold(h, grip)

    def begin_frame(self, hands: list[Hand | None], dt: float, moving: bool) -> None:
        """Take the hands' poses after dt [s]; grip and release.

        A hand that opens throws what no other hand holds, if things are `moving` (see sim/hands/throw.py). One that is no
        longer in the list opens and throws nothing. One that is None, or has no finite pose, holds still; so does one
        that holds something and is suddenly JUMP away, until it is back or, after PATIENCE, opens.
        """
        poses = np.zeros((max(self.count, 1), 2, 7), np.float32)
        for h in range(self.count):
            before = self.last[h]
            now = self._seen(h, hands[h], dt) if h < len(hands) else None
            if self.held_by[h] is not None and (now is None or not now.grip):
                body, trail = self.held_by[h].body, self.trails[h]
                self._hold(h, None)
                if now is not None and moving and len(trail) > 1 and body not in self.gripped():
                    self._throw(body, trail)
            elif now is not None and now.grip and not (before is not None and before.grip):
                x = self._motion(int(self.offsets[-1]))[0].astype(np.float64)
                self._hold(h, take(now, x, self.offsets, self.samples.host_ids, self.samples.host_weights))
                before = None  # places are measured at the present pose: nothing may jerk them there
            if now is not None:
                poses[h, 0], poses[h, 1] = pose(now if before is None else before), pose(now)
            self.last[h] = None if now is None else replace(now)
            self.trails[h] = () if self.held_by[h] is None else longer(self.trails[h], dt, now, AIM)
        if any(grip is not None for grip in self.held_by):
            self._set_poses(poses)

    def _seen(self, h: int, given: Hand | None, dt: float) -> Hand | None:
        """Where hand h counts as being, if the tracking says `given`."""
        last = self.last[h]
        if given is None or not finite(given):
            return last
        far = last is not None and math.dist(given.position, last.position) > JUMP
        if not far or self.held_by[h] is None:
            self.lost[h] = 0.0
            return given
        self.lost[h] += dt
        if self.lost[h] > PATIENCE:  # and what it drops, it does not throw
            self._hold(h, None)
            return given
        return replace(last, grip=given.grip)

    def _throw(self, body: int, trail: Trail) -> None:
        """Let a body move on as the hand did that has held it."""
        part = self.model.bodies[body]
        first, last = (int(o) for o in self.offsets[body : body + 2])
        if (part.inv_mass > 0.0).all():
            x, v = self._motion(last)[:, first:].astype(np.float64)
            self._add(first, last - first, change(trail, x, v, part.mass, FORCE * AIM).astype(np.float32))

    @ti.kernel
    def _add(self, first: ti.i32, n: ti.i32, dv: ti.types.ndarray(ti.f32, 2)):
        for i in range(n):
            self.state.v[first + i] += ti.Vector([dv[i, c] for c in range(3)])

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
        dt, tick, n = s.dt[None], s.substep_index[None], ti.cast(s.substeps[None], ti.f32)
        p = self._target(h, i, (tick + 1) / n)
        step = p - self._target(h, i, tick / n)
        kappa, gamma = self.kappa[h] * dt * dt, self.gamma[h] * dt
        a = (kappa * (p - s.x[i] - d) + gamma * (step + s.x_lo[i] - d)) / (1.0 + kappa + gamma)
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
                        a = self._spring(h, i, pulled)  # after the last hand's, lest two overshoot
                        self.pulled[h, i] = a
                        pulled += a
        return pulled

    @ti.func
    def haste(self, i):
        """What hands may add to the speed of vertex i until the next search [m/s]: what takes it to where they want it
        at the end of the frame, or what their greatest force yields."""
        t, most = self.state.detect_dt[None], 0.0
        for h in range(self.count):
            if (self.held[i] >> h) & 1:
                way = (self._target(h, i, 1.0) - self.state.x[i]).norm()
                most = ti.max(most, ti.min(way / t, FORCE / self.mass[h] * t))
        return most

    def forces(self) -> list[np.ndarray]:
        """Force of each hand on what it holds in the last substep [N], (3,) each; zero for an open hand."""
        if self.held_by == [None] * self.count:
            return [np.zeros(3)] * self.count
        return self._forces()

    def _forces(self) -> list[np.ndarray]:
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

    def warm_up(self) -> None:
        """See Solver.warm_up."""
        self._motion(0)
        self._forces()
        if self.count:
            self._hold(0, self.held_by[0])
            self._set_poses(np.zeros((self.count, 2, 7), np.float32))  # each frame that needs them sets them
            self._add(0, 0, np.zeros((1, 3), np.float32))

    def destroy(self) -> None:
        self.tree.destroy()
