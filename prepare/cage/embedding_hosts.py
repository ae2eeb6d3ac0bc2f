"""Second level of the embedding: host tets and weights of the corners of each Gaussian's local tetrahedron.

The corners are mu + sqrt(3) H {(1,1,1), (1,-1,-1), (-1,1,-1), (-1,-1,1)}, H = (k^2 Sigma + floor^2 h^2 I)^(1/2), with
h [m] the edge of a tet of the cage there. They surround the k-sigma ellipsoid (VR-GS, Sec. 4.3.2) and, what the paper
leaves open, span a fraction of a cage tet even where the Gaussian is tiny or flat. With `floor=0` a small Gaussian lies
in one tet and its F jumps to its neighbour's as in the one-level scheme, and an F from corners 1e-6 m apart is noise.
Where the floor dominates, H tends to floor h I, however the Gaussian is rotated: all neighbours take the same
difference stencil, so their F differ little. (A stencil rotated with each Gaussian would see the second derivatives of
the deformation differently: that alone is as rough as one level.)

Defaults, measured on a stuffed bar with tets of 4.5 cm, twisted by 180 degrees per metre and stretched, Gaussians of
4.5 mm: F of neighbours jumps 3.7 times less than with one level (95th percentile; on the surface 6 times), and means, F
and Sigma are at least as near to the truth as there. At floor = 0.2 it is 4.9 and 7.4 times, but Sigma is off by a
quarter more: a tetrahedron of four corners takes a fraction of the second derivatives for F, in proportion to its size.
k = 1/3 puts the corners of a large Gaussian at one sigma; k = 1 is 2.5 times rougher. The corners of a small Gaussian
on the surface leave the cage by at most 0.45 h: less than the usual dilation.
"""

import numpy as np
import taichi as ti

from assets.asset import CageEmbedding
from core.quaternion import to_matrix
from prepare.cage.device_locator import (
    DeviceLocator,
    cell_grid,
    find_tet,
    indices,
    nearest_sample,
    reals,
    vec3,
    vec4,
    weight_change,
    weights_of,
)
from prepare.cage.quality_energy import device_array

CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # around the unit sphere
MAX_WEIGHT = 3.0  # absolute barycentric weight of a corner: two tet heights outside of the face it is seen through
MAX_HALF_AXIS = 4.0  # of a local tetrahedron, in tets of the cage: bounds its aspect ratio, whatever the file holds
CHUNK = 1 << 20  # Gaussians at once: 160 MB in and out
HALVINGS = 4  # attempts, each at half the size of the last, before all corners share one tet


def embed(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    vertices: np.ndarray,
    tets: np.ndarray,
    *,
    k: float = 1 / 3,
    floor: float = 0.15,
) -> CageEmbedding:
    """Find the host tets and the weights of the local tetrahedra's corners. Taichi must be running.

    means [m] (N, 3), quats wxyz (N, 4), scales = standard deviations [m] (N, 3); vertices [m] (V, 3), tets (T, 4).
    """
    n = len(means)
    host, weights = np.zeros((n, 4), np.int32), np.zeros((n, 4, 4), np.float32)
    if n:
        cage = DeviceLocator(vertices, tets)
        corner_edge = device_array(ti.f64, cage.host.vertex_edge[cage.host.tets])
        tables = corner_edge, cage.maps, cage.begin, cage.candidates, *cage.boundary_tables(), cage.grid
        for i in range(0, n, CHUNK):
            chunk = slice(i, min(i + CHUNK, n))
            f64 = (np.ascontiguousarray(a[chunk], np.float64) for a in (means, quats, scales))
            _embed(*f64, *tables, float(k), float(floor), host[chunk], weights[chunk])
    return CageEmbedding(host, weights)


@ti.kernel
def _embed(
    means: reals, quats: reals, scales: reals, corner_edge: reals, maps: reals, begin: indices, candidates: indices,
    sample: reals, owner: indices, sample_begin: indices, cells: reals, k: ti.f64, floor: ti.f64, host: indices,
    weights: ti.types.ndarray(ti.f32),
):  # fmt: skip
    """Out: host, weights. corner_edge (T, 4) [m]; the other tables as of DeviceLocator."""
    ti.loop_config(block_dim=64)
    for g in range(means.shape[0]):
        grid, mu = cell_grid(cells), vec3(means[g, 0], means[g, 1], means[g, 2])
        centre, depth = mu, ti.cast(0.0, ti.f64)
        home = find_tet(maps, begin, candidates, grid, mu)
        if home < 0:  # pulled towards the cage as far as the bound on the weights asks
            b = nearest_sample(sample, sample_begin, grid, mu)
            home = owner[b]
            foot = vec3(sample[b, 0], sample[b, 1], sample[b, 2])
            depth = (mu - foot).norm()
            at, to = weights_of(maps, home, foot), weights_of(maps, home, mu)
            t = ti.cast(1.0, ti.f64)
            for c in ti.static(range(4)):
                d = to[c] - at[c]
                if ti.abs(d) > 0.0:
                    t = ti.min(t, (MAX_WEIGHT - ti.math.sign(d) * at[c]) / ti.abs(d))
            centre = foot + t * (mu - foot)
        own = weights_of(maps, home, centre)
        inside = ti.max(own, 0.0)
        h = ti.cast(0.0, ti.f64)
        for c in ti.static(range(4)):
            h += corner_edge[home, c] * inside[c]
        h /= inside.sum()
        R = to_matrix(vec4(quats[g, 0], quats[g, 1], quats[g, 2], quats[g, 3]))
        half = vec3(0.0, 0.0, 0.0)
        for c in ti.static(range(3)):
            wide = ti.min(k * scales[g, c], MAX_HALF_AXIS * h)
            half[c] = ti.sqrt(wide * wide + floor * floor * h * h)
        H = ti.Matrix([[R[i, j] * half[j] for j in range(3)] for i in range(3)]) @ R.transpose()
        done, shrink = False, ti.cast(1.0, ti.f64)
        for _ in range(HALVINGS):
            if not done:
                most = ti.cast(0.0, ti.f64)
                for c in range(4):
                    off = shrink * (H @ corner_direction(c))
                    corner = centre + off
                    holder = find_tet(maps, begin, candidates, grid, corner)
                    if holder < 0:
                        # The extension of each boundary tet meets that of the next with a gap that grows with the
                        # distance, which would tear a tetrahedron wholly outside: its corners share one tet.
                        holder = home
                        if depth <= off.norm():
                            holder = owner[nearest_sample(sample, sample_begin, grid, corner)]
                    weight = weights_of(maps, holder, corner)
                    host[g, c] = holder
                    for j in ti.static(range(4)):
                        weights[g, c, j] = ti.cast(weight[j], ti.f32)
                        most = ti.max(most, ti.abs(weight[j]))
                done = most <= MAX_WEIGHT
                shrink *= 0.5
        if not done:  # one tet holds all corners, as small as needed: |w| grows by at most 1 from the centre's
            most = ti.cast(1.0, ti.f64)
            for c in range(4):
                most = ti.max(most, ti.abs(weight_change(maps, home, H @ corner_direction(c))).max())
            for c in range(4):
                weight = own + weight_change(maps, home, H @ corner_direction(c)) / most
                host[g, c] = home
                for j in ti.static(range(4)):
                    weights[g, c, j] = ti.cast(weight[j], ti.f32)


@ti.func
def corner_direction(c):
    """Row c of CORNERS: corner c of a regular tetrahedron around the unit sphere."""
    r = ti.sqrt(ti.cast(3.0, ti.f64))
    y = r if c == 0 or c == 2 else -r
    return vec3(r if c < 2 else -r, y, r if c == 0 or c == 3 else -r)
