"""A cage as the paper makes it (VR-GS, Sec. 4.2): the level set's surface, decimated, filled by TetGen.

TetGen (Si 2015) can refuse a surface, run for ever or crash: it runs as a process of its own, and what it
returns is used only if it is as good as any other cage must be.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from assets.asset import Cage
from core.errors import BadInput
from core.tetmesh import boundary_surface, face_components, tet_volumes
from prepare.cage.cage import EXACT, Stuffed, check_count, fault, fitted, share_inside
from prepare.cage.isosurface import areas, marching_cubes
from prepare.cage.level_set import volume_of
from prepare.cage.mesh_quality import non_manifold_vertices

WORKER = Path(__file__).with_name("tetgen_worker.py")
PYTHON = "VRGS_TETGEN_PYTHON"  # names the interpreter that has tetgen
INSTALL = "pip install -r requirements-tetgen.txt"
LIMIT = 120.0  # [s] that TetGen may take
TRIES = 6  # runs until the number of vertices is right
CLOSE = 0.1  # of it: good enough to stop; 15 % is promised
OFFSETS = (0.08, 0.2, 0.35)  # edges outwards: flat triangles cut off what is round
MENDINGS = 2  # relaxations; angles that are still too small after two stay so
VOLUME = 1.5  # of a regular tet with the surface's edge: the largest tets
RATIO, DIHEDRAL = 1.5, 12.0  # radius over shortest edge, [degrees]: what TetGen is asked for


class NoMesh(Exception):
    """TetGen gave no cage that can be used; the text is a reason for people."""


def interpreter() -> str:
    """The Python that runs TetGen: that of VRGS_TETGEN_PYTHON, else this one."""
    return os.environ.get(PYTHON) or sys.executable


def check_installed() -> None:
    """Raise BadInput, with what to do, unless TetGen can be run."""
    probe = "import sys, importlib.util; sys.exit(importlib.util.find_spec('tetgen') is None)"
    try:
        missing = subprocess.run([interpreter(), "-I", "-c", probe], capture_output=True, timeout=60).returncode != 0
    except (OSError, subprocess.TimeoutExpired) as e:
        raise BadInput(f"{PYTHON}={interpreter()}: is no Python that runs") from e
    if missing:
        raise BadInput(f"--mesher tetgen needs the package tetgen: {INSTALL}, or name a Python that has it in {PYTHON}")


def decimated(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface with about `triangles` triangles, by quadric error (Garland and Heckbert 1997).

    Raises NoMesh where the result is not closed, not a manifold, or cuts itself: TetGen fills no such surface.
    """
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.ascontiguousarray(vertices, np.float64)),
        o3d.utility.Vector3iVector(np.ascontiguousarray(faces, np.int32)),
    )
    mesh = mesh.filter_smooth_taubin(number_of_iterations=10)  # the staircase of the cells, without shrinking
    mesh = mesh.simplify_quadric_decimation(max(int(triangles), 8))
    mesh.remove_degenerate_triangles()
    mesh.remove_unreferenced_vertices()
    if not mesh.is_edge_manifold(allow_boundary_edges=False) or not mesh.is_vertex_manifold():
        raise NoMesh("the decimated surface is not a closed manifold")
    if mesh.is_self_intersecting():
        raise NoMesh("the decimated surface cuts itself")
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles, np.int32)


def run_tetgen(vertices: np.ndarray, faces: np.ndarray, maxvolume: float, *, limit: float = LIMIT) -> Cage:
    """The tets that fill a closed surface, none larger than `maxvolume`. Raises NoMesh, BadInput."""
    with tempfile.TemporaryDirectory(prefix="vrgs-") as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        asked = {"maxvolume": maxvolume, "minratio": RATIO, "mindihedral": DIHEDRAL}
        np.savez(source, vertices=vertices, faces=faces, **asked)
        command = [interpreter(), "-I", str(WORKER), str(source), str(target)]  # -I: prepare/ holds a tetgen.py, too
        try:
            done = subprocess.run(command, capture_output=True, timeout=limit, stdin=subprocess.DEVNULL)
        except subprocess.TimeoutExpired as e:
            raise NoMesh(f"TetGen took more than {limit:.0f} s") from e
        except OSError as e:
            raise BadInput(f"{PYTHON}={interpreter()}: is no Python that runs") from e
        if done.returncode == 3:
            raise BadInput(f"--mesher tetgen needs the package tetgen: {INSTALL}")
        if done.returncode < 0:
            raise NoMesh(f"TetGen crashed ({signal.Signals(-done.returncode).name})")
        if done.returncode != 0 or not target.is_file():
            lines = done.stderr.decode(errors="replace").split("\n")
            said = next((line.strip() for line in reversed(lines) if line.strip()), f"status {done.returncode}")
            raise NoMesh(f"TetGen gave up ({said[:120]})")
        with np.load(target, allow_pickle=False) as found:
            return sound(found["vertices"], found["tets"])


def sound(vertices: np.ndarray, tets: np.ndarray) -> Cage:
    """A Cage of finite vertices and tets of positive volume in one closed piece, or NoMesh."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or tets.ndim != 2 or tets.shape[1] < 4 or not len(tets):
        raise NoMesh("TetGen returned no tets")
    tets = tets[:, :4]
    if tets.min() < 0 or tets.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise NoMesh("TetGen returned indices or positions out of range")
    used, tets = np.unique(tets, return_inverse=True)
    vertices = vertices[used].astype(np.float32)
    tets = tets.reshape(-1, 4).astype(np.int32)
    turned = tet_volumes(vertices, tets) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    if not (tet_volumes(vertices, tets) > 0).all():
        raise NoMesh("TetGen returned tets without volume")
    surface = boundary_surface(tets)
    if len(non_manifold_vertices(surface)) or face_components(tets).max() > 0:
        raise NoMesh("TetGen's mesh is not one closed manifold")
    return Cage(vertices, tets, surface)


def first_edge(area: float, volume: float, vertices: int) -> float:
    """Edge of a mesh with about `vertices` vertices: those on the surface, and an even filling less half a layer."""
    low, high = 1e-3, 1e3
    for _ in range(60):
        h = (low * high) ** 0.5
        inner = max(volume - 0.8 * h * area, 0.0)
        count = area / (0.866 * h * h) + 1.2 * inner / h**3
        low, high = (h, high) if count > vertices else (low, h)
    return h


def tetgen_cage(
    phi: np.ndarray, points: np.ndarray, vertices: int, report: Callable[[float], None], exact: bool | None = None
) -> Cage:
    """As prepare.cage.cage.cage_of, by TetGen. Raises NoMesh, with the reason, where no cage passes; BadInput without it."""
    check_count(vertices)
    exact = vertices >= EXACT if exact is None else exact
    filled = volume_of(phi)
    level, faces = marching_cubes(phi, np.zeros(3), 1.0)
    edge = first_edge(float(areas(level, faces).sum()), filled, vertices)
    reason = "no run gave the number of vertices"
    for step, offset in enumerate(OFFSETS):
        share = partial(_share, report, step)
        try:
            cage, edge = _counted(phi, edge, offset, vertices, share)
        except NoMesh as e:  # another offset is another surface
            if "more than" in str(e):
                raise
            reason = str(e)
            continue
        reason = fault(cage, filled, share_inside(cage, points), vertices, exact)
        for _ in range(MENDINGS):  # moving the vertices mends angles, and what is just outside
            if reason and "vertices" not in reason:
                cage, reason = fitted(Stuffed(cage, phi, edge), filled, points, vertices, exact)
        if not reason:
            return cage
    raise NoMesh(reason)


def _share(report, step: int, done: float) -> None:
    report((step + done) / len(OFFSETS))


def _counted(phi: np.ndarray, edge: float, offset: float, vertices: int, report) -> tuple[Cage, float]:
    """A mesh of about so many vertices of the surface `offset` edges outside, and the edge that gave it."""
    low, high = 0.0, np.inf
    for attempt in range(TRIES):
        report(attempt / TRIES)
        level, faces = marching_cubes(phi, np.zeros(3), 1.0, offset * edge)
        triangles = float(areas(level, faces).sum()) / (0.433 * edge**2)
        cage = run_tetgen(*decimated(level, faces, triangles), VOLUME * edge**3 * 2**0.5 / 12)
        share = len(cage.vertices) / vertices
        if abs(share - 1) <= CLOSE:
            break
        low, high = (edge, high) if share > 1 else (low, edge)  # a finer one has more
        edge *= share**0.4
        if not low < edge < high:
            edge = (low * high) ** 0.5
    return cage, edge
