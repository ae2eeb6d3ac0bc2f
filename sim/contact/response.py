"""What one contact does to the increment of a substep: stop the approach, hold or brake the sliding.

A contact of distance phi and normal n on a motion y asks for n . y >= least(phi), and for Coulomb friction.
"""

import taichi as ti

REST = 1e-5  # [m] contacts rest this deep, plus or minus: rounding (1e-7 m) can neither open nor tighten them
RECOVERY = 0.02  # [s] in which a deeper penetration decays
# Of what a contact gives without friction. Where a stiff body's vertex can only slide if it also rises, friction makes
# the push that raises it larger, up to a jam; more than twice as large, it threw a plate of 1e8 Pa at 10 m/s.
WEDGED = 0.5
# [body mass / dt^2] with which a shape meets a vertex on the descent path, on top of the force it had: a push grows to
# its full size over a few sweeps. At once, the corner of a light stiff body would be held against the way of the whole
# body before the sweeps have told the body, and store more energy than the body has. What rests is not moved by that.
FIRM = 0.5
RECOVERY_SPEED = 1.0  # [m/s] at most; faster, it would throw what it frees
PAD_STIFFNESS = 1200.0  # [N/m] of a spot of skin (sim/hands/fingers.py): a fingertip's few yield 1 mm to 3 N
PAD_TIME = 0.01  # [s]: critical for 50 g on two spots, and what is lighter creeps out
PAD_DEPTH = 0.008  # [m] that count: a finger's radius
# [m/s] at which friction is fully kinetic. Were it so at any speed, a soft block would let go far below mu_s: what
# slips first, at its edge, would load the next with what it drops (Stribeck's curve has this shape too).
CREEP = 0.02


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
def grip(tangential, normal, friction, way, dt):
    """The share of a tangential push that friction yields, with friction = (mu_s, mu_k) and pushes in one unit.

    All of it up to mu_s times the normal push; beyond, the contact slides, at the speed that the lacking push, which
    would move it by `way` [m] a unit, leaves it. From 0 to CREEP the coefficient falls from mu_s to mu_k.
    """
    share, lacking = 1.0, tangential - friction[0] * normal
    if lacking > 0.0:
        fallen = ti.min(lacking * way / (CREEP * dt), 1.0)
        share = (friction[0] + fallen * (friction[1] - friction[0])) * normal / tangential
    return share


@ti.func
def press(old, phi, y, mass, dt, most):
    """A fingertip's normal push [kg m], after `old`: a soft pad of stiffness PAD_STIFFNESS, damped in PAD_TIME.

        lambda = k dt^2 (-phi - (1 + PAD_TIME / dt) y),  0 <= lambda <= most,   y the motion along the normal [m]

    in the step that solves it for what a push of 1 kg m moves (`mass`, inverse) as well. So nothing leaves faster than
    PAD_DEPTH / PAD_TIME, however deep a finger appears. From afar it stops the approach, undamped.
    """
    give, lag = 1.0 / (PAD_STIFFNESS * dt * dt), 1.0
    if phi <= 0.0:
        lag += PAD_TIME / dt
    lacking = ti.min(-phi, PAD_DEPTH) - lag * y - give * old
    return ti.math.clamp(old + lacking / (give + lag * mass), 0.0, most)


@ti.func
def respond(phi, n, y, friction, dt):
    """Correction d [m] of the motion y [m] of one vertex.

    With d_n the normal correction, the tangential part y_t is undone if |y_t| <= mu_s d_n, else shortened by mu_k d_n
    (MATH 8, on increments).
    """
    d = ti.Vector([0.0, 0.0, 0.0])
    y_n = n.dot(y)
    d_n = least(phi, dt) - y_n
    if d_n > 0.0:
        y_t = y - y_n * n
        d = d_n * n - y_t * grip(y_t.norm(), d_n, friction, 1.0, dt)
    return d


@ti.func
def respond_metric(phi, n, y, friction, dt, H, A, prior, firm):
    """Correction A p [m] of the motion y [m] of one vertex, and its force p [N], in the metric H [N/m] = A^-1.

    The normal push is at most n . prior + firm gap, the gap being what y lacks; so y' may be short of the least.

    p = H (y' - y) holds the vertex at y', which is y's normal part raised to the least. If that needs more than
    friction = (mu_s, mu_k) allows, it slides: p = p_n (n - mu u), u the direction of sliding, p_n from
    n . (y + A p) = least, and mu by the speed that the lacking push leaves it (see `grip`).
    """
    p = ti.Vector([0.0, 0.0, 0.0])
    y_n = n.dot(y)
    gap = least(phi, dt) - y_n
    if gap > 0.0:
        gap = ti.min(gap, n.dot(A @ n) * (ti.max(n.dot(prior), 0.0) + firm * gap))
        y_t = y - y_n * n
        p = H @ (gap * n - y_t)
        p_n = n.dot(p)
        lacking = (p - p_n * n).norm() - friction[0] * ti.max(p_n, 0.0)
        if lacking > 0.0:
            fallen = ti.min(lacking * A.trace() / (3.0 * CREEP * dt), 1.0)
            mu = friction[0] + fallen * (friction[1] - friction[0])
            A_n, u = A @ n, y_t / ti.max(y_t.norm(), 1e-20)
            lift = A_n.dot(u)  # of the vertex, by a push along u: friction takes it away, the more so the larger mu is
            mu = ti.min(mu, (1.0 - WEDGED) * n.dot(A_n) / ti.max(lift, 1e-30))
            along = n - mu * u
            p = gap / A_n.dot(along) * along
    return A @ p, p


@ti.func
def inverse(H):
    """H^-1 of a symmetric positive definite matrix of any size: scaled, so that float32 holds its determinant."""
    scale = 3.0 / H.trace()
    return (H * scale).inverse() * scale
