"""Cage as the paper makes it (VR-GS, Sec. 4.2): the level set's surface, decimated, filled by TetGen.

TetGen (Si 2015) can reject a surface, loop forever or crash: it runs as a process of its own, and its result is used
only if it is as good as any other cage must be.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from assets.asset import Cage
from core.distance_grid import DistanceGrid, marching_cubes
from core.errors import BadInput
from core.program import check_package, open3d
from core.tetmesh import triangle_areas
from prepare.cage.cage_file import checked_cage
from prepare.cage.cage_generation import EXACT_VERTICES, Stuffed, check_count, fault, fitted
from prepare.cage.embedding_hosts import fraction_inside
from prepare.cage.level_set import volume_of

WORKER = Path(__file__).with_name("tetgen_worker.py")
PYTHON = "VRGS_TETGEN_PYTHON"  # environment variable that names the interpreter with tetgen
INSTALL = "pip install -r requirements-tetgen.txt"
TIME_LIMIT = 120.0  # [s] of one run
MAX_RUNS = 6  # until the number of vertices is right
TETGEN_VERTEX_GOAL = 0.1  # of it; good enough to stop; 15 % is promised
OFFSETS = (0.08, 0.2, 0.35)  # edges outwards, tried in turn: flat triangles cut off what is round
RELAXATIONS = 2  # angles that are still too small after two stay so
MAX_TET_VOLUME = 1.5  # of a regular tet with the surface's edge
RATIO, DIHEDRAL = 1.5, 12.0  # asked of TetGen: circumradius over shortest edge, dihedral angle [degrees]


class MeshFailed(Exception):
    """TetGen gave no usable cage; the text is the reason, for the user."""


def interpreter() -> str:
    """Path of the Python that runs TetGen: that of VRGS_TETGEN_PYTHON, else this one."""
    return os.environ.get(PYTHON) or sys.executable


def check_installed() -> None:
    """Raise BadInput, with a remedy, unless TetGen can be run."""
    check_package("--mesher tetgen", "open3d", "requirements-tetgen.txt")
    probe = "import sys, importlib.util; sys.exit(importlib.util.find_spec('tetgen') is None)"
    try:
        missing = subprocess.run([interpreter(), "-I", "-c", probe], capture_output=True, timeout=60).returncode != 0
    except (OSError, subprocess.TimeoutExpired) as e:
        raise BadInput(f"{PYTHON}={interpreter()}: is not a Python that runs") from e
    if missing:
        raise BadInput(f"--mesher tetgen needs the package tetgen: {INSTALL}, or name a Python that has it in {PYTHON}")


def decimated(vertices: np.ndarray, faces: np.ndarray, triangles: int) -> tuple[np.ndarray, np.ndarray]:
    """Surface simplified to about `triangles` triangles, by quadric error (Garland and Heckbert 1997).

    Raises MeshFailed where the result is not a closed manifold or intersects itself: TetGen fills no such surface.
    """
    o3d = open3d("--mesher tetgen")
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.ascontiguousarray(vertices, np.float64)),
        o3d.utility.Vector3iVector(np.ascontiguousarray(faces, np.int32)),
    )
    mesh = mesh.filter_smooth_taubin(number_of_iterations=10)  # smooths the staircase of the cells without shrinking
    mesh = mesh.simplify_quadric_decimation(max(int(triangles), 8))
    mesh.remove_degenerate_triangles()
    mesh.remove_unreferenced_vertices()
    if not mesh.is_edge_manifold(allow_boundary_edges=False) or not mesh.is_vertex_manifold():
        raise MeshFailed("the decimated surface is not a closed manifold")
    if mesh.is_self_intersecting():
        raise MeshFailed("the decimated surface intersects itself")
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles, np.int32)


def run_tetgen(vertices: np.ndarray, faces: np.ndarray, maxvolume: float, *, limit: float = TIME_LIMIT) -> Cage:
    """Tets that fill a closed surface, none larger than `maxvolume`. Raises MeshFailed, BadInput."""
    with tempfile.TemporaryDirectory(prefix="vrgs-") as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npz"
        asked = {"maxvolume": maxvolume, "minratio": RATIO, "mindihedral": DIHEDRAL}
        np.savez(source, vertices=vertices, faces=faces, **asked)
        command = [interpreter(), "-I", str(WORKER), str(source), str(target)]  # -I: no path of this program
        try:
            done = subprocess.run(command, capture_output=True, timeout=limit, stdin=subprocess.DEVNULL)
        except subprocess.TimeoutExpired as e:
            raise MeshFailed(f"TetGen took more than {limit:.0f} s") from e
        except OSError as e:
            raise BadInput(f"{PYTHON}={interpreter()}: is not a Python that runs") from e
        if done.returncode == 3:
            raise BadInput(f"--mesher tetgen needs the package tetgen: {INSTALL}")
        if done.returncode < 0:
            raise MeshFailed(f"TetGen crashed ({signal.Signals(-done.returncode).name})")
        if done.returncode != 0 or not target.is_file():
            lines = done.stderr.decode(errors="replace").split("\n")
            said = next((line.strip() for line in reversed(lines) if line.strip()), f"status {done.returncode}")
            raise MeshFailed(f"TetGen gave up ({said[:120]})")
        with np.load(target, allow_pickle=False) as found:
            vertices, tets = found["vertices"], found["tets"]
            if vertices.ndim != 2 or vertices.shape[1] != 3 or tets.ndim != 2 or tets.shape[1] < 4:
                raise MeshFailed("it returned no tets")
            try:
                return checked_cage(vertices, tets[:, :4])
            except ValueError as e:
                raise MeshFailed(f"its mesh is no cage: {e}") from e


def tetgen_cage(
    phi: np.ndarray, points: np.ndarray, vertices: int, report: Callable[[float], None], exact: bool | None = None
) -> Cage:
    """Cage as of `cage_of`, by TetGen. Raises MeshFailed where none passes, BadInput without TetGen."""
    check_count(vertices)
    exact = vertices >= EXACT_VERTICES if exact is None else exact
    filled = volume_of(phi)
    edge = (1.6 * filled / vertices) ** (1 / 3)  # a guess, which runs correct; the finest meshes have 1.2
    reason = "no run gave the number of vertices"
    for step, offset in enumerate(OFFSETS):

        def progress(done: float, step=step) -> None:
            report((step + done) / len(OFFSETS))

        try:
            cage, edge = _meshed_to_count(phi, edge, offset, vertices, progress)
        except MeshFailed as e:  # another offset is another surface
            if "more than" in str(e):
                raise
            reason = str(e)
            continue
        reason = fault(cage, filled, fraction_inside(cage.vertices, cage.tets, points), vertices, exact)
        for _ in range(RELAXATIONS):  # moving the vertices improves angles and takes in points just outside
            if reason and "vertices" not in reason:
                cage, reason = fitted(Stuffed(cage, phi, edge), filled, points, vertices, exact)
        if not reason:
            return cage
    raise MeshFailed(reason)


def _meshed_to_count(phi: np.ndarray, edge: float, offset: float, vertices: int, report) -> tuple[Cage, float]:
    """Mesh of about `vertices` vertices of the surface `offset` edges outside, and the edge that gave it."""
    low, high = 0.0, np.inf
    for attempt in range(MAX_RUNS):
        report(attempt / MAX_RUNS)
        level, faces = marching_cubes(DistanceGrid(phi, np.zeros(3), 1.0), offset * edge)
        triangles = float(triangle_areas(level, faces).sum()) / (0.433 * edge**2)
        cage = run_tetgen(*decimated(level, faces, triangles), MAX_TET_VOLUME * edge**3 * 2**0.5 / 12)
        ratio = len(cage.vertices) / vertices
        if abs(ratio - 1) <= TETGEN_VERTEX_GOAL:
            break
        low, high = (edge, high) if ratio > 1 else (low, edge)  # a finer mesh has more
        edge *= ratio**0.4
        if not low < edge < high:
            edge = (low * high) ** 0.5
    return cage, edge
