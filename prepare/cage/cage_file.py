"""Cages that the user brings: the tetrahedral mesh of an OpenUSD file, read in a process with limits."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from assets.asset import Cage
from assets.file_access import file_size
from assets.images import without_stderr
from core.errors import BadInput
from core.program import USD, check_usd
from core.tetmesh import boundary_surface, face_components, positively_oriented, tet_volumes
from prepare.cage.mesh_quality import non_manifold_vertices
from prepare.child_process import ChildProcess

FILE_MAX = 1 << 30  # [bytes]
VERTICES_MAX, TETS_MAX = 100_000, 1_000_000  # of a cage; a solver could not take more
MEMORY_MAX = 4 << 30  # [bytes] of address space of the process: OpenUSD itself takes 1 GiB
PATIENCE = 60  # [s]


def read_cage(path: str | Path) -> Cage:
    """The only tetrahedral mesh of a file, in the world of its stage, as a cage. Raises BadInput.

    Neither units nor axes are converted: the numbers are those of the splat that it is for.
    """
    path = Path(path)
    if path.suffix.lower() not in USD:
        raise BadInput(f"{path}: a cage is an OpenUSD file, {', '.join(USD)}")
    if file_size(path) > FILE_MAX:
        raise BadInput(f"{path}: larger than {FILE_MAX >> 30} GiB")
    check_usd(f"{path}: a cage of OpenUSD")
    child = ChildProcess(serve, str(path.resolve()), patience=PATIENCE, library="OpenUSD")
    fault = child.answer().decode()
    if fault:
        raise BadInput(f"{path}: {fault}")
    points, tets = np.frombuffer(child.answer(), np.float64), np.frombuffer(child.answer(), np.int64)
    try:
        return checked_cage(points.reshape(-1, 3), tets.reshape(-1, 4))
    except ValueError as e:
        raise BadInput(f"{path}: its tetrahedral mesh is no cage: {e}") from e


def checked_cage(vertices: np.ndarray, tets: np.ndarray) -> Cage:
    """Cage of finite vertices (V, 3) and tets (T, 4) of any orientation, in one closed component; vertices of no tet
    are left out. Raises ValueError with the reason why there is none."""
    if not len(tets):
        raise ValueError("there are no tets")
    if tets.min() < 0 or tets.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise ValueError("indices or positions are out of range")
    used, tets = np.unique(tets, return_inverse=True)
    vertices = vertices[used].astype(np.float32)
    tets = positively_oriented(vertices, tets.reshape(-1, 4).astype(np.int32))
    if not (tet_volumes(vertices, tets) > 0).all():
        raise ValueError("there are tets without volume")
    surface = boundary_surface(tets)
    if len(non_manifold_vertices(surface)) or face_components(tets).max() > 0:
        raise ValueError("it is not one closed manifold")
    return Cage(vertices, tets, surface)


def serve(pipe: Connection, path: str) -> None:
    """Read a file, in its own process: the answer is an empty text, the points (V, 3) float64 and the tets (T, 4)
    int64; or a fault in words."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the program ends this process
    os.environ["PXR_WORK_THREAD_LIMIT"] = "1"  # each thread reserves address space
    with without_stderr(), suppress(EOFError, OSError):
        try:
            points, tets = tet_mesh(path)
        except (ImportError, MemoryError, RuntimeError, ValueError) as e:
            pipe.send_bytes((" ".join(str(e).split())[:120] or "it needs too much memory").encode())
            return
        for answer in (b"", points.tobytes(), tets.tobytes()):
            pipe.send_bytes(answer)


def tet_mesh(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Points in the world (V, 3) float64 and tets (T, 4) int64 of a file's only tetrahedral mesh. Raises RuntimeError,
    ValueError."""
    from pxr import Tf, Usd, UsdGeom

    if os.name == "posix":
        import resource

        limits = {resource.RLIMIT_AS: MEMORY_MAX, resource.RLIMIT_CPU: PATIENCE, resource.RLIMIT_FSIZE: 0}
        for limit, most in limits.items():
            with suppress(ValueError, OSError):  # some systems know not all of them
                resource.setrlimit(limit, (most, most))
    try:
        stage = Usd.Stage.Open(path)
    except Tf.ErrorException as e:
        raise ValueError("OpenUSD cannot read it") from e
    found = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.TetMesh)]
    if len(found) != 1:
        raise ValueError(f"holds {len(found)} tetrahedral meshes, expected 1")
    mesh = UsdGeom.TetMesh(found[0])
    values = []
    for attribute in (mesh.GetPointsAttr(), mesh.GetTetVertexIndicesAttr()):
        value = attribute.Get()
        values.append(attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value)
    if any(value is None for value in values) or len(values[0]) > VERTICES_MAX or len(values[1]) > TETS_MAX:
        raise ValueError(f"{found[0].GetPath()} has no points or tets, or more than {VERTICES_MAX} or {TETS_MAX}")
    world = np.array(UsdGeom.XformCache(Usd.TimeCode.EarliestTime()).GetLocalToWorldTransform(found[0]))
    points, tets = np.array(values[0], np.float64), np.array(values[1], np.int64)
    return points @ world[:3, :3] + world[3, :3], tets
