"""How far along each pixel's ray a Gaussian lies: two numbers per splat, whichever way the head is turned.

Along a ray from the eye with unit direction d, a Gaussian with mean p (seen from the eye) and covariance Sigma is
densest at distance t = d^T Sigma^-1 p / d^T Sigma^-1 d.                Radl 2024 (StopThePop), per-pixel depth
To first order about the mean this is where the ray meets a plane through the mean,

    1/t = a . d,   a = Sigma^-1 p / p^T Sigma^-1 p = (p/r - h) / r,   r = |p|,   h . p = 0.

In ray space h is the slope of the Gaussian's conditional mean: the distance of what lies w beside p is r + h . w.
The plane is fixed in the world, so a turn of the head reorders nothing; for a flat Gaussian it is exact. A camera's
pixel has d = (x, y, 1) / |(x, y, 1)|: what orders splats within it, the largest first, is

    (x, y, 1) . a = 1/z_0 + gx dx + gy dy,   gx = a_x / fx,   gy = a_y / fy,

at (dx, dy) [px] from the splat's middle, z_0 being the camera z of the mean.

Sigma is thickened by the filter of a pixel at distance r: rounding gives no slope to what is thinner.
"""

import taichi as ti

STEEPEST = 0.5  # of the distance: by how much the plane may near or leave within the splat; what is larger is no plane

vec2, vec3 = ti.math.vec2, ti.math.vec3


@ti.func
def slope(camera: ti.template(), v: ti.i32, p: vec3, s: ti.template(), blur: ti.f32, reach: ti.f32) -> vec2:
    """(gx, gy) [1/(m px)] of a Gaussian with mean p [m] in the frame of view `v` and covariance s in the world.

    camera: as Projection.camera; blur: the variance of a pixel's filter [px^2]; reach: where a splat ends [sigma^2].
    """
    from_eye = vec3(0.0)  # p, along the world's axes
    for k in ti.static(range(3)):
        from_eye += p[k] * camera[v, k].xyz
    lens = camera[v, 3]  # fx, fy, cx, cy
    a = plane(from_eye, s, blur * p.dot(p) / (lens.x * lens.y), reach)
    return vec2(a.dot(camera[v, 0].xyz) / lens.x, a.dot(camera[v, 1].xyz) / lens.y)


@ti.func
def plane(p: vec3, s: ti.template(), thickness: ti.f32, reach: ti.f32) -> vec3:
    """a [1/m], of the plane {x: a . x = 1} that stands for a Gaussian, seen from the eye.

    p: its mean [m]; s: Sigma as (xx, xy, xz, yy, yz, zz) [m^2]; thickness: added to each variance [m^2];
    reach: where a splat ends [sigma^2].
    """
    xx, yy, zz = s[0] + thickness, s[3] + thickness, s[5] + thickness
    n = vec3(
        (yy * zz - s[4] * s[4]) * p.x + (s[2] * s[4] - s[1] * zz) * p.y + (s[1] * s[4] - s[2] * yy) * p.z,
        (s[2] * s[4] - s[1] * zz) * p.x + (xx * zz - s[2] * s[2]) * p.y + (s[1] * s[2] - xx * s[4]) * p.z,
        (s[1] * s[4] - s[2] * yy) * p.x + (s[1] * s[2] - xx * s[4]) * p.y + (xx * yy - s[1] * s[1]) * p.z,
    )  # det(Sigma) Sigma^-1 p
    r = p.norm()
    ray = p / r
    h = vec3(0.0)
    if n.dot(ray) > 0:
        h = ray - n / n.dot(ray)
    edge = xx * h.x * h.x + yy * h.y * h.y + zz * h.z * h.z
    edge = reach * (edge + 2 * (s[1] * h.x * h.y + s[2] * h.x * h.z + s[4] * h.y * h.z))  # [m^2], squared
    if not (edge <= (STEEPEST * r) ** 2):  # nor if it is no number
        h *= STEEPEST * r / ti.sqrt(edge)
    return (ray - h) / r
