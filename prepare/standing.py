"""Bodies that stand: without a thin flap that topples it, turned to rest, and stiff enough to bear its own weight.

A thin flap under a body, such as the care label of a toy, would become a pillar of the cage, whose tets are wider than
cloth: the body would topple from it. Where a body falls from the lowest thin part of it but stands without, that part
gets no tets; its Gaussians follow the nearest ones.

Files are seldom exactly level, and a coarse cage has feet of its own. Let go as it is, such a body lands on one of them
first, and that push may throw it over: it is turned by the few degrees by which its cage would lean before it rests.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace

import numpy as np
from scipy.ndimage import affine_transform, distance_transform_edt
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg, splu
from scipy.spatial import ConvexHull, QhullError

from assets.asset import Asset
from core.material import DEFAULT_MATERIAL, MATERIALS, Material
from core.rotation import rotation_between
from core.tetmesh import tet_volumes, vertex_components
from prepare.cage.level_set import ComponentSolid

UPRIGHT = 8.0  # [degrees] from its place in the file; what comes to rest farther has fallen
THIN = 0.1  # of the extent: feet and legs are thicker, or the body stands on them
MOST = 0.01  # of the body's cells: a label has half as many; what is larger is a leg on which it should stand


def flap_of(solid: np.ndarray) -> np.ndarray:
    """Mask of the cells (X, Y, Z) bool of the flap from which a solid (X, Y, Z) bool, +y up, would fall; or empty."""
    none = np.zeros_like(solid)
    if not solid.any() or lean_at_rest(solid) <= UPRIGHT:
        return none
    radius = 0.5 * THIN * max(np.ptp(np.argwhere(solid), axis=0))
    padded = np.pad(solid, 1)
    inner = distance_transform_edt(padded) > radius
    if not inner.any():
        return none
    thick = padded & (distance_transform_edt(~inner) <= radius)
    flap = solid & ~thick[1:-1, 1:-1, 1:-1]
    flap[:, np.flatnonzero(thick.any((0, 2)))[0] - 1 :] = False
    helps = 0 < flap.sum() <= MOST * solid.sum() and lean_at_rest(solid & ~flap) <= UPRIGHT
    return flap if helps else none


def lean_at_rest(solid: np.ndarray) -> float:
    """Angle [degrees] by which a homogeneous solid, cells (X, Y, Z) bool, leans where it comes to rest."""
    points = np.argwhere(solid).astype(np.float64)
    return lean_of(resting_normal(points, points.mean(0)))


def lean_of(normal: np.ndarray) -> float:
    """Angle [degrees] by which a body leans when it rests on a face with this outward normal (3,)."""
    return float(np.degrees(np.arccos(np.clip(-normal[1], -1.0, 1.0))))


def resting_normal(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Unit outward normal (3,) of the face on which the hull of points (N, 3) rests: its `centre` of mass is over it.

    Of several faces the lowest is taken. Points on a plane or a line, which have no hull, rest on -y.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return np.array([0.0, -1.0, 0.0])
    normal, offset = hull.equations[:, :3], hull.equations[:, 3]
    foot = centre - (normal @ centre + offset)[:, None] * normal
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    sides = [np.einsum("ni,ni->n", np.cross(q - p, foot - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    facing = np.sign(np.einsum("ni,ni->n", np.cross(b - a, c - a), normal))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rests = (np.array(sides) * facing > -1e-6 * area).all(0)
    return normal[rests][normal[rests, 1].argmin()]


LEANS = (1.0, 20.0)  # [degrees] that are taken out: less is not seen, and what leans more has fallen


def stood_up(asset: Asset, solids: list[ComponentSolid]) -> tuple[Asset, list[ComponentSolid]]:
    """The asset, and its solids, turned so that it rests where it is; the same if it does, or would fall far.

    The angle [degrees] is `stood_up` of the provenance.
    """
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    volume = tet_volumes(x, tets)
    normal = resting_normal(x, (x[tets].mean(1) * volume[:, None]).sum(0) / volume.sum())
    lean = lean_of(normal)
    if not LEANS[0] <= lean <= LEANS[1]:
        return asset, solids
    rotation = rotation_between(normal, (0.0, -1.0, 0.0))
    turned = asset.transformed(rotation)
    shift = np.array(turned.provenance["reoriented"][-1][2])
    provenance = asset.provenance | {"stood_up": round(lean, 1)}
    return replace(turned, provenance=provenance), [turned_solid(solid, rotation, shift) for solid in solids]


def turned_solid(solid: ComponentSolid, rotation: np.ndarray, shift: np.ndarray) -> ComponentSolid:
    """The solid turned by `rotation` (3, 3), then moved by `shift` (3,) [m]."""
    old, new = solid.distance, solid.distance.transformed(rotation, shift)
    offset = (rotation.T @ (new.origin - shift) - old.origin) / old.spacing
    cells = (
        affine_transform(c.astype(np.uint8), rotation.T, offset, new.values.shape, order=0).astype(bool)
        for c in (solid.shell, solid.solid)
    )
    return ComponentSolid(*cells, new)


GRAVITY = 9.81  # [m/s^2]
FOOT_HEIGHT = 0.08  # of a body's height: soles are that uneven, or pressed flat
BUCKLING_SHARE = 1 / 5  # of the load at which it would buckle: a body that leans then leans 1 / (1 - 1/5) as much
SAG_MAX = 0.05  # mean strain by which its weight shortens it
# Root mean squares over a uniform column, of its end's deflection and of its height at unit mean strain
COLUMN_BEND_RMS, COLUMN_SAG_RMS = 0.507, 0.730
DIRECT_SIZE = 5000  # vertices, above which the equations are solved by iteration
MASS_MAX = 3.0  # [kg] of an object without a named material: half of what a hand of 80 N can lift
NOD = 0.003  # extents by which its own weight may displace any part; the photographs already show it sagged


def suitable_material(vertices: np.ndarray, tets: np.ndarray) -> tuple[Material, dict[str, float]]:
    """The default material, stiffened if a body of this cage [m] needs that to bear its own weight; and its Young's
    modulus, as chosen and as needed, for the provenance."""
    usual = MATERIALS[DEFAULT_MATERIAL]
    needed = bearing_modulus(vertices, tets, usual)
    material = stiffened(usual, rounded_up(needed) if needed > usual.young else 0.0)
    return material, {"young": material.young, "needed": float(f"{needed:.3g}")}


def stiffened(material: Material, needed: float) -> Material:
    """The material with a Young's modulus of `needed` [Pa] at least, and not above that of wood."""
    return replace(material, young=max(material.young, min(needed, MATERIALS["wood"].young)))


def steady(
    material: Material, vertices: np.ndarray, tets: np.ndarray, down: np.ndarray, held: np.ndarray | None
) -> Material:
    """The material, stiffened if the weight of a body along `down` (3,) would move a part of it by more than NOD: it
    would not stay as it was photographed. `held`: vertices (V,) bool that are held fast; None: its foot."""
    moved = np.linalg.norm(bent_by_weight(vertices, tets, material, down, held), axis=1).max()
    return stiffened(material, material.young * float(moved / (NOD * np.ptp(vertices, axis=0).max())))


def liftable(material: Material, volume: float) -> Material:
    """The material of a body of this volume [m^3] that a hand can lift: lighter, as if it were hollow, and softer in
    proportion, since it carries less weight."""
    share = min(1.0, MASS_MAX / (material.density * volume))
    young = max(material.young * share, min(material.young, MATERIALS[DEFAULT_MATERIAL].young))
    return replace(material, density=share * material.density, young=young)


def described(found: dict[str, float]) -> str:
    """Line on the choice of `suitable_material`."""
    usual = MATERIALS[DEFAULT_MATERIAL].young
    text = f"; it needs {found['needed']:.1e} of its {usual:.0e} Pa"
    if found["young"] > usual:
        text = f", stiffened from {usual:.0e} to {found['young']:.0e} Pa, which so slender a shape needs"
    return f"material: {DEFAULT_MATERIAL}{text} to bear its own weight (--material NAME for another)"


def rounded_up(young: float) -> float:
    """The next of 1, 2, 5, 10, 20, ... [Pa]."""
    power = 10.0 ** np.floor(np.log10(young))
    return float(next(m * power for m in (1, 2, 5, 10) if m * power >= young * (1 - 1e-9)))


def bearing_modulus(vertices: np.ndarray, tets: np.ndarray, material: Material) -> float:
    """Smallest Young's modulus [Pa] with which a body of a material's density and Poisson's ratio bears its weight.

    vertices, tets  of its cage [m], +y up; of several pieces each must
    """
    piece, needed = vertex_components(tets), []
    for k in range(int(piece.max()) + 1):
        index, own = np.unique(tets[piece == k], return_inverse=True)
        x, own = vertices[index].astype(np.float64), own.reshape(-1, 4)
        mass = _masses(x, own, material.density)
        moved = deflections(unit_stiffness(x, own, material.poisson), mass * GRAVITY, foot_of(x, mass))
        rms = np.sqrt(np.einsum("v,vil,vil->l", mass, moved, moved) / mass.sum())  # under loads along x, y, z
        bend, sag = max(rms[0], rms[2]) / np.ptp(x[:, 1]), rms[1] / np.ptp(x[:, 1])
        needed.append(float(max(bend / (COLUMN_BEND_RMS * BUCKLING_SHARE), sag / (COLUMN_SAG_RMS * SAG_MAX))))
    return max(needed)


def bent_by_weight(
    vertices: np.ndarray, tets: np.ndarray, material: Material, down: np.ndarray, held: np.ndarray | None = None
) -> np.ndarray:
    """Displacements (V, 3) [m] of a cage in one piece by its weight along the unit vector `down`, with the vertices
    (V,) bool held, or its foot."""
    x = vertices.astype(np.float64)
    mass = _masses(x, tets, material.density)
    held = foot_of(x, mass) if held is None else held
    return deflections(unit_stiffness(x, tets, material.poisson), mass * GRAVITY, held) @ down / material.young


def _masses(x: np.ndarray, tets: np.ndarray, density: float) -> np.ndarray:
    return np.bincount(tets.ravel(), np.repeat(tet_volumes(x, tets) * density / 4, 4), len(x))


def foot_of(x: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Vertices (V,) bool that a body stands on: its lowest ones, as many as it takes to have its weight above them."""
    low = x[:, 1] - x[:, 1].min()
    order, middle = np.argsort(low), (mass @ x / mass.sum())[[0, 2]]
    fewest = max(int((low <= FOOT_HEIGHT * low.max()).sum()), 3)
    own = x[order][:, [0, 2]]
    count = bisect_left(range(len(x)), True, lo=fewest, hi=len(x) - 1, key=lambda n: holds_centre(own[:n], middle))
    return low <= low[order[count - 1]]


def holds_centre(points: np.ndarray, centre: np.ndarray) -> bool:
    """True if a point (2,) lies within the convex hull of points (N, 2): they are not in a half plane."""
    angle = np.sort(np.arctan2(*(points - centre).T))
    return bool(np.diff(angle, append=angle[0] + 2 * np.pi).max() < np.pi)


def unit_stiffness(x: np.ndarray, tets: np.ndarray, poisson: float) -> csr_matrix:
    """Stiffness matrix of linear tets for a Young's modulus of 1 Pa, (3V, 3V): sum over tets of V B^T C B."""
    edges = np.swapaxes(x[tets[:, 1:]] - x[tets[:, :1]], 1, 2)  # columns
    inverse = np.linalg.inv(edges)  # rows: gradients of the last three corners' shape functions
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)  # (T, 4, 3)
    volume = np.linalg.det(edges) / 6
    mu, lam = 0.5 / (1 + poisson), poisson / ((1 + poisson) * (1 - 2 * poisson))
    # K_aibj = V (lam g_ai g_bj + mu g_aj g_bi + mu delta_ij g_a . g_b)
    outer = np.einsum("tai,tbj->taibj", gradients, gradients)
    dots = np.einsum("tai,tbi->tab", gradients, gradients)
    blocks = lam * outer + mu * np.swapaxes(outer, 2, 4) + mu * np.einsum("tab,ij->taibj", dots, np.eye(3))
    blocks *= volume[:, None, None, None, None]
    dof = (3 * tets[:, :, None] + np.arange(3)).reshape(len(tets), 12)
    rows, columns = np.repeat(dof, 12, axis=1), np.tile(dof, (1, 12))
    size = 3 * len(x)
    return coo_matrix((blocks.reshape(len(tets), -1).ravel(), (rows.ravel(), columns.ravel())), (size, size)).tocsr()


def deflections(stiffness: csr_matrix, weight: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Displacements (V, 3, 3) [m] under weights (V,) [N] along x, y and z in turn, of vertices that are not held."""
    free = np.flatnonzero(~np.repeat(held, 3))
    matrix = stiffness[free][:, free]
    loads = np.stack([np.kron(weight, axis) for axis in np.eye(3)], axis=1)[free]
    moved = np.zeros((3 * len(weight), 3))
    if len(weight) <= DIRECT_SIZE:
        moved[free] = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(loads)
    else:
        inverse_diagonal = diags(1 / matrix.diagonal())
        for k in range(3):
            moved[free, k] = cg(matrix, loads[:, k], rtol=1e-3, maxiter=5000, M=inverse_diagonal)[0]
    return moved.reshape(-1, 3, 3)
