"""Pairs of a tet and a sample of the same body: whether they may touch before the next search.

Those close together at rest never do: they are neighbours, and the narrow phase leaves them out too. Of the others, a
pair stays apart if an axis that separates it does so still when both have moved on at their velocities. Rotation of
both, and motion past each other, hardly bring them closer along it.
"""

import taichi as ti
from taichi.math import vec3

from sim.contact.broad_phase import CONTACT_MARGIN
from sim.contact.signed_distance import UNKNOWN_DISTANCE


@ti.func
def bounding_sphere(field: ti.template(), a):
    """Centre and radius of a sphere around the values of a vec3 field at four vertices a."""
    center, radius = vec3(0.0), 0.0
    for j in ti.static(range(4)):
        center += 0.25 * field[a[j]]
    for j in ti.static(range(4)):
        radius = ti.max(radius, (field[a[j]] - center).norm())
    return center, radius


@ti.func
def neighborhood(s: ti.template(), t, distance):
    """Centre and radius [m] of a sphere around tet t at rest: of its body, points within never meet the tet.

    Its radius is `distance`, or what the narrow phase takes for a neighbour: half of that beyond the tet.
    """
    center, radius = bounding_sphere(s.rest, s.tets[t])
    return center, ti.max(distance, radius + 0.5 * distance)


@ti.func
def outside_sphere(p, center, radius):
    """Distance of p outside of a sphere; negative inside."""
    return (p - center).norm() - radius


@ti.func
def stay_apart(s: ti.template(), x, v, t, axis):
    """True if a unit axis goes on separating tet t of the state s and a point of its body at x [m], at v [m/s]."""
    a, gap, closing = s.tets[t], UNKNOWN_DISTANCE, 0.0
    for j in ti.static(range(4)):
        gap = ti.min(gap, axis.dot(x - s.x[a[j]]))
        closing = ti.max(closing, axis.dot(s.v[a[j]] - v))
    return gap >= CONTACT_MARGIN + closing * s.detect_dt[None]
