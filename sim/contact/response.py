"""Contact response: the law of one contact, non-penetration (Signorini) and Coulomb friction, for all kinds of contact.

The motion y [m] of a contact in this substep answers a change of its impulse p by y' = y + A (p - old), where A is its
inverse effective mass (Delassus operator). With n the normal and phi the signed distance it asks for

    n . y' >= least = min_normal_motion(phi),   n . p >= 0,   n . p = 0 where n . y' > least    (pushes, never pulls)
    |p_t| <= mu n . p,   y'_t = 0 where that suffices                                           (sticks or slides)

A contact that began inside goes out slowly, by `gentle_normal_motion`, and between bodies without friction.
`contact_impulse` is that law. It begins with the impulse that would hold the contact if nothing bounded it, in which
alone the kinds of contact differ:

    vertex, static shape    Jacobi: A = 1, p a displacement;   VBD: A = H^-1 of its local energy, p a force
    constraints             A = w_n along the normal and w_t across, summed over the vertices and rigid bodies that meet
    fingers                 the same with a compliant, damped and bounded normal part
"""

import taichi as ti

CONTACT_SLOP = 1e-5  # [m] contacts rest this deep, plus or minus: rounding (1e-7 m) can neither open nor tighten them
RECOVERY_TIME = 0.02  # [s] in which a deeper penetration decays
MAX_RECOVERY_SPEED = 1.0  # [m/s]; faster, it would throw the body that it frees
INSIDE = 1e-3  # [m]; a contact that is first met deeper began inside
GENTLE_SPEED = 0.2  # [m/s]; the same of a contact that began inside. Soft bodies spring apart at up to twice that
# [m/s^3]; growth of the acceleration with which a contact that began inside pushes out. Unbounded, contacts that push
# against one another squeeze a body until it springs away, at 40 m/s if of 1e8 Pa. It grows until any load is lifted.
GENTLE_GROWTH = 1000.0
# [body mass / dt^2] with which a shape meets a vertex in VBD, on top of the force it had: a push grows to
# its full size over a few sweeps. At once, the corner of a light stiff body would be held against the motion of the
# whole body before the sweeps have told the body, and store more energy than the body has. What rests is not affected.
CONTACT_STIFFNESS = 0.5
UNBOUNDED = 1e30  # [kg m], no limit of an impulse
FINGERTIP_STIFFNESS = 1200.0  # [N/m] of one sample of a finger: the few of a fingertip yield 1 mm at 3 N
# [m/s] at which friction is fully kinetic. If it were so at any speed, a soft block would slip far below mu_s: the
# edge that slips first would pass its load to its neighbours (Stribeck's curve has this shape too).
KINETIC_FRICTION_SPEED = 0.02


@ti.func
def min_normal_motion(phi, dt):
    """Least normal motion [m] of a contact at distance phi [m]: down to the slop, or out again if it is deeper."""
    gap = phi + CONTACT_SLOP
    result = 0.0
    if gap > CONTACT_SLOP:
        result = -gap
    elif gap < -CONTACT_SLOP:
        result = ti.min((-gap - CONTACT_SLOP) / RECOVERY_TIME, MAX_RECOVERY_SPEED) * dt
    return result


@ti.func
def gentle_normal_motion(phi, free, time, dt):
    """The same of a contact that began inside `time` [s] ago, and would move by `free` [m] if it did not push.

    It is held where it is, or goes out slowly.
    """
    most = ti.min(free + GENTLE_GROWTH * time * dt * dt, GENTLE_SPEED * dt)
    return ti.min(min_normal_motion(phi, dt), ti.max(most, 0.0))


@ti.func
def friction_coefficient(slip, friction, dt):
    """Coulomb coefficient at a slip [m] per substep: from mu_s at rest to mu_k at KINETIC_FRICTION_SPEED."""
    return friction[0] + ti.min(slip / (KINETIC_FRICTION_SPEED * dt), 1.0) * (friction[1] - friction[0])


@ti.func
def holding_impulse(old, n, y, least, w_n, w_t, compliance, damping, most):
    """Impulse [kg m] after `old` that stops the tangential motion of y [m] and raises the normal one to `least` [m].

    w_n, w_t: inverse effective masses [1/kg] along n and across. The normal part is that of a damped spring,

        compliance lambda + damping (n . y + w_n (lambda - n . old)) = least,   lambda <= most,

    which with compliance 0 [1/kg], damping 1 and no limit `most` [kg m] is rigid.
    """
    old_n, y_n = n.dot(old), n.dot(y)
    change = (least - damping * y_n - compliance * old_n) / (compliance + damping * w_n)
    return old + (ti.min(old_n + change, most) - old_n) * n - (y - y_n * n) / ti.max(w_t, 1e-20)


@ti.func
def contact_impulse(holding, n, A_n, w_t, friction, dt):
    """The impulse of a contact: between the frictionless one and `holding`, the last one inside Coulomb's cone.

        p = alpha n + theta (holding - alpha n),   alpha = A n . holding / A n . n,   the largest theta in [0, 1] with
        |p_t| <= mu n . p

    All of these give the same normal motion, and alpha n, which is in the cone, gives it without friction; if that had
    to pull, there is no contact. The less of `holding` is left, the less energy is taken; none is ever given, however A
    couples the directions. A_n: A n or any multiple; w_t: motion for a unit of tangential impulse, by which a contact
    slides; friction = (mu_s, mu_k).
    """
    p = ti.Vector([0.0, 0.0, 0.0])
    alpha = A_n.dot(holding) / A_n.dot(n)
    if alpha > 0.0:
        p = holding
        p_n = n.dot(holding)
        tangential = (holding - p_n * n).norm()
        lacking = tangential - friction[0] * p_n
        if lacking > 0.0:
            mu = friction_coefficient(lacking * w_t, friction, dt)
            theta = mu * alpha / (tangential - mu * (p_n - alpha))
            p = alpha * n + theta * (holding - alpha * n)
    return p


@ti.func
def isotropic_contact_impulse(holding, n, w_t, friction, dt):
    """`contact_impulse` where a normal impulse causes no tangential motion, A n along n: the projection on the cone."""
    p_n = n.dot(holding)
    p = ti.Vector([0.0, 0.0, 0.0])
    if p_n > 0.0:
        p = holding
        tangential = holding - p_n * n
        length = tangential.norm()
        lacking = length - friction[0] * p_n
        if lacking > 0.0:
            mu = friction_coefficient(lacking * w_t, friction, dt)
            p = p_n * (n + mu / length * tangential)
    return p


@ti.func
def fingertip_spring(phi, dt):
    """Least motion [m], compliance [1/kg] and damping of a fingertip, which is soft (see `holding_impulse`).

        lambda = k dt^2 (-phi - (1 + T / dt) y),   k = FINGERTIP_STIFFNESS,   T = RECOVERY_TIME

    -phi counts up to MAX_RECOVERY_SPEED T, so that nothing leaves faster, however deep a finger appears. At a distance
    the approach is stopped, undamped.
    """
    damping = 1.0 + (RECOVERY_TIME / dt if phi <= 0.0 else 0.0)
    return ti.min(-phi, MAX_RECOVERY_SPEED * RECOVERY_TIME), 1.0 / (FINGERTIP_STIFFNESS * dt * dt), damping
