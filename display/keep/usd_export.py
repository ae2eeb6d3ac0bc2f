"""A running scene in OpenUSD: what it looks like, and what another simulator needs to go on with it.

Metres, kilograms, +y up. Gaussians are `ParticleField3DGaussianSplat`s; cages are `TetMesh`es with the deformable-body
schemas of the AOUSD proposal, whose names usd-core does not know yet; rigid bodies, colliders and materials are of
UsdPhysics. Frames of a play become time samples.

    /World/Room             Gaussians of all that stands still
    /World/Colliders        planes, boxes, capsules, and the surfaces of distance grids
    /World/Bodies/NAME_K    Xform at the body's pose: x_world = R x + t; its Gaussians, and its cage or its shape
    /World/Materials
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdUtils, UsdVol
from scipy.spatial import ConvexHull

from assets.file_access import atomic_write
from assets.gaussians import Gaussians, axes_of, symmetric_matrices
from core.distance_grid import marching_cubes
from core.errors import BadInput
from core.program import VERSION
from core.rotation import matrices_from_quaternions, quaternions_from_matrices, rotation_between
from core.tetmesh import enclosed_volume
from core.vocabulary import Box, Capsule, Plane
from display.keep.shown_scene import MovingBody, fitted_pose, gaussians_of, moving_bodies, shown_gaussians
from display.world import World
from sim.bodies import solid_inertia
from sim.contact.static_shapes import Shape

SORTING = {"z": "zDepth", "radial": "cameraDistance", "pixel": "rayHitDistance"}
CONVEX = 0.98  # of the hull's volume, from which on a rigid body collides as its hull
REACH = 3.0  # standard deviations, to which a Gaussian's extent is given
HALF = {"orientations": "orientationsh", "scales": "scalesh"}  # what moving Gaussians have in half precision

EMBEDDING = """\
How these Gaussians follow the points x of the tet mesh that vrgs:cage names. Gaussian i has four corners k, each in
the tet t = host[4 i + k], at y_k = sum_j weights[16 i + 4 k + j] x[tetVertexIndices[t][j]]. With Y the corners at the
default time, where the Gaussian has its mean m and covariance C, and y those at another time:
F = [y1-y0, y2-y0, y3-y0] [Y1-Y0, Y2-Y0, Y3-Y0]^-1, mean = avg(y) + F (m - avg(Y)), covariance = F C F^T."""


class SceneStage:
    """A stage that holds the scene as it is now, to which later frames are added.

    body     only this one; None: all, the room and the colliders
    shadows  let the colours be as dark as they are shown
    rate     time codes a second, for `sample`
    Raises BadInput.
    """

    def __init__(self, world: World, body: int | None = None, *, shadows: bool = True, rate: float = 60.0):
        self.world, self._body, self._shadows, self._rate = world, body, shadows, rate
        self._start: float | None = None  # [s] of the first time sample
        self._paths: dict[int, str] = {}  # of each body
        self._quats: dict[int, np.ndarray] = {}  # of its Gaussians at the last moment
        self._materials: dict[tuple, str] = {}  # path of each by its values
        self.stage = stage = Usd.Stage.CreateInMemory()
        stage.GetRootLayer().documentation = f"VR-GS {VERSION}"
        stage.SetTimeCodesPerSecond(rate)
        stage.SetFramesPerSecond(rate)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetDefaultPrim(self._xform("/World").GetPrim())
        gravity = np.array(world.device.solver.gravity)
        scene = UsdPhysics.Scene.Define(stage, "/World/Physics")
        scene.CreateGravityMagnitudeAttr(float(np.linalg.norm(gravity)))
        if gravity.any():
            scene.CreateGravityDirectionAttr(Gf.Vec3f(*(gravity / np.linalg.norm(gravity)).tolist()))
        if body is None:
            if world.device.still:
                self._xform("/World/Room")
                self._gaussians(
                    "/World/Room/Gaussians", gaussians_of(world, [(0, world.device.still)], shadows=shadows)()
                )
            self._xform("/World/Colliders")
            for k, shape in enumerate(world.device.sight.shapes):
                self._collider(f"/World/Colliders/{type(shape).__name__}_{k}", shape)
        self._xform("/World/Bodies")
        for moving in moving_bodies(self.world, self._body):
            self._define(moving)
        self._models = self._now()

    def take(self, time: float) -> None:
        """Add the world as it is now, `time` [s], as a time sample. Raises BadInput if bodies have joined or left."""
        if self._now() != self._models:
            raise BadInput("bodies joined or left the scene, which an OpenUSD file of its play cannot hold")
        self._start = time if self._start is None else self._start
        time = round((time - self._start) * self._rate)
        self.stage.SetEndTimeCode(time)
        self.stage.SetStartTimeCode(0)
        splats = self.world.device.splats
        mean, cov = splats.mean.to_numpy(), splats.cov.to_numpy()
        for moving in moving_bodies(self.world, self._body):
            R, t = self._place(moving, time)
            if moving.model.shape.rigid:
                continue
            path = self._paths[moving.index]
            self._set(f"{path}/Cage", "points", (moving.x - t) @ R, time)
            first, end = self.world.registry.gaussian_span(moving.index)
            if first == end:
                continue
            quats, log_scales = axes_of(R.T @ symmetric_matrices(cov[first:end]) @ R)
            quats = self._quats[moving.index] = same_axes(quats, self._quats[moving.index])
            self._splats(f"{path}/Gaussians", (mean[first:end] - t) @ R, quats, np.exp(log_scales), time, half=True)

    def write(self, path: Path) -> None:
        """Write the file, whole or not at all. Raises BadInput."""
        with atomic_write(path) as beside, tempfile.TemporaryDirectory(prefix="vrgs-") as folder, usd_errors(path):
            packed = path.suffix.lower() == ".usdz"
            made = Path(folder) / f"scene{'.usdc' if packed else path.suffix.lower()}"
            if not self.stage.GetRootLayer().Export(str(made)):
                raise Tf.ErrorException("it cannot be written")
            if packed:
                made, layer = made.with_suffix(".usdz"), made
                if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(layer)), str(made)):
                    raise Tf.ErrorException("it cannot be packed")
            shutil.move(made, beside)

    def _now(self) -> list[tuple]:
        """Index of each body, and of what it is a copy."""
        return [(m.index, self.world.registry.members[m.index].source) for m in moving_bodies(self.world, self._body)]

    # bodies

    def _define(self, moving: MovingBody) -> None:
        """The prims of a body where it is now."""
        index, shape = moving.index, moving.model.shape
        name = f"{Tf.MakeValidIdentifier(Path(moving.model.body.name).stem)}_{index}"
        path = self._paths[index] = f"/World/Bodies/{name}"
        self._xform(path)
        R, t = self._place(moving)
        if shape.rigid:
            self._rigid(path, moving)
        else:
            self._soft(path, moving, (moving.x - t) @ R)
        first, end = self.world.registry.gaussian_span(index)
        if first == end:  # a piece that the splat's own Gaussians do not reach
            return
        g = shown_gaussians(self.world, index, shadows=self._shadows)().transformed(R.T, -R.T @ t)
        self._quats[index] = g.quats
        prim = self._gaussians(f"{path}/Gaussians", g, half=not shape.rigid)
        if not shape.rigid:
            self._embedding(prim, index, f"{path}/Cage")

    def _place(self, moving: MovingBody, time: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Put the body's Xform where its rest shape fits best; returns R (3, 3) and t (3,) [m]."""
        R, t = fitted_pose(moving)
        self._pose(self._paths[moving.index], R, t, time)
        return R, t

    def _soft(self, path: str, moving: MovingBody, points: np.ndarray) -> None:
        model, shape = moving.model, moving.model.shape
        self.stage.GetPrimAtPath(path).AddAppliedSchema("PhysicsDeformableBodyAPI")
        mesh = UsdGeom.TetMesh.Define(self.stage, f"{path}/Cage")
        prim = mesh.GetPrim()
        mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
        self._set(f"{path}/Cage", "points", points)
        self._set(f"{path}/Cage", "tetVertexIndices", shape.solid)
        self._set(f"{path}/Cage", "surfaceFaceVertexIndices", shape.surface)
        prim.AddAppliedSchema("PhysicsVolumeDeformableSimAPI")
        self._new(prim, "physics:restShapePoints", "point3f[]", shape.vertices)
        self._new(prim, "physics:restTetVertexIndices", "int4[]", shape.solid)
        UsdPhysics.CollisionAPI.Apply(prim)
        m = model.body.material
        moduli = {"youngsModulus": m.young, "poissonsRatio": m.poisson}
        self._bind(prim, m.friction, m.sliding_friction, m.density, moduli)

    def _rigid(self, path: str, moving: MovingBody) -> None:
        body, shape = moving.model.body, moving.model.shape
        prim = self.stage.GetPrimAtPath(path)
        UsdPhysics.RigidBodyAPI.Apply(prim).CreateKinematicEnabledAttr(bool(body.kinematic))
        mass, centre, inertia = solid_inertia(shape.vertices, shape.solid, body.density)
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        api = UsdPhysics.MassAPI.Apply(prim)
        api.CreateMassAttr(float(mass))
        api.CreateCenterOfMassAttr(Gf.Vec3f(*centre.tolist()))
        api.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
        api.CreatePrincipalAxesAttr(Gf.Quatf(*quaternions_from_matrices(axes).tolist()))
        solid = enclosed_volume(shape.vertices, shape.surface)
        convex = solid > CONVEX * ConvexHull(shape.vertices).volume
        how = "convexHull" if convex else "convexDecomposition"
        collider = self._mesh(f"{path}/Shape", shape.vertices, shape.surface, how)
        m = body.material
        self._bind(collider, m.friction, m.sliding_friction, m.density)

    def _embedding(self, prim, index: int, cage: str) -> None:
        """The two-level embedding as primvars, with their explanation."""
        part = self.world.device.parts[self.world.registry.members[index].source]
        api = UsdGeom.PrimvarsAPI(prim)
        for name, kind, values, size in (
            ("host", Sdf.ValueTypeNames.IntArray, part.host, 4),
            ("weights", Sdf.ValueTypeNames.FloatArray, part.weights, 16),
        ):
            primvar = api.CreatePrimvar(f"vrgs:{name}", kind, UsdGeom.Tokens.vertex, size)
            primvar.Set(as_vt(kind, values.reshape(-1)))
            primvar.GetAttr().SetDocumentation(EMBEDDING)
        prim.CreateRelationship("vrgs:cage").SetTargets([cage])

    # what stands still

    def _collider(self, path: str, shape: Shape) -> None:
        match shape:
            case Plane():
                normal = np.asarray(shape.normal) / np.linalg.norm(shape.normal)
                prim = UsdGeom.Plane.Define(self.stage, path)
                prim.CreateAxisAttr("Y")
                self._pose(path, rotation_between((0.0, 1.0, 0.0), normal), shape.point)
            case Box():
                prim = UsdGeom.Cube.Define(self.stage, path)
                prim.CreateSizeAttr(2.0)
                self._pose(path, np.eye(3), shape.center, scale=shape.half_size)
            case Capsule():
                a, b = np.asarray(shape.a), np.asarray(shape.b)
                length = float(np.linalg.norm(b - a))
                prim = UsdGeom.Capsule.Define(self.stage, path)
                prim.CreateAxisAttr("Y")
                prim.CreateRadiusAttr(float(shape.radius))
                prim.CreateHeightAttr(length)
                along = (b - a) / length if length else np.array([0.0, 1.0, 0.0])
                self._pose(path, rotation_between((0.0, 1.0, 0.0), along), (a + b) / 2)
            case _:
                try:
                    vertices, triangles = marching_cubes(shape.grid)
                except BadInput:  # nothing in it is solid
                    return
                world = shape.scale * vertices @ matrices_from_quaternions(shape.rotation).T + shape.position
                self._bind(self._mesh(path, world, triangles, "none"), shape.friction, shape.friction)
                return
        prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
        prim.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(prim, 0))
        UsdPhysics.CollisionAPI.Apply(prim.GetPrim())
        self._bind(prim.GetPrim(), shape.friction, shape.friction)

    def _mesh(self, path: str, vertices: np.ndarray, triangles: np.ndarray, approximation: str):
        """The prim of a surface that collides and is not drawn, of its used vertices."""
        used, corners = np.unique(triangles, return_inverse=True)
        mesh = UsdGeom.Mesh.Define(self.stage, path)
        prim = mesh.GetPrim()
        mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        self._set(path, "points", np.asarray(vertices)[used])
        self._set(path, "faceVertexIndices", corners.reshape(-1))
        self._set(path, "faceVertexCounts", np.full(len(triangles), 3))
        UsdPhysics.CollisionAPI.Apply(prim)
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(approximation)
        return prim

    def _bind(self, prim, static: float, sliding: float, density: float = 0.0, moduli: dict | None = None) -> None:
        """Bind the physics material of these values, one prim for all that have the same."""
        values = {"staticFriction": static, "dynamicFriction": sliding, "density": density, **(moduli or {})}
        known = self._materials.setdefault(tuple(values.items()), f"/World/Materials/Material_{len(self._materials)}")
        if not self.stage.GetPrimAtPath(known):
            self.stage.DefinePrim("/World/Materials", "Scope")
            made = UsdShade.Material.Define(self.stage, known).GetPrim()
            UsdPhysics.MaterialAPI.Apply(made)
            if moduli:
                made.AddAppliedSchema("PhysicsVolumeDeformableMaterialAPI")
            for name, value in values.items():
                made.CreateAttribute(f"physics:{name}", Sdf.ValueTypeNames.Float, False).Set(float(value))
        material = UsdShade.Material.Get(self.stage, known)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")

    # Gaussians

    def _gaussians(self, path: str, g: Gaussians, *, half: bool = False):
        """The prim of Gaussians; `half`: with orientations and scales of half precision."""
        field = UsdVol.ParticleField3DGaussianSplat.Define(self.stage, path)
        field.CreateProjectionModeHintAttr(UsdVol.Tokens.perspective)
        field.CreateSortingModeHintAttr(SORTING[g.sort])
        self._splats(path, g.means, g.quats, np.exp(g.log_scales), half=half)
        self._set(path, "opacities", g.opacities)
        self._set(path, "radiance:sphericalHarmonicsCoefficients", g.sh.reshape(-1, 3))
        field.GetPrim().GetAttribute("radiance:sphericalHarmonicsDegree").Set(g.sh_degree)
        field.GetPrim().SetCustomDataByKey("vrgs:antialias", g.antialias)
        return field.GetPrim()

    def _splats(self, path: str, means, quats, scales, time: int | None = None, *, half: bool = False) -> None:
        for name, values in (("positions", means), ("orientations", quats), ("scales", scales)):
            self._set(path, HALF.get(name, name) if half else name, values, time)
        reach = REACH * scales.max(1, keepdims=True)
        self._set(path, "extent", [(means - reach).min(0), (means + reach).max(0)], time)

    # attributes

    def _xform(self, path: str):
        return UsdGeom.Xform.Define(self.stage, path)

    def _pose(self, path: str, R, t, time: int | None = None, *, scale=None) -> None:
        at = Usd.TimeCode.Default() if time is None else time
        xform = UsdGeom.Xformable(self.stage.GetPrimAtPath(path))
        ops = xform.GetOrderedXformOps()
        if not ops:
            double = UsdGeom.XformOp.PrecisionDouble
            ops = [xform.AddTranslateOp(), xform.AddOrientOp(double)]
            if scale is not None:
                xform.AddScaleOp(double).Set(Gf.Vec3d(*map(float, scale)))
        ops[0].Set(Gf.Vec3d(*map(float, t)), at)
        ops[1].Set(Gf.Quatd(*quaternions_from_matrices(R).tolist()), at)

    def _set(self, path: str, name: str, values, time: int | None = None) -> None:
        """Set an array attribute of the prim's schema."""
        attribute = self.stage.GetPrimAtPath(path).GetAttribute(name)
        attribute.Set(as_vt(attribute.GetTypeName(), values), Usd.TimeCode.Default() if time is None else time)
        if name == "points":
            values = np.asarray(values)
            self._set(path, "extent", [values.min(0), values.max(0)], time)

    def _new(self, prim, name: str, kind: str, values) -> None:
        """Set an array attribute that the prim's schema does not know."""
        kind = Sdf.ValueTypeNames.Find(kind)
        prim.CreateAttribute(name, kind, False).Set(as_vt(kind, values))


def as_vt(kind, values):
    """An array of OpenUSD's type; quaternions are given as wxyz."""
    array = kind.type.pythonClass
    name = array.__name__
    dtype = np.int32 if "Int" in name or "Vec4i" in name else np.float16 if name.endswith("hArray") else np.float32
    values = np.asarray(values)
    if "Quat" in name:
        values = values[:, [1, 2, 3, 0]]  # as they lie in memory
    return array.FromNumpy(np.ascontiguousarray(values, dtype))


def same_axes(quats: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Of the four rotations that give a Gaussian the same axes, each its own as well as turned by pi about one of them,
    the nearest to those of before: between time samples others interpolate. (N, 4) both."""
    w, x, y, z = quats.T
    alike = np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]).transpose(2, 0, 1)
    dot = np.einsum("nkc,nc->nk", alike, before)
    best = np.abs(dot).argmax(1)
    row = np.arange(len(quats))
    return alike[row, best] * np.where(dot[row, best] < 0, -1.0, 1.0)[:, None]


@contextmanager
def usd_errors(path: Path) -> Iterator[None]:
    """Errors of OpenUSD as BadInput."""
    try:
        yield
    except Tf.ErrorException as e:
        raise BadInput(f"{path}: OpenUSD cannot write it ({' '.join(str(e).split())[:120]})") from e
