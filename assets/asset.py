"""An asset: what prepare makes of a capture and a scene loads. One HDF5 file, checked on load."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import h5py
import numpy as np

from assets.animation import Animation
from assets.animation_file import read_animation, write_animation
from assets.asset_check import check
from assets.environment import Environment, read_environment, write_environment
from assets.file_access import atomic_write
from assets.gaussians import Gaussians
from assets.hdf5 import Hdf5Reader, open_hdf5
from core.distance_grid import DistanceGrid
from core.material import Material
from core.tetmesh import tet_volumes

FORMAT = "vrgs-asset"
VERSION = 1

# Attributes of `material` that a file may lack, and what that stands for.
OPTIONAL_MATERIAL = {f.name: f.default for f in fields(Material) if f.name in ("damping", "kinetic_friction")}


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


@dataclass(frozen=True)
class CageEmbedding:
    """Where the four corners of each Gaussian's local tetrahedron lie in the cage (VR-GS, Sec. 4.3.2).

    host     host tet of each corner, (N, 4) int32
    weights  row k = barycentric weights of corner k in tet host[k], (N, 4, 4) float32; rows sum to 1
    """

    host: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class Asset:
    """Gaussians, and for what can be touched a cage, its embedding and a distance grid; all in the asset's frame.

    `provenance` is any JSON object; `thumbnail` is a small PNG, (K,) uint8 (assets/images.py). `stage`: a static scene to play
    in. With an `animation` the body moves by itself.
    """

    gaussians: Gaussians
    cage: Cage | None = None
    embedded: CageEmbedding | None = None
    sdf: DistanceGrid | None = None
    material: Material | None = None
    provenance: dict = field(default_factory=dict)
    stage: Environment | None = None
    animation: Animation | None = None
    thumbnail: np.ndarray | None = None

    @classmethod
    def load(cls, path: str | Path) -> Asset:
        """Read and check an asset file. Raises BadInput."""
        with open_hdf5(Path(path)) as file:
            _check_format(file)
            asset = cls(
                _read_gaussians(file),
                _read_cage(file) if file.has("cage") else None,
                _read_embedded(file) if file.has("embedding") else None,
                _read_sdf(file) if file.has("sdf") else None,
                read_material(file) if file.has("material") else None,
                _read_provenance(file),
                read_environment(file) if file.has("stage") else None,
                read_animation(file) if file.has("animation") else None,
                _indices(file, "thumbnail", (None,), np.uint8) if file.has("thumbnail") else None,
            )
        check(asset, str(path))
        return asset

    def save(self, path: str | Path) -> None:
        """Write the asset, compressed, in one step: either the whole file or none. Raises BadInput."""
        check(self, str(path))
        g = self.gaussians
        with atomic_write(path) as beside, h5py.File(beside, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["version"] = VERSION
            file.attrs["provenance"] = json.dumps(self.provenance)
            for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
                _write(file, f"gaussians/{name}", getattr(g, name), np.float32)
            _write(file, "gaussians/object_id", g.object_id, np.uint16)
            if self.cage is not None:
                _write(file, "cage/vertices", self.cage.vertices, np.float32)
                _write(file, "cage/tets", self.cage.tets, np.int32)
                _write(file, "cage/surface", self.cage.surface, np.int32)
            if self.embedded is not None:
                _write(file, "embedding/host", self.embedded.host, np.int32)
                _write(file, "embedding/weights", self.embedded.weights, np.float32)
            if self.sdf is not None:
                _write(file, "sdf/values", self.sdf.values, np.float16)
                file["sdf/values"].attrs["origin"] = np.asarray(self.sdf.origin, np.float64)
                file["sdf/values"].attrs["spacing"] = float(self.sdf.spacing)
            if self.stage is not None:
                write_environment(file, self.stage)
            if self.thumbnail is not None:
                _write(file, "thumbnail", self.thumbnail, np.uint8)
            if self.material is not None:
                write_material(self.material, file)
            if self.animation is not None:
                write_animation(self.animation, file, _write)


def _write(file: h5py.File, name: str, values: np.ndarray, dtype) -> None:
    file.create_dataset(name, data=np.asarray(values, dtype), compression="gzip", shuffle=True)


def _check_format(file: Hdf5Reader) -> None:
    if file.text("", "format") != FORMAT:
        raise file.bad(f"not a {FORMAT} file")
    version = file.number("", "version")
    if version != VERSION:
        hint = "; a newer program wrote it" if version > VERSION else ""
        raise file.bad(f"version {version:g} of the format, this program reads version {VERSION}{hint}")


def _floats(file: Hdf5Reader, name: str, shape: tuple) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused by the check for finite values
        return np.asarray(file.array(name, "f", shape), np.float32)


def _indices(file: Hdf5Reader, name: str, shape: tuple, dtype=np.int32) -> np.ndarray:
    values = file.array(name, "iu", shape)
    if values.size and (values.min() < 0 or values.max() > np.iinfo(dtype).max):
        raise file.bad(f"{name} holds an index out of range")
    return values.astype(dtype)


def _read_gaussians(file: Hdf5Reader) -> Gaussians:
    means = _floats(file, "gaussians/means", (None, 3))
    n = len(means)
    return Gaussians(
        means,
        _floats(file, "gaussians/quats", (n, 4)),
        _floats(file, "gaussians/log_scales", (n, 3)),
        _floats(file, "gaussians/logit_opacities", (n,)),
        _floats(file, "gaussians/sh", (n, None, 3)),
        _indices(file, "gaussians/object_id", (n,), np.uint16),
    )


def _read_cage(file: Hdf5Reader) -> Cage:
    return Cage(
        _floats(file, "cage/vertices", (None, 3)),
        _indices(file, "cage/tets", (None, 4)),
        _indices(file, "cage/surface", (None, 3)),
    )


def _read_embedded(file: Hdf5Reader) -> CageEmbedding:
    host = _indices(file, "embedding/host", (None, 4))
    return CageEmbedding(host, _floats(file, "embedding/weights", (len(host), 4, 4)))


def _read_sdf(file: Hdf5Reader) -> DistanceGrid:
    values = file.array("sdf/values", "f", (None, None, None))
    if values.dtype != np.float16:
        with np.errstate(over="ignore"):
            values = values.astype(np.float32)
    return DistanceGrid(values, file.vector("sdf/values", "origin"), file.number("sdf/values", "spacing"))


def write_material(material: Material, file: h5py.File) -> None:
    """Write the attributes of the group `material`; what is as by default is left out where files may lack it."""
    group = file.create_group("material")
    for key, value in asdict(material).items():
        if key not in OPTIONAL_MATERIAL or value != OPTIONAL_MATERIAL[key]:
            group.attrs[key] = float(value)


def read_material(file: Hdf5Reader) -> Material:
    """The group `material`, not checked. Raises BadInput."""
    keys = [f.name for f in fields(Material)]
    present = [key for key in keys if key not in OPTIONAL_MATERIAL or file.has_attribute("material", key)]
    return Material(**{key: file.number("material", key) for key in present})


def _read_provenance(file: Hdf5Reader) -> dict:
    try:
        provenance = json.loads(file.text("", "provenance"))
    except (ValueError, RecursionError) as e:
        raise file.bad("the provenance is not JSON") from e
    if not isinstance(provenance, dict):
        raise file.bad("the provenance is not a JSON object")
    return provenance
