"""An asset: what `prepare` makes of a capture and a scene loads. One HDF5 file, checked on load."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from assets import quantisation
from assets.animation import Animation, read_animation, write_animation
from assets.environment import Environment, read_environment, write_environment
from assets.file_access import atomic_write
from assets.fitted_clip import FittedClip, read_clip_group, write_clip
from assets.gaussians import ROWS, Gaussians, usable_view
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, write_dataset, write_text
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.point_location import TetLocator
from core.rotation import quaternions_from_matrices
from core.tetmesh import enclosed_volume, tet_volumes, vertex_components

FORMAT = "vrgs-asset"
LOSSLESS, QUANTISED = 1, 2  # versions of the format

SIZE_RANGE = (0.01, 10.0)  # [m] largest extent of a body
LEVEL = 1 - 1e-6  # least cosine of the vertical to itself where floors stay level
INTEGER_DATASETS = {"object_id": np.uint16, "tets": np.int32, "surface": np.int32, "host": np.int32}

WEIGHT_SUM_TOLERANCE = 1e-3  # of the four weights of a corner, as float32 rounds weights of some hundreds
VOLUME_TOLERANCE = 1e-3  # relative, between a cage's tets and its surface

# Attributes of `material` that a file may lack, and what that stands for.
OPTIONAL_MATERIAL = {name: getattr(Material, name) for name in ("damping", "kinetic_friction", "yield_strain")}


@dataclass(frozen=True)
class Cage:
    """The tetrahedra that are simulated.

    vertices  rest positions [m], (V, 3) float32
    tets      vertex indices, (T, 4) int32; det[x1-x0, x2-x0, x3-x0] > 0
    surface   triangles, (S, 3) int32, counter-clockwise seen from outside
    """

    vertices: np.ndarray
    tets: np.ndarray
    surface: np.ndarray

    def volumes(self) -> np.ndarray:
        """Signed volume of each tet [m^3], (T,) float64."""
        return tet_volumes(self.vertices, self.tets)

    def check(self, where: str) -> None:
        """Raise BadInput unless all tets are positive, all vertices have mass and the surface is theirs, outward."""
        count = len(self.vertices)
        for name, width in (("vertices", 3), ("tets", 4), ("surface", 3)):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[1] != width or shape[0] == 0:
                raise BadInput(f"{where}: cage {name} has shape {shape}, expected (*, {width})")
        if not np.isfinite(self.vertices).all():
            raise BadInput(f"{where}: a cage vertex is not finite")
        for name, index in (("tets", self.tets), ("surface", self.surface)):
            if index.min() < 0 or index.max() >= count:
                raise BadInput(f"{where}: cage {name} name a vertex outside 0..{count - 1}")
        volumes = self.volumes()
        if not (volumes > 0).all():
            raise BadInput(f"{where}: {int((~(volumes > 0)).sum())} cage tets have no positive volume")
        used = len(np.unique(self.tets))
        if used != count:
            raise BadInput(f"{where}: {count - used} cage vertices belong to no tet")
        enclosed, filled = enclosed_volume(self.vertices, self.surface), volumes.sum()
        if abs(enclosed - filled) > VOLUME_TOLERANCE * filled:
            raise BadInput(f"{where}: the cage's surface encloses {enclosed:.4g} m^3, its tets fill {filled:.4g}")


@dataclass(frozen=True)
class CageEmbedding:
    """The four corners of each Gaussian's local tetrahedron in the cage (VR-GS, Sec. 4.3.2).

    host     host tet of each corner, (N, 4) int32
    weights  row k = barycentric weights of corner k in tet host[k], (N, 4, 4) float32; rows sum to 1
    """

    host: np.ndarray
    weights: np.ndarray

    def check(self, gaussians: int, tets: int, where: str) -> None:
        """Raise BadInput unless each of the Gaussians' corners has a host and weights that sum to 1."""
        if self.host.shape != (gaussians, 4) or self.weights.shape != (gaussians, 4, 4):
            raise BadInput(f"{where}: the embedding has {len(self.host)} rows for {gaussians} Gaussians")
        if self.host.min() < 0 or self.host.max() >= tets:
            raise BadInput(f"{where}: the embedding names a tet outside 0..{tets - 1}")
        if not np.isfinite(self.weights).all():
            raise BadInput(f"{where}: an embedding weight is not finite")
        if np.abs(self.weights.sum(axis=2, dtype=np.float64) - 1).max() > WEIGHT_SUM_TOLERANCE:
            raise BadInput(f"{where}: embedding weights do not sum to 1")


@dataclass(frozen=True)
class Asset:
    """Gaussians, and the data that makes them touchable; all in the asset's frame.

    cage, embedding  the simulated mesh and the Gaussians' coordinates in it; static assets have neither
    sdf              signed distance grid for contacts
    material         None: not known
    provenance       any JSON object
    environment      a static scene to play in
    animation        a motion of the body's own
    clip             the film that the material was fitted to
    """

    gaussians: Gaussians
    cage: Cage | None = None
    embedding: CageEmbedding | None = None
    sdf: DistanceGrid | None = None
    material: Material | None = None
    provenance: dict = field(default_factory=dict)
    environment: Environment | None = None
    animation: Animation | None = None
    clip: FittedClip | None = None

    @property
    def grids(self) -> list[DistanceGrid]:
        """The asset's distance grid and the finer ones of its environment."""
        fine = self.environment.fine_grids if self.environment is not None else ()
        return [grid for grid in (self.sdf, *fine) if grid is not None]

    def check(self, where: str) -> None:
        """Raise BadInput, naming `where`, unless all that the asset holds is sound and agrees."""
        self.gaussians.check(where)
        needs_cage = {"an embedding": self.embedding, "an animation": self.animation, "a clip": self.clip}
        for name, value in needs_cage.items():
            if value is not None and self.cage is None:
                raise BadInput(f"{where}: has {name} but no cage")
        if self.cage is not None:
            self.cage.check(where)
        if self.embedding is not None:
            self.embedding.check(len(self.gaussians), len(self.cage.tets), where)
        for grid in self.grids:
            grid.check(where)
        if self.material is not None:
            self.material.check(where)
        if self.animation is not None:
            self.animation.check(len(self.cage.vertices), where)
        if self.clip is not None:
            self.clip.check(len(self.cage.vertices), where)

    def transformed(self, rotation: np.ndarray, factor: float = 1.0) -> Asset:
        """The asset turned by `rotation` (3, 3) and made `factor` times as large, without being prepared again.

        A body stands on y = 0 again, in the middle of its footprint; a cage's tets and the embedding stay what they
        were, as both are affine. In a room that is tilted, floor, planes and places are found anew; its floor comes to
        y = 0. Raises BadInput for a body with a motion of its own, for a room without a floor, and for a size that no
        body can have.
        """
        rotation = np.asarray(rotation, np.float64)
        if self.animation is not None:
            raise BadInput("its frame is that of its motion: it can be turned and scaled for this play only")
        if not (np.isfinite(factor) and factor > 0.0):
            raise BadInput(f"an asset cannot be made {factor:g} times as large")
        shift, cage, environment = np.zeros(3), self.cage, self.environment
        if cage is not None:
            x = factor * (cage.vertices.astype(np.float64) @ rotation.T)
            low, high = x.min(0), x.max(0)
            size = (high - low).max()
            if not SIZE_RANGE[0] <= size <= SIZE_RANGE[1]:
                raise BadInput(f"a size of {size:.3g} m is out of range ({SIZE_RANGE[0]} to {SIZE_RANGE[1]:g})")
            shift = -np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
            cage = Cage((x + shift).astype(np.float32), cage.tets, cage.surface)
        tilted = environment is not None and rotation[1, 1] < LEVEL
        if tilted:
            from assets.orientation import floor_height

            shift = np.array([0.0, -floor_height(self.gaussians.transformed(rotation, shift, factor)), 0.0])
        g = self.gaussians.transformed(rotation, shift, factor)
        grid = None if self.sdf is None else self.sdf.transformed(rotation, shift, factor)
        if environment is not None:
            environment = environment.transformed(rotation, shift, factor)
        if tilted:
            eye_height = factor * (self.environment.eye_position[1] - self.environment.floor_height)
            environment = environment.relevelled(g, grid, eye_height)
        last = [quaternions_from_matrices(rotation).tolist(), float(factor), shift.tolist()]
        provenance = self.provenance | {"reoriented": [*self.provenance.get("reoriented", []), last]}
        if "size" in provenance:
            provenance["size"] = float(provenance["size"]) * factor
        made = replace(self, gaussians=g, cage=cage, sdf=grid, environment=environment, provenance=provenance)
        return made if factor == 1.0 else replace(made, clip=None)  # of another size it moves otherwise

    @classmethod
    def load(cls, path: str | Path) -> Asset:
        """Read and check an asset file. Raises BadInput."""
        with open_hdf5(Path(path)) as file:
            quantised = _version(file) == QUANTISED
            gaussians = quantisation.read_quantised_gaussians(file) if quantised else _read_gaussians(file)
            objects = file.json("", "objects", tuple[str, ...], default="[]")
            antialias = file.has_attribute("", "antialias") and file.number("", "antialias") == 1
            sort = file.text("", "sort", default="")
            seen = all(file.has_attribute("", name) for name in ("eye", "target", "around"))
            places = (*file.vector("", "eye"), *file.vector("", "target"), file.number("", "around")) if seen else ()
            view = usable_view(places)
            gaussians = replace(gaussians, objects=objects, sort=sort, antialias=antialias, view=view)
            cage = embedding = None
            if file.has("cage"):
                tets, surface = (file.indices(f"cage/{name}", (None, n)) for name, n in (("tets", 4), ("surface", 3)))
                cage = Cage(file.floats("cage/vertices", (None, 3)), tets, surface)
            if file.has("embedding") and quantised:
                if cage is None:
                    raise file.error("has an embedding but no cage")
                gaussians.check(str(path))  # the weights are computed from both
                cage.check(str(path))
                embedding = CageEmbedding(*quantisation.read_quantised_embedding(file, gaussians, cage))
            elif file.has("embedding"):
                host = file.indices("embedding/host", (None, 4))
                embedding = CageEmbedding(host, file.floats("embedding/weights", (len(host), 4, 4)))
            asset = cls(
                gaussians,
                cage,
                embedding,
                quantisation.read_grid(file, "sdf/values") if file.has("sdf") else None,
                read_material(file),
                file.json("", "provenance", dict[str, Any]),
                read_environment(file) if file.has("stage") else None,
                read_animation(file) if file.has("animation") else None,
                read_clip_group(file) if file.has("clip") else None,
            )
        asset.check(str(path))
        return asset

    def save(self, path: str | Path, *, quantised: bool = False) -> None:
        """Write the asset, compressed, in one step: either the whole file or none. Raises BadInput.

        `quantised` stores Gaussians, embedding and distance grids quantised, with the losses of assets/quantisation.py.
        """
        self.check(str(path))
        libver = ("v110", "v110") if quantised else None  # 20 kB less, but HDF5 of before 2016 cannot read it
        with atomic_write(path) as beside, new_hdf5(beside, libver) as file:
            write_text(file, "format", FORMAT)
            file.attrs["version"] = QUANTISED if quantised else LOSSLESS
            write_text(file, "provenance", json.dumps(self.provenance))
            if self.gaussians.objects:
                write_text(file, "objects", json.dumps(self.gaussians.objects))
            if self.gaussians.sort:
                write_text(file, "sort", self.gaussians.sort)
            if self.gaussians.antialias:
                file.attrs["antialias"] = 1
            if self.gaussians.view:
                view = self.gaussians.view
                file.attrs["eye"], file.attrs["target"], file.attrs["around"] = view[:3], view[3:6], view[6]
            lossless = [] if quantised else [("gaussians", self.gaussians, ROWS)]
            if self.cage is not None:
                lossless.append(("cage", self.cage, ("vertices", "tets", "surface")))
            if quantised:
                quantisation.write_quantised_gaussians(file, self.gaussians)
            if self.embedding is not None and quantised:
                quantisation.write_quantised_embedding(
                    file, self.embedding.host, self.embedding.weights, self.gaussians, self.cage
                )
            elif self.embedding is not None:
                lossless.append(("embedding", self.embedding, ("host", "weights")))
            for group, arrays, names in lossless:
                for name in names:
                    dtype = INTEGER_DATASETS.get(name, np.float32)
                    write_dataset(file, f"{group}/{name}", getattr(arrays, name), dtype)
            if self.sdf is not None:
                quantisation.write_grid(file, "sdf/values", self.sdf, quantised=quantised)
            if self.environment is not None:
                write_environment(file, self.environment, quantised=quantised)
            if self.material is not None:
                attributes = file.create_group("material").attrs
                for name, value in asdict(self.material).items():
                    if name not in OPTIONAL_MATERIAL or value != OPTIONAL_MATERIAL[name]:
                        attributes[name] = float(value)
            if self.animation is not None:
                write_animation(file, self.animation)
            if self.clip is not None:
                write_clip(file, self.clip)


def is_quantised(path: str | Path) -> bool:
    """True if an asset file stores its numbers quantised. Raises BadInput."""
    with open_hdf5(Path(path)) as file:
        return _version(file) == QUANTISED


def read_material(file: Hdf5Reader) -> Material | None:
    """The material of an open asset file, not checked; None if it has none. Raises BadInput."""
    if not file.has("material"):
        return None
    optional = [name for name in OPTIONAL_MATERIAL if file.has_attribute("material", name)]
    names = [*("young", "poisson", "density", "friction"), *optional]
    return Material(**{name: file.number("material", name) for name in names})


def _version(file: Hdf5Reader) -> int:
    """The version of an asset file: LOSSLESS or QUANTISED. Raises BadInput."""
    if file.text("", "format") != FORMAT:
        raise file.error(f"not a {FORMAT} file")
    version = file.number("", "version")
    if version not in (LOSSLESS, QUANTISED):
        hint = "; a newer program wrote it" if version > QUANTISED else ""
        raise file.error(f"version {version:g} of the format, this program reads {LOSSLESS} and {QUANTISED}{hint}")
    return int(version)


def _read_gaussians(file: Hdf5Reader) -> Gaussians:
    means = file.floats("gaussians/means", (None, 3))
    n = len(means)
    return Gaussians(
        means,
        file.floats("gaussians/quats", (n, 4)),
        file.floats("gaussians/log_scales", (n, 3)),
        file.floats("gaussians/logit_opacities", (n,)),
        file.floats("gaussians/sh", (n, None, 3)),
        file.indices("gaussians/object_id", (n,), np.uint16),
    )


def split_components(asset: Asset) -> list[Asset]:
    """The asset's components, the largest first, in its own frame: [asset] if it is connected, or has no cage.

    The solver treats a body as one thing: it damps relative to one rigid motion, restores one shape, and ignores
    contacts between points close at rest. So separate components become separate bodies. Gaussians go to the component
    that holds most of their corners. The asset's distance grid is that of all components together, so they have none
    (the solver makes its own). An animated asset stays whole.
    """
    if asset.cage is None or asset.embedding is None or asset.animation is not None:
        return [asset]
    cage, embedding = asset.cage, asset.embedding
    tet_component = vertex_components(cage.tets)
    count = int(tet_component.max()) + 1
    if count == 1:
        return [asset]
    component = np.empty(len(cage.vertices), np.int64)  # of each vertex
    component[cage.tets] = tet_component[:, None]
    corner_component = tet_component[embedding.host]
    home = np.array([(corner_component == k).sum(1) for k in range(count)]).argmax(0)
    found = []
    for k in range(count):
        vertex_index = np.cumsum(component == k) - 1
        tet_index = np.cumsum(tet_component == k) - 1
        mine = home == k
        host, weights = _rehosted(asset, mine, tet_component == k)
        own = Cage(
            cage.vertices[component == k],
            vertex_index[cage.tets[tet_component == k]].astype(np.int32),
            vertex_index[cage.surface[component[cage.surface[:, 0]] == k]].astype(np.int32),
        )
        hosts = CageEmbedding(tet_index[host].astype(np.int32), weights)
        parts = {"gaussians": asset.gaussians.select(mine), "cage": own, "embedding": hosts}
        found.append(replace(asset, **parts, sdf=None, clip=None))
    return found


def _rehosted(asset: Asset, mine: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hosts and weights of the Gaussians `mine` (N,), with all corners in the tets `own` (T,) of their component.

    A corner in another component's tet goes to the tet of one that is not; its weights extrapolate there.
    """
    x, tets = asset.cage.vertices.astype(np.float64), asset.cage.tets
    host, weights = asset.embedding.host[mine].copy(), asset.embedding.weights[mine].copy()
    row, corner = np.nonzero(~own[host])
    if len(row):
        position = np.einsum("nj,njc->nc", weights[row, corner], x[tets[host[row, corner]]])
        tet = host[row, np.argmax(own[host[row]], axis=1)]
        host[row, corner], weights[row, corner] = tet, TetLocator(x, tets).weights(tet, position)
    return host, weights
