"""Shadows of Gaussians on Gaussians: a depth map from the light, one visibility per Gaussian.

VR-GS, Sec. 4.5: the map is drawn by the same alpha blending; what lies behind it is darkened.
"""

import numpy as np
import taichi as ti

from core.camera import look_at
from render.footprint import clamp
from render.projection import NEAR, vec3, vec4
from render.rasterizer import Rasterizer
from render.splats import Splats
from scenes.scene import Light

STATIC, DYNAMIC = 0, 1  # layers of the map, by what casts
WIDEST = 1.2  # tangent of half the light's largest cone; what lies outside is lit
FAR = 40.0  # a directional light stands this many scene radii away: its rays differ by less than 1.5 degrees
TAPS = 4  # per side of the filter
WIDEST_FILTER = 12.0  # [texels] to each side, lest taps stand too far apart to blend
OWN_BIAS = 0.004  # [m] of shadows on what cannot shadow itself
CASTING = 0.5  # share of the way to the target on which static things cast: a lampshade or a ceiling does not
FAR_BIAS = 0.05  # [m] how deep behind static things a static Gaussian is surely in their shadow
RUNS = {False: 64, True: 4096}  # by backend, on_gpu: into how many runs what moves is cut to find its box


@ti.data_oriented
class DepthMap:
    """Sink of (depth [m], coverage) per texel, one layer per kind of caster."""

    def __init__(self, resolution: int):
        self.texel = ti.Vector.field(2, ti.f32)
        builder = ti.FieldsBuilder()
        builder.dense(ti.ijk, (2, resolution, resolution)).place(self.texel)
        self.tree = builder.finalize()

    @ti.func
    def write(self, out: ti.template(), v, y, x, rgb, depth, alpha):
        self.texel[out, y, x] = ti.math.vec2(depth / ti.max(alpha, 1e-10), alpha)


@ti.data_oriented
class ShadowMap:
    """Writes `splats.light`, 1 - strength (1 - visibility), when `cast()` is called.

    Gaussians [begin, end) = `dynamic` move; `end` may change. The map of static casters is drawn once per light, in
    a fixed cone around the light's target; that of dynamic ones at each cast, in a cone fitted to
    them on the device. Dynamic Gaussians are shadowed by both. Static ones keep the shadows that
    were captured with them and are darkened by dynamic casters alone, and only where the light
    reached them before. Static things near the light, such as its own lamp or, for a directional
    light, the ceiling, cast nothing.
    """

    def __init__(self, splats: Splats, light: Light, dynamic: tuple[int, int], *, resolution: int = 512):
        self.splats, self.resolution = splats, resolution
        self.on_gpu = ti.cfg.arch == ti.cuda
        self.runs = RUNS[self.on_gpu]
        self.begin, self.end = dynamic
        if self.end != splats.count:
            raise ValueError(f"the dynamic Gaussians {dynamic} must be the last of {splats.count}")
        self.map = DepthMap(resolution)
        self.raster = Rasterizer(splats, resolution, resolution, views=1, sink=self.map, color=False)
        self.lens = ti.Vector.field(4, ti.f32)  # of each layer, as Projection.camera
        self.low, self.high = ti.Vector.field(3, ti.f32), ti.Vector.field(3, ti.f32)  # box of what moves [m]
        self.exposed = ti.field(ti.f32)  # 1 where no static thing hides a static Gaussian from the light
        builder = ti.FieldsBuilder()
        builder.dense(ti.ij, (2, 4)).place(self.lens)
        builder.place(self.low)
        builder.place(self.high)
        builder.dense(ti.i, splats.capacity).place(self.exposed)
        self.tree = builder.finalize()
        self._unsettled = False
        self.set_light(light)

    def destroy(self) -> None:
        """Give the device memory back; the object must not be used after."""
        self.raster.destroy()
        self.map.tree.destroy()
        self.tree.destroy()

    def set_light(self, light: Light) -> None:
        """Change the light; its static map is drawn at the next cast."""
        self.light = light
        away = np.subtract(light.position, light.target).astype(np.float64)
        self._distance = max(float(np.linalg.norm(away)), 1e-6)
        self._reach = self.splats.reach(light.target)
        if light.kind == "directional":
            away, self._distance = away * (FAR * self._reach / self._distance), FAR * self._reach
        self._eye = np.asarray(light.target) + away
        self._static_is_drawn = False

    def cast(self) -> None:
        """Bring `splats.light` up to date with where the Gaussians are now. Nothing waits for the device, so `settle`
        must be called when that does no harm."""
        light, distance = self.light, self._distance
        if not self._static_is_drawn:
            view = look_at(self._eye, light.target)[:3]
            near = distance - CASTING * min(distance, self._reach)
            self._aim_static(*view.ravel().tolist(), min(self._reach / distance, WIDEST), near)
            self.raster.draw(STATIC, 0, self.begin)
            self._expose(light.softness)
            self._static_is_drawn = True
        if self.begin < self.end:
            self._aim_dynamic(*self._eye.tolist(), light.softness, self.end)
            self.raster.draw(DYNAMIC, self.begin, self.end, wait=False)
            self._unsettled = True
            self._receive(light.strength, light.softness, self.end)
        else:
            self.splats.light.fill(1.0)

    def settle(self) -> bool:
        """Was there no room for the last cast? Then it is made again, and pictures since then are wrong."""
        again = self._unsettled and self.raster.settle(DYNAMIC)
        self._unsettled = False
        if again:
            self._receive(self.light.strength, self.light.softness, self.end)
        return again

    @ti.kernel
    def _aim_static(
        self,
        a0: ti.f32, a1: ti.f32, a2: ti.f32, a3: ti.f32,
        b0: ti.f32, b1: ti.f32, b2: ti.f32, b3: ti.f32,
        c0: ti.f32, c1: ti.f32, c2: ti.f32, c3: ti.f32,
        tangent: ti.f32, near: ti.f32,
    ):  # fmt: skip
        self._set_lens(STATIC, vec4(a0, a1, a2, a3), vec4(b0, b1, b2, b3), vec4(c0, c1, c2, c3), tangent)
        self.raster.projection.near[0] = near

    @ti.kernel
    def _aim_dynamic(self, eye_x: ti.f32, eye_y: ti.f32, eye_z: ti.f32, softness: ti.f32, end: ti.i32):
        """Fit the cone to the box of all that moves, two sigmas included; no texel finer than the filter needs."""
        self.low[None] = vec3(1e6)
        self.high[None] = vec3(-1e6)
        for run in range(self.runs):  # each finds its own first: all at one place would wait for one another
            low, high = vec3(1e6), vec3(-1e6)
            length = (end - self.begin + self.runs - 1) // self.runs
            for i in range(length):
                g = self.begin + (run + i * self.runs if ti.static(self.on_gpu) else run * length + i)
                if g < end:
                    mean, s = self.splats.mean[g], self.splats.cov[g]
                    margin = 2.0 * ti.sqrt(ti.max(vec3(s[0], s[3], s[5]), 0.0)) + softness
                    if ti.abs(mean).max() < 1e5:  # what flew away or is not a number must not blind the light
                        low, high = ti.min(low, mean - margin), ti.max(high, mean + margin)
            for k in ti.static(range(3)):
                if low[k] < self.low[None][k]:
                    ti.atomic_min(self.low[None][k], low[k])
                if high[k] > self.high[None][k]:
                    ti.atomic_max(self.high[None][k], high[k])
        for _ in range(1):
            eye = vec3(eye_x, eye_y, eye_z)
            low, high = self.low[None], self.high[None]
            middle = 0.5 * (low + high) - eye
            forward = middle.normalized(1e-9)
            right = forward.cross(vec3(0.0, 1.0, 0.0))
            if right.norm() < 1e-3:
                right = forward.cross(vec3(0.0, 0.0, 1.0))
            right = right.normalized()
            down = forward.cross(right)
            tangent = softness * self.resolution / (4 * WIDEST_FILTER * ti.max(middle.norm(), NEAR))
            for corner in range(8):
                p = low - eye
                for k in ti.static(range(3)):
                    if (corner >> k) & 1 == 1:
                        p[k] = high[k] - eye[k]
                z = forward.dot(p)
                if z > NEAR:
                    tangent = ti.max(tangent, ti.max(ti.abs(right.dot(p)), ti.abs(down.dot(p))) / z)
                else:
                    tangent = WIDEST
            self.raster.projection.near[0] = NEAR
            rows = ti.Matrix.rows([right, down, forward])
            t = -(rows @ eye)
            self._set_lens(
                DYNAMIC,
                vec4(right, t[0]), vec4(down, t[1]), vec4(forward, t[2]),
                clamp(tangent, 1e-3, WIDEST),
            )  # fmt: skip

    @ti.func
    def _set_lens(self, layer: ti.template(), row0: vec4, row1: vec4, row2: vec4, tangent: ti.f32):
        """Remember the layer's view and hand it to the raster."""
        half = 0.5 * self.resolution
        rows = [row0, row1, row2, vec4(half / tangent, half / tangent, half, half)]
        for k in ti.static(range(4)):
            self.lens[layer, k] = rows[k]
            self.raster.projection.camera[0, k] = rows[k]

    @ti.func
    def _shade(self, layer: ti.template(), x: vec3, softness: ti.f32, bias: ti.f32, ramp: ti.f32) -> ti.f32:
        """Share of the light that the layer's casters keep from x, 0..1: percentage-closer filtering.

        A tap counts by its coverage, and by how far x lies behind it: nothing up to bias [m] + one
        texel, all of it `ramp` [m] further.
        """
        p = vec3(0.0)
        for k in ti.static(range(3)):
            p[k] = self.lens[layer, k].xyz.dot(x) + self.lens[layer, k].w
        shade = 0.0
        if p.z > NEAR:
            focal = self.lens[layer, 3].x
            u, v = focal * p.x / p.z + 0.5 * self.resolution, focal * p.y / p.z + 0.5 * self.resolution
            if u >= 0 and v >= 0 and u < self.resolution and v < self.resolution:
                radius = clamp(0.5 * softness * focal / p.z, 1.0, WIDEST_FILTER)
                behind = p.z - bias - p.z / focal
                for i in range(TAPS * TAPS):
                    du, dv = i % TAPS - 0.5 * (TAPS - 1), i // TAPS - 0.5 * (TAPS - 1)
                    column = ti.cast(ti.floor(u + du * radius * (2.0 / TAPS)), ti.i32)
                    row = ti.cast(ti.floor(v + dv * radius * (2.0 / TAPS)), ti.i32)
                    if 0 <= column < self.resolution and 0 <= row < self.resolution:
                        tap = self.map.texel[layer, row, column]
                        shade += tap[1] * clamp((behind - tap[0]) / ramp, 0.0, 1.0)
        return shade / (TAPS * TAPS)

    @ti.kernel
    def _expose(self, softness: ti.f32):
        """Which static Gaussians the light reaches past the static scene."""
        for g in range(self.begin):
            self.exposed[g] = 1.0 - self._shade(STATIC, self.splats.mean[g], softness, FAR_BIAS, FAR_BIAS)

    @ti.kernel
    def _receive(self, strength: ti.f32, softness: ti.f32, end: ti.i32):
        for g in range(end):
            mean, s = self.splats.mean[g], self.splats.cov[g]
            size = ti.sqrt(ti.max((s[0] + s[3] + s[5]) / 3.0, 0.0))
            darkness = 0.0
            if g < self.begin:
                darkness = self._shade(DYNAMIC, mean, softness, OWN_BIAS + size, OWN_BIAS) * self.exposed[g]
            else:  # a filter as wide as `softness` reaches that much deeper on a slope of 45 degrees
                bias = OWN_BIAS + softness + 2.0 * size
                seen = 1.0 - self._shade(DYNAMIC, mean, softness, bias, OWN_BIAS + 0.5 * softness)
                darkness = 1.0 - seen * (1.0 - self._shade(STATIC, mean, softness, bias, OWN_BIAS + 0.5 * softness))
            self.splats.light[g] = 1.0 - strength * darkness
