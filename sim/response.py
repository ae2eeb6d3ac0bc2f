"""What one contact does to the increment of a substep: stop the approach, hold or brake the sliding.

A contact of distance phi and normal n on a motion y asks for n . y >= least(phi), and for Coulomb friction.
"""

import taichi as ti

REST = 1e-5  # [m] contacts rest this deep, plus or minus: rounding (1e-7 m) can neither open nor tighten them
RECOVERY = 0.02  # [s] in which a deeper penetration decays
RECOVERY_SPEED = 1.0  # [m/s] at most; faster, it would throw what it frees


@ti.func
def least(phi, dt):
    """The least normal increment [m] of a contact at distance phi [m]: no deeper than REST, out again if deeper."""
    gap = phi + REST
    result = 0.0
    if gap > REST:
        result = -gap
    elif gap < -REST:
        result = ti.min((-gap - REST) / RECOVERY, RECOVERY_SPEED) * dt
    return result


@ti.func
def respond(phi, n, y, friction, dt):
    """Correction d [m] of the motion y [m] of one vertex.

    With d_n the normal correction, the tangential part y_t is undone if |y_t| <= friction d_n, else shortened by
    friction d_n (MATH 8, on increments).
    """
    d = ti.Vector([0.0, 0.0, 0.0])
    y_n = n.dot(y)
    d_n = least(phi, dt) - y_n
    if d_n > 0.0:
        y_t = y - y_n * n
        slide, hold = y_t.norm(), friction * d_n
        d = d_n * n - y_t * (1.0 if slide <= hold else hold / slide)
    return d
