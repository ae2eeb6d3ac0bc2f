"""Points of the nearest-tetrahedron query: what may be in a tet, where it is, and which group it belongs to.

They are the bodies' surface samples and samples on the axes of capsules: of static ones, so that nothing thin slips
between the others, and of the hands' fingers. Bodies and capsules are *groups*, numbered one after the other: first
MAX_BODIES for bodies, then up to STATIC_GROUPS for static capsules, then finger capsules.
"""

from typing import TYPE_CHECKING

import taichi as ti
from taichi.math import vec3

from sim.contact.contact_samples import MAX_CAPSULES
from sim.model import MAX_BODIES

if TYPE_CHECKING:
    from sim.contact.broad_phase import BodyBounds
    from sim.contact.contact_samples import CapsuleSamples, ContactSamples
    from sim.hands.finger_capsules import FingerCapsules
    from sim.state import State

STATIC_GROUPS = MAX_BODIES + MAX_CAPSULES  # the next ones are finger capsules


@ti.data_oriented
class QueryPoints:
    """The samples of bodies, then of static capsules, and from `first_finger` on those of fingers.

    size: how many there may be;   groups: numbers of groups, used or not
    """

    def __init__(
        self,
        state: "State",
        samples: "ContactSamples",
        capsules: "CapsuleSamples",
        bounds: "BodyBounds",
        fingers: "FingerCapsules | None",
    ):
        self.state, self.samples, self.capsules, self.bounds = state, samples, capsules, bounds
        self.fingers, self.has_fingers = fingers, fingers is not None
        self.first_finger = samples.capacity + capsules.size
        self.finger_groups = fingers.capsules if self.has_fingers else 0
        self.size = self.first_finger + (fingers.count if self.has_fingers else 0)
        self.groups = STATIC_GROUPS + self.finger_groups

    @ti.func
    def exists(self, p):
        """True if there is a point p."""
        result = p < self.samples.count[None] + self.capsules.count[None]
        if ti.static(self.has_fingers):  # noqa: SIM102
            if self.is_finger(p):
                result = False
                if p - self.first_finger < self.fingers.count:  # a hash has room for a few more points
                    result = self.fingers.radius[p - self.first_finger] > 0.0
        return result

    @ti.func
    def is_finger(self, p):
        """True if point p is a sample of a finger."""
        result = False
        if ti.static(self.has_fingers):
            result = p >= self.first_finger
        return result

    @ti.func
    def position(self, p, searching: ti.template()):
        """Position of point p [m], when the substep in progress begins; or when the next one does, in a search."""
        n, x = self.samples.count[None], vec3(0.0)
        if self.is_finger(p):
            if ti.static(self.has_fingers):
                x = self.fingers.position(p - self.first_finger, searching)
        elif p < n:
            x = self.samples.blend(p, self.state.x)
        else:
            x = self.capsules.position[p - n]
        return x

    @ti.func
    def spares(self, p, body):
        """True if point p is of a hand that passes through a body."""
        result = False
        if ti.static(self.has_fingers):  # noqa: SIM102
            if self.is_finger(p):
                result = self.fingers.spares(p - self.first_finger, body)
        return result

    @ti.func
    def group(self, p):
        """Group of point p."""
        n, g = self.samples.count[None], 0
        if self.is_finger(p):
            if ti.static(self.has_fingers):
                g = STATIC_GROUPS + self.fingers.capsule_of(p - self.first_finger)
        elif p < n:
            g = self.samples.body[p]
        else:
            g = self.capsules.group[p - n]
        return g

    @ti.func
    def group_count(self):
        """Number of groups that there are."""
        return self.state.body_count[None] + self.capsules.capsule_count[None] + self.finger_groups

    @ti.func
    def group_at(self, k):
        """The k-th group that there is."""
        n, m, g = self.state.body_count[None], self.capsules.capsule_count[None], k
        if k >= n + m:
            g = STATIC_GROUPS + k - n - m
        elif k >= n:
            g = MAX_BODIES + k - n
        return g

    @ti.func
    def is_group(self, g):
        """True if there is a group g."""
        capsules = MAX_BODIES + self.capsules.capsule_count[None]
        return g < self.state.body_count[None] or MAX_BODIES <= g < capsules or g >= STATIC_GROUPS

    @ti.func
    def box(self, g):
        """Box of group g's points [m], low and high, and of their velocities [m/s], v_min and v_max.

        A finger's box is that of all that it can touch until the next search, and does not move.
        """
        low, high, v_min, v_max = vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
        if g < MAX_BODIES:
            low, high, v_min, v_max = (
                self.bounds.low[g],
                self.bounds.high[g],
                self.bounds.v_min[g],
                self.bounds.v_max[g],
            )
        elif g >= STATIC_GROUPS:
            if ti.static(self.has_fingers):
                low, high = self.fingers.low[g - STATIC_GROUPS], self.fingers.high[g - STATIC_GROUPS]
        else:
            low, high = self.capsules.low[g - MAX_BODIES], self.capsules.high[g - MAX_BODIES]
        return low, high, v_min, v_max

    @ti.func
    def reach(self, g):
        """Distance [m] from its points at which group g touches: a capsule's radius, with a finger's motion."""
        result = 0.0
        if g >= STATIC_GROUPS:
            if ti.static(self.has_fingers):
                result = self.fingers.reach[g - STATIC_GROUPS]
        elif g >= MAX_BODIES:
            result = self.capsules.capsule_radius[g - MAX_BODIES]
        return result
