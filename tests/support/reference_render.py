"""The renderer again, in float64 NumPy and as plainly as it can be written; `linear`: by gsplat 1.5.3's rules."""

import numpy as np

from assets.gaussians import Gaussians
from core.camera import Camera
from core.rotation import matrices_from_quaternions
from core.spherical_harmonics import sh_basis

DOUBT = 1e-3  # relative error of an alpha in float32, at most


def covariances(g: Gaussians) -> np.ndarray:
    """World covariances [m^2], (N, 3, 3)."""
    axes = matrices_from_quaternions(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def project(means, cov, opacity, camera: Camera, *, antialias=False, linear=False):
    """Pixel means (N, 2), Sigma_2D (N, 2, 2), opacities (N,), camera z (N,), kept (N,) bool."""
    R, t = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    p = means @ R.T + t
    z = np.where(np.abs(p[:, 2]) < 1e-12, 1e-12, p[:, 2])
    xy = []
    for k, (f, c, side) in enumerate(
        ((camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height)),
    ):
        margin = 0.3 * 0.5 * side / f if linear else 0.0
        xy.append(np.clip(p[:, k] / z, -c / f - margin, (side - c) / f + margin) * z)
    J = np.zeros((len(means), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = camera.fx / z, -camera.fx * xy[0] / z**2
    J[:, 1, 1], J[:, 1, 2] = camera.fy / z, -camera.fy * xy[1] / z**2
    JW = J @ R
    sharp = JW @ cov @ JW.transpose(0, 2, 1)
    uv = np.stack([camera.fx * p[:, 0] / z + camera.cx, camera.fy * p[:, 1] / z + camera.cy], 1)
    if not linear:
        uv, sharp = outlines(np.column_stack([p[:, :2], z]), R @ cov @ R.T, np.column_stack(xy), sharp, camera)
    sigma = sharp + 0.3 * np.eye(2)
    if antialias:
        opacity = opacity * np.sqrt(np.maximum(0, np.linalg.det(sharp) / np.linalg.det(sigma)))
    return uv, sigma, opacity, p[:, 2], (p[:, 2] >= 0.01) & (opacity >= 1 / 255)


def outlines(p, cov, held, sharp, camera: Camera):
    """Centres (N, 2) [px] and Sigma_2D (N, 2, 2) of splats whose outline at one level is the ellipsoid's.

    p (N, 3), cov (N, 3, 3): Gaussians in the camera's frame; held (N, 2): x, y of their means moved into the picture at
    their z; sharp (N, 2, 2): variances seen along the ray through there [px^2]. By the dual conic p p^T - k^2 cov
    of the ellipsoid, flattened along that ray where it reaches too far towards the eye.
    """
    z, focal = p[:, 2], np.array([camera.fx, camera.fy])
    beyond = focal * (p[:, :2] - held) / z[:, None]
    variances = np.maximum(np.einsum("nii->ni", sharp), 1e-300)
    level = np.maximum(2 * np.log(2), (beyond**2 / variances).max(axis=1))
    reach = np.maximum(level * cov[:, 2, 2] / z**2, 1e-300)
    flat = np.tile(np.eye(3), (len(p), 1, 1))  # moves points along the ray, towards the plane of the mean
    flat[:, :, 2] -= (1 - np.minimum(1, np.sqrt(0.3 / reach)))[:, None] * np.column_stack([held / z[:, None], z / z])
    cov = flat @ cov @ flat.transpose(0, 2, 1)
    dual = p[:, :, None] * p[:, None, :] - level[:, None, None] * cov
    dual /= dual[:, 2:, 2:]
    center = dual[:, :2, 2]
    shape = (center[:, :, None] * center[:, None, :] - dual[:, :2, :2]) / level[:, None, None]
    return focal * center + (camera.cx, camera.cy), focal[:, None] * shape * focal


def colors(g: Gaussians, camera: Camera, rotations=None) -> np.ndarray:
    """max(0, 0.5 + SH(R^T d)), (N, 3)."""
    return colors_towards(g, g.means.astype(np.float64) - camera.position, rotations)


def colors_towards(g: Gaussians, d: np.ndarray, rotations=None) -> np.ndarray:
    """The same along directions `d` (N, 3) of any length."""
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    if rotations is not None:
        d = np.einsum("nij,ni->nj", rotations, d)
    return np.maximum(0, 0.5 + np.einsum("nk,nkc->nc", sh_basis(d, g.sh.shape[1]), g.sh))


def render_stereo(g: Gaussians, eyes: list[Camera], *, antialias=False, radial=False, least=1e-4, linear=False):
    """rgb (V, H, W, 3), alpha, depth, doubts (V, H, W): one order for all eyes, the mean depth's, and one colour.

    `radial`: the mean distance's order; `least` as in `render`.
    """
    cov = covariances(g)
    depths = [g.means @ eye.world_to_camera[2, :3] + eye.world_to_camera[2, 3] for eye in eyes]
    if radial:
        depths = [np.linalg.norm(g.means.astype(np.float64) - eye.position, axis=1) for eye in eyes]
    d = g.means.astype(np.float64) - np.mean([eye.position for eye in eyes], axis=0)
    shared = {"cov": cov, "order_by": np.mean(depths, axis=0), "rgb": colors_towards(g, d)}
    shared |= {"antialias": antialias, "least": least, "linear": linear}
    doubts = [np.zeros((eye.height, eye.width), bool) for eye in eyes]
    pictures = [render(g, eye, doubts=out, **shared) for eye, out in zip(eyes, doubts, strict=True)]
    return [np.stack(images) for images in zip(*pictures, strict=True)] + [np.stack(doubts)]


def render(
    g: Gaussians, camera: Camera, *,
    antialias=False, cov=None, rgb=None, order_by=None, doubts=None, least=1e-4, linear=False,
):  # fmt: skip
    """rgb (H, W, 3), alpha (H, W), depth (H, W); a splat that would leave less transmittance than `least` ends a pixel.

    Out: `doubts`, bool (H, W), where rounding to float32 may fall on the other side of a threshold, 1/255 or `least`.
    """
    cov = covariances(g) if cov is None else cov
    rgb = colors(g, camera) if rgb is None else rgb
    means, how = g.means.astype(np.float64), {"antialias": antialias, "linear": linear}
    uv, sigma, opacity, z, kept = project(means, cov, g.opacities, camera, **how)
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    T, done = np.ones_like(u), np.zeros(u.shape, bool)
    C, depth = np.zeros((*u.shape, 3)), np.zeros_like(u)
    order = np.argsort((z if order_by is None else order_by).astype(np.float32), kind="stable")
    for i in order[kept[order]]:
        a, b, c = np.linalg.inv(sigma[i])[[0, 0, 1], [0, 1, 1]]
        dx, dy = u - uv[i, 0], v - uv[i, 1]
        alpha = np.minimum(0.999, opacity[i] * np.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy)))
        if doubts is not None:
            doubts |= ~done & (np.abs(255 * alpha - 1) < DOUBT)
            doubts |= ~done & (alpha >= 1 / 255) & (np.abs(T * (1 - alpha) - least) < 10 * DOUBT * least)  # of many
        alpha[(alpha < 1 / 255) | done] = 0
        done |= (alpha > 0) & (T * (1 - alpha) <= least)
        weight = np.where(done, 0, alpha * T)
        T = np.where(done, T, T * (1 - alpha))
        C += weight[..., None] * rgb[i]
        depth += weight * z[i]
    alpha = 1 - T
    return C, alpha, depth / np.maximum(alpha, 1e-10)
