"""The Gaussians of a splat as they lie in files and in host memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from core.errors import BadInput
from core.rotation import matrices_from_quaternions, multiply_quaternions, quaternions_from_matrices
from core.spherical_harmonics import rotate_sh

SH_COUNTS = (1, 4, 9, 16)  # coefficients of degree 0, 1, 2, 3
LOG_SCALE_MAX = 40.0  # exp(2 * 40) = 5.5e34: sums of such variances still fit float32
MAGNITUDE_MAX = 1e15  # [m] squared distances between such points still fit float32
FLATTEST = 1e-7  # of a Gaussian's largest variance: what float32 covariances resolve
OPAQUE = 0.3  # opacity above which a Gaussian shows a surface; fainter ones are haze
UNIT_TOLERANCE = 1e-3  # of lengths and sums that should be 1: float16 is off by less
ROWS = ("means", "quats", "log_scales", "logit_opacities", "sh", "object_id")  # arrays with a row a Gaussian
SORTS = ("z", "radial", "pixel")  # orders of blending, see render/__init__.py
OBJECTS_MAX = 1024  # names of objects: in a .ply each is a line of the header
OBJECT_NAME_MAX = 100  # [characters]

Report = Callable[[str], None]


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians. All arrays are float32 but `object_id`.

    means            centres [m], (N, 3)
    quats            unit quaternions wxyz, (N, 4)
    log_scales       natural log of the standard deviations [m], (N, 3)
    logit_opacities  logit of the opacity, (N,)
    sh               spherical harmonics, (N, K, 3), K = 1, 4, 9 or 16; colour = 0.5 + SH(d)
    object_id        uint16, (N,); 0 = background
    objects          names of the objects 1, 2, ...; an object beyond them has no name
    sort             order of blending that they were trained for, one of SORTS, or "" if that is not known
    antialias        True if they were trained for anti-aliased drawing (Mip-Splatting); they are too thick without
    view             where they come from photographs: eye and target of a photographer, and how far [rad] the cameras
                     go round the target, to either side, (7,); +y is up then
    """

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    logit_opacities: np.ndarray
    sh: np.ndarray
    object_id: np.ndarray
    objects: tuple[str, ...] = ()
    sort: str = ""
    antialias: bool = False
    view: tuple[float, ...] = ()

    @classmethod
    def of(cls, means, quats, log_scales, logit_opacities, sh, object_id=None, objects=(), **about) -> Gaussians:
        """Convert dtypes and normalise quaternions; the inputs must be finite. `about`: sort, antialias and view."""
        n = len(means)
        quats = np.asarray(quats, np.float32).reshape(n, 4)
        quats = quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-12)
        sh = np.ascontiguousarray(sh, np.float32)
        count = sh.size // (3 * n) if n else sh.shape[1] if sh.ndim == 3 else 1
        ids = np.zeros(n, np.uint16) if object_id is None else np.asarray(object_id, np.uint16)
        return cls(
            np.ascontiguousarray(means, np.float32).reshape(n, 3),
            np.ascontiguousarray(quats, np.float32),
            np.ascontiguousarray(log_scales, np.float32).reshape(n, 3),
            np.ascontiguousarray(logit_opacities, np.float32).reshape(n),
            sh.reshape(n, count, 3),
            np.ascontiguousarray(ids).reshape(n),
            tuple(objects),
            **about,
        )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    @property
    def opacities(self) -> np.ndarray:
        """Opacity in 0..1, (N,)."""
        return 1.0 / (1.0 + np.exp(-self.logit_opacities.clip(-80, 80)))

    @property
    def covariances(self) -> np.ndarray:
        """Sigma = R S S^T R^T [m^2] as (xx, xy, xz, yy, yz, zz), float64 (N, 6)."""
        axes = matrices_from_quaternions(self.quats) * np.exp(self.log_scales.astype(np.float64))[:, None, :]
        sigma = axes @ axes.transpose(0, 2, 1)
        return sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]

    def select(self, which: np.ndarray) -> Gaussians:
        """The Gaussians of an index array or boolean mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in ROWS})

    def opaque(self) -> Gaussians:
        """The Gaussians that show a surface."""
        return self.select(self.opacities > OPAQUE)

    def with_sh_degree(self, degree: int) -> Gaussians:
        """Pad with zeros, or cut, to the given SH degree."""
        k = SH_COUNTS[degree]
        sh = np.zeros((len(self), k, 3), np.float32)
        shared = min(k, self.sh.shape[1])
        sh[:, :shared] = self.sh[:, :shared]
        return replace(self, sh=sh)

    def transformed(self, rotation: np.ndarray, translation=(0.0, 0.0, 0.0), scale: float = 1.0) -> Gaussians:
        """Apply x -> scale * rotation @ x + translation, to the view-dependent colour as well."""
        rotation = np.asarray(rotation, np.float64)
        means = scale * self.means @ rotation.T + np.asarray(translation)
        quats = multiply_quaternions(quaternions_from_matrices(rotation)[None], self.quats)
        sh = rotate_sh(self.sh, rotation)
        log_scales = self.log_scales + np.log(scale)
        view = scale * np.reshape(self.view[:6], (-1, 3)) @ rotation.T + np.asarray(translation)
        about = {"sort": self.sort, "antialias": self.antialias, "view": (*view.ravel().tolist(), *self.view[6:])}
        ids = self.object_id, self.objects
        return Gaussians.of(means, quats, log_scales, self.logit_opacities, sh, *ids, **about)

    def check(self, where: str) -> None:
        """Raise BadInput, naming `where`, unless there are Gaussians and all of them can be drawn."""
        n = len(self.means)
        if n == 0:
            raise BadInput(f"{where}: holds no Gaussians")
        if self.sh.ndim != 3 or self.sh.shape[1] not in SH_COUNTS:
            raise BadInput(f"{where}: sh has shape {self.sh.shape}, expected (N, K, 3) with K one of {SH_COUNTS}")
        shapes = [(n, 3), (n, 4), (n, 3), (n,), (n, self.sh.shape[1], 3), (n,)]
        for name, shape in zip(ROWS, shapes, strict=True):
            if getattr(self, name).shape != shape:
                raise BadInput(f"{where}: {name} has shape {getattr(self, name).shape}, expected {shape}")
        wrong = n - int(drawable(self.means, self.quats, self.log_scales, self.logit_opacities, self.sh).sum())
        if wrong:
            raise BadInput(f"{where}: {wrong} of {n} Gaussians are not finite or have no rotation")
        with np.errstate(over="ignore"):  # infinite, and refused
            length = np.linalg.norm(self.quats, axis=1)
        if np.abs(length - 1).max() > UNIT_TOLERANCE:
            raise BadInput(f"{where}: the quaternions are not normalised")
        if self.sort not in ("", *SORTS):
            raise BadInput(f"{where}: {self.sort!r} is not an order of blending ({', '.join(SORTS)})")
        if len(self.objects) > OBJECTS_MAX or not all(is_object_name(name) for name in self.objects):
            what = f"at most {OBJECTS_MAX}, each of 1 to {OBJECT_NAME_MAX} printable characters"
            raise BadInput(f"{where}: names of objects are {what}")


def usable_view(numbers: Iterable | None) -> tuple[float, ...]:
    """The view (7,) from the numbers or words of a file, all around where it does not say; () if they are none."""
    try:
        view = tuple(float(w) for w in numbers)
    except (TypeError, ValueError, OverflowError):
        return ()
    view = (*view, math.pi) if len(view) == 6 else view
    usable = len(view) == 7 and (np.abs(view) < MAGNITUDE_MAX).all() and view[:3] != view[3:6]  # NaN compares false
    return view if usable and 0.0 <= view[6] < 3.2 else ()


def is_object_name(name: str) -> bool:
    """True if this can name an object: one line of a header, without blanks around it."""
    return 0 < len(name) <= OBJECT_NAME_MAX and name.isprintable() and name == name.strip()


def concatenate(sets: list[Gaussians]) -> Gaussians:
    """All Gaussians of the sets, padded to the highest SH degree among them.

    Named objects keep their names: those of later sets get other ids where the first set gave theirs away. The ids of
    a set without names stay. The order of blending is that of most Gaussians, and so is `antialias`; the view is the
    first that there is.
    """
    degree = max(g.sh_degree for g in sets)
    sets = [g.with_sh_degree(degree) for g in sets]
    rows = {name: [getattr(g, name) for g in sets] for name in ROWS}
    objects = tuple(dict.fromkeys(name for g in sets for name in g.objects))
    for k, g in enumerate(sets):
        if g.objects and g.objects != objects[: len(g.objects)]:
            new = np.arange(np.iinfo(np.uint16).max + 1, dtype=np.uint16)
            new[1 : len(g.objects) + 1] = [objects.index(name) + 1 for name in g.objects]
            rows["object_id"][k] = new[g.object_id]
    counts = {sort: sum(len(g) for g in sets if g.sort == sort) for sort in ("", *SORTS)}
    antialias = 2 * sum(len(g) for g in sets if g.antialias) > sum(map(len, sets))
    view = next((g.view for g in sets if g.view), ())
    about = (objects, max(counts, key=counts.get), antialias, view)
    return Gaussians(*(np.concatenate(rows[name]) for name in ROWS), *about)


def axes_of(sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (N, 4) and log-scales (N, 3) of covariances (N, 3, 3) [m^2]."""
    variances, axes = np.linalg.eigh(sigma.astype(np.float64))
    axes[..., 0] *= np.sign(np.linalg.det(axes))[:, None]
    least = FLATTEST * np.maximum(variances[:, 2:], 1e-16)
    return quaternions_from_matrices(axes), 0.5 * np.log(np.maximum(variances, least))


def drawable(means, quats, log_scales, logit_opacities, sh) -> np.ndarray:
    """Mask (N,) of the Gaussians that can be drawn: finite, with a rotation, and finite still when squared."""
    n = len(means)
    with np.errstate(invalid="ignore", over="ignore"):
        rows = np.concatenate([means, sh.reshape(n, -1), logit_opacities.reshape(n, 1)], axis=1)
        mask = (np.abs(rows) < MAGNITUDE_MAX).all(1)  # NaN compares false
        mask &= (log_scales <= LOG_SCALE_MAX).all(1) & np.isfinite(log_scales).all(1)
        norm = np.linalg.norm(np.asarray(quats, np.float64), axis=1)
        return mask & (norm > 1e-6) & np.isfinite(norm)


def drawable_gaussians(
    path: Path, means, quats, log_scales, logit_opacities, sh, report: Report, *, object_id=None, **about
) -> Gaussians:
    """Gaussians of the rows of a file that can be drawn; `report` takes a line if others were dropped.

    about  `objects`, `sort`, `antialias` and `view` of Gaussians.

    Raises BadInput, naming `path`, if none can be drawn.
    """
    n = len(means)
    if n == 0:
        raise BadInput(f"{path}: holds no Gaussians")
    with np.errstate(invalid="ignore"):  # a signalling NaN
        quats = np.asarray(quats, np.float64)  # the norm of 1e30 overflows in float32
    keep = drawable(means, quats, log_scales, logit_opacities, sh)
    dropped = n - int(keep.sum())
    if dropped == n:
        raise BadInput(f"{path}: none of its {n} Gaussians is finite and has a rotation")
    columns = [means, quats, log_scales, logit_opacities, sh, np.zeros(n) if object_id is None else object_id]
    if dropped:
        report(f"{path}: dropped {dropped} of {n} Gaussians that are not finite or have no rotation")
        columns = [c[keep] for c in columns]
    columns[1] = columns[1] / np.linalg.norm(columns[1], axis=1, keepdims=True)
    return Gaussians.of(*columns, **about)


def symmetric_matrices(six: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) of (xx, xy, xz, yy, yz, zz), (N, 6)."""
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def robust_bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of all but the outermost 0.5 % of points (N, 3) on each side."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return low, high


def normals_and_areas(g: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Shortest axis (N, 3) of each Gaussian, of either sign, and the area pi s1 s2 of its disc [m^2], (N,)."""
    scales = np.exp(g.log_scales.astype(np.float64))
    order = np.argsort(scales, 1)
    axes = matrices_from_quaternions(g.quats)
    n = np.take_along_axis(axes, order[:, None, :1], 2)[..., 0]
    s = np.take_along_axis(scales, order, 1)
    return n, np.pi * s[:, 1] * s[:, 2]
