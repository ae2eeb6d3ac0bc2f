"""Contact response: what one contact does to the motion of a substep (non-penetration and Coulomb friction).

A contact of signed distance phi and normal n asks of the motion y [m] of this substep that n . y >=
min_normal_motion(phi), and bounds its tangential push by the Coulomb cone.
"""

import taichi as ti

CONTACT_SLOP = 1e-5  # [m] contacts rest this deep, plus or minus: rounding (1e-7 m) can neither open nor tighten them
RECOVERY_TIME = 0.02  # [s] in which a deeper penetration decays
MAX_RECOVERY_SPEED = 1.0  # [m/s]; faster, it would throw the body that it frees
# Fraction of the normal compliance without friction that is left with it. Where a stiff body's vertex can only slide if
# it also rises, friction makes the push that raises it larger, up to a jam; more than twice as large, it threw a plate
# of 1e8 Pa at 10 m/s.
MIN_COMPLIANCE_RATIO = 0.5
# [body mass / dt^2] with which a shape meets a vertex in VBD, on top of the force it had: a push grows to
# its full size over a few sweeps. At once, the corner of a light stiff body would be held against the motion of the
# whole body before the sweeps have told the body, and store more energy than the body has. What rests is not affected.
CONTACT_STIFFNESS = 0.5
FINGERTIP_STIFFNESS = 1200.0  # [N/m] of one sample of a finger: the few of a fingertip yield 1 mm at 3 N
FINGERTIP_DAMPING_TIME = 0.01  # [s]: critical for 50 g on two samples; lighter bodies are overdamped
FINGERTIP_MAX_DEPTH = 0.008  # [m] of penetration that count: a finger's radius
# [m/s] at which friction is fully kinetic. If it were so at any speed, a soft block would slip far below mu_s: the
# edge that slips first would pass its load to its neighbours (Stribeck's curve has this shape too).
KINETIC_FRICTION_SPEED = 0.02


@ti.func
def min_normal_motion(phi, dt):
    """Least normal motion [m] of a contact at distance phi [m]: no deeper than the slop, out again if deeper."""
    gap = phi + CONTACT_SLOP
    result = 0.0
    if gap > CONTACT_SLOP:
        result = -gap
    elif gap < -CONTACT_SLOP:
        result = ti.min((-gap - CONTACT_SLOP) / RECOVERY_TIME, MAX_RECOVERY_SPEED) * dt
    return result


@ti.func
def normal_impulse(old, y, min_y, inv_mass):
    """Normal impulse [kg m], after `old`, that raises the normal motion y [m] to min_y; it never pulls."""
    return ti.max(old + (min_y - y) / inv_mass, 0.0)


@ti.func
def friction_coefficient(slip, friction, dt):
    """Coulomb coefficient at a slip [m] per substep: from mu_s at rest to mu_k at KINETIC_FRICTION_SPEED."""
    return friction[0] + ti.min(slip / (KINETIC_FRICTION_SPEED * dt), 1.0) * (friction[1] - friction[0])


@ti.func
def coulomb_friction(tangential, normal, friction, inv_mass, dt):
    """The tangential impulse, a vector, bounded by Coulomb friction, friction = (mu_s, mu_k).

    All of it up to mu_s times the normal impulse; beyond, the contact slides, by what the lacking impulse would have
    moved it: `inv_mass` is its motion [m] for a unit of impulse.
    """
    bounded, size = tangential, tangential.norm()
    lacking = size - friction[0] * normal
    if lacking > 0.0:
        bounded = tangential * (friction_coefficient(lacking * inv_mass, friction, dt) * normal / size)
    return bounded


@ti.func
def friction_impulse(old, n, y, normal, friction, inv_mass, dt):
    """Tangential impulse [kg m] after `old` that stops the tangential motion of y [m], within the friction bound."""
    sliding = y - n.dot(y) * n
    wanted = (old - n.dot(old) * n) - sliding / ti.max(inv_mass, 1e-20)
    return coulomb_friction(wanted, normal, friction, inv_mass, dt)


@ti.func
def fingertip_impulse(old, phi, y, inv_mass, dt, max_impulse):
    """Normal impulse [kg m], after `old`, of a fingertip: a soft damped pad.

        lambda = k dt^2 (-phi - (1 + T / dt) y),  0 <= lambda <= max_impulse,   y the motion along the normal [m]

    with k = FINGERTIP_STIFFNESS and T = FINGERTIP_DAMPING_TIME, in the step that also solves it for what a unit impulse
    moves (`inv_mass`). So nothing leaves faster than FINGERTIP_MAX_DEPTH / T, however deep a finger appears. At a
    distance it stops the approach, undamped.
    """
    compliance, damping = 1.0 / (FINGERTIP_STIFFNESS * dt * dt), 1.0
    if phi <= 0.0:
        damping += FINGERTIP_DAMPING_TIME / dt
    lacking = ti.min(-phi, FINGERTIP_MAX_DEPTH) - damping * y - compliance * old
    return ti.math.clamp(old + lacking / (compliance + damping * inv_mass), 0.0, max_impulse)


@ti.func
def project_contact(phi, n, y, friction, dt):
    """Correction d [m] of the motion y [m] of one vertex.

    With d_n the normal correction, the tangential part y_t is undone if |y_t| <= mu_s d_n, else shortened by mu_k d_n.
    """
    d = ti.Vector([0.0, 0.0, 0.0])
    y_n = n.dot(y)
    d_n = min_normal_motion(phi, dt) - y_n
    if d_n > 0.0:
        d = d_n * n - coulomb_friction(y - y_n * n, d_n, friction, 1.0, dt)
    return d


@ti.func
def project_contact_metric(phi, n, y, friction, dt, H, A, prior, stiffness):
    """Correction A p [m] of the motion y [m] of one vertex, and its force p [N], in the metric H [N/m] = A^-1.

    The normal push is at most n . prior + stiffness gap, where gap is what y lacks; so y' may fall short of the least.

    p = H (y' - y) holds the vertex at y', which is y with its normal part raised to the least. If that needs more than
    friction = (mu_s, mu_k) allows, it slides: p = p_n (n - mu u), u the direction of sliding, p_n from
    n . (y + A p) = least, and mu by the slip that the lacking push leaves (see `friction_coefficient`).
    """
    p = ti.Vector([0.0, 0.0, 0.0])
    y_n = n.dot(y)
    gap = min_normal_motion(phi, dt) - y_n
    if gap > 0.0:
        gap = ti.min(gap, n.dot(A @ n) * (ti.max(n.dot(prior), 0.0) + stiffness * gap))
        y_t = y - y_n * n
        p = H @ (gap * n - y_t)
        p_n = n.dot(p)
        lacking = (p - p_n * n).norm() - friction[0] * ti.max(p_n, 0.0)
        if lacking > 0.0:
            mu = friction_coefficient(lacking * A.trace() / 3.0, friction, dt)
            A_n, u = A @ n, y_t / ti.max(y_t.norm(), 1e-20)
            lift = A_n.dot(u)  # of the vertex, by a push along u: friction takes it away, the more so the larger mu is
            mu = ti.min(mu, (1.0 - MIN_COMPLIANCE_RATIO) * n.dot(A_n) / ti.max(lift, 1e-30))
            along = n - mu * u
            p = gap / A_n.dot(along) * along
    return A @ p, p


@ti.func
def angular_inv_mass(arm, n, inverse_inertia):
    """(r x n) I^-1 (r x n) [1/kg]: the part of the inverse effective mass along n that a lever arm r adds."""
    a = arm.cross(n)
    return a.dot(inverse_inertia @ a)
