"""Shadows of Gaussians on Gaussians: a depth map from the light, one visibility per Gaussian.

VR-GS, Sec. 4.5: the map is drawn by the same alpha blending; Gaussians behind it are darkened.
"""

from collections.abc import Sequence

import numpy as np
import taichi as ti

from core.camera import Camera, look_at
from core.fields import FieldGroup
from core.lanes import dealt, lane_count, max_lanes
from core.vocabulary import Light
from render.footprint import clamp
from render.projection import NEAR_PLANE, vec3, vec4
from render.rasterizer import Rasterizer
from render.splats import Splats

STATIC, DYNAMIC = 0, 1  # layers of the map, by kind of caster
MAX_TANGENT = 1.2  # of half the light's largest cone; what lies outside is lit
DIRECTIONAL_DISTANCE = 40.0  # [scene radii] of a directional light: its rays differ by less than 1.5 degrees
# Relative widths of the cone, at each of which a captured shadow is drawn; the darkest counts. Bodies that move apart,
# and hands, widen it, and a coarser map shades more: what nobody touched would darken.
CAPTURED_WIDTHS = (1.0, 2.0, 4.0, 8.0)
TAPS = 4  # per side of the filter
MAX_FILTER_RADIUS = 12.0  # [texels]; wider taps would be too far apart to blend
CELL = 16  # [texels] of a side of a cell; the filter reaches 3/4 of MAX_FILTER_RADIUS, into the next one at most
NO_CASTER = 1e9  # [m]
OWN_BIAS = 0.004  # [m] of shadows on Gaussians that cannot shadow themselves, however large: feet touch their shadows
CASTING_FRACTION = 0.5  # of the way to the target, beyond which static Gaussians cast: no lampshade, no ceiling
STATIC_BIAS = 0.02  # [m] depth behind static Gaussians, as thin as a table top, at which another is in their shadow
# Parts of a tile's splats that are drawn side by side: seen from the light, most bodies are in a few tiles of the map.
SEGMENTS = {"cpu": 1, "cuda": 16}
RESOLUTION = {"cpu": 256, "cuda": 512}  # [texels] of a side; the filter hides all but 57 dB of the difference
BOX_CHUNKS = {"cpu": 64, "cuda": 32768}  # in which the box of the dynamic Gaussians is reduced


@ti.data_oriented
class DepthMap:
    """(depth [m], coverage) per texel, one layer per kind of caster; the sink of the segments that it is made of."""

    def __init__(self, resolution: int, segments: int):
        self.segments = segments
        self.fields = f = FieldGroup()
        self.texel = f.vector(2, resolution, resolution, n=2)
        self.segment = f.vector(segments, resolution, resolution, n=2)  # sum w z [m], coverage
        self.cells = resolution // CELL
        self.cell = f.scalar(2, self.cells, self.cells)  # depth of its nearest caster [m]
        self.nearest = f.scalar(2, self.cells, self.cells)  # the same with the cells around it
        f.build()

    @ti.func
    def write(self, out: ti.template(), v, y, x, rgb, depth, alpha):
        self.segment[v, y, x] = ti.math.vec2(depth, alpha)

    @ti.kernel
    def join(self, layer: ti.i32):
        """Blend the segments, which are ordered from the light on, into a layer."""
        for y, x in ti.ndrange(*self.texel.shape[1:]):
            depth, T = 0.0, 1.0
            for s in ti.static(range(self.segments)):
                part = self.segment[s, y, x]
                depth += T * part[0]
                T *= 1.0 - part[1]
            self.texel[layer, y, x] = ti.math.vec2(depth / ti.max(1.0 - T, 1e-10), 1.0 - T)
        for y, x in ti.ndrange(self.cells, self.cells):
            depth = NO_CASTER
            for i, j in ti.ndrange(CELL, CELL):
                texel = self.texel[layer, y * CELL + i, x * CELL + j]
                if texel[1] > 0.0:
                    depth = ti.min(depth, texel[0])
            self.cell[layer, y, x] = depth
        for y, x in ti.ndrange(self.cells, self.cells):
            depth = NO_CASTER
            for i in range(ti.max(y - 1, 0), ti.min(y + 2, self.cells)):
                for j in range(ti.max(x - 1, 0), ti.min(x + 2, self.cells)):
                    depth = ti.min(depth, self.cell[layer, i, j])
            self.nearest[layer, y, x] = depth


@ti.data_oriented
class ShadowMap:
    """Writes `splats.visibility`, 1 - strength * shade, when `cast()` is called.

    Gaussians from `begin` on move (dynamic), those before do not (static). The map of static casters is drawn once per
    light, in a fixed cone around the light's target; that of dynamic ones at each cast, in a cone fitted to them on the
    device. Dynamic Gaussians are shadowed by both. Static ones keep the shadows that were captured with them and are
    darkened by dynamic casters alone, and only where the light reached them before (`splats.exposed`). Static Gaussians
    near the light, such as its own lamp or, for a directional light, the ceiling, cast nothing.

    Captured dynamic Gaussians, those of `keep_captured_shadows`, had the shade 1 - exposed when they were photographed.
    They are darkened by what exceeds it, to (1 - strength * shade) / (1 - strength * (1 - exposed)), under whichever
    light. Where the shade is less they stay as they were photographed: a shadow cannot be divided out of colours, as
    the photographs do not tell which light cast it.
    """

    def __init__(self, splats: Splats, light: Light, begin: int, *, segments: int | None = None):
        self.on_gpu = ti.cfg.arch == ti.cuda
        device = "cuda" if self.on_gpu else "cpu"
        self.resolution = resolution = RESOLUTION[device]
        self.splats, self.begin, self.box_chunks, self.lanes = splats, begin, BOX_CHUNKS[device], lane_count()
        self.map = DepthMap(resolution, segments or SEGMENTS[device])
        self.rasterizer = Rasterizer(
            splats, resolution, resolution,
            views=1, sink=self.map, color=False, segments=self.map.segments, fast=True,
        )  # fmt: skip
        self.fields = f = FieldGroup()
        self.camera = f.vector(2, 4, n=4)  # of each layer, as Projection.camera
        self.low, self.high = f.vector(), f.vector()  # box of the dynamic Gaussians [m]
        f.build()
        self._unfinished = False
        self.set_light(light)

    def destroy(self) -> None:
        """Free the device memory."""
        self.rasterizer.destroy()
        self.map.fields.destroy()
        self.fields.destroy()

    def set_light(self, light: Light) -> None:
        """Change the light; its static map is drawn at the next cast."""
        self.light = light
        away = np.subtract(light.position, light.target).astype(np.float64)
        self._distance = max(float(np.linalg.norm(away)), 1e-6)
        self._radius = self.splats.radius_about(light.target)
        if light.kind == "directional":
            away *= DIRECTIONAL_DISTANCE * self._radius / self._distance
            self._distance = DIRECTIONAL_DISTANCE * self._radius
        self._eye = np.asarray(light.target) + away
        self._static_is_drawn = False

    def cast(self) -> None:
        """Update `splats.visibility` to the Gaussians' positions, without waiting for the device.

        The result is final after `finish`, to be called when waiting does no harm.
        """
        self._draw_static()
        if self.begin < self.splats.count:
            self._aim_dynamic(*self._eye.tolist(), self.light.softness, self.splats.count, 1.0)
            self.rasterizer.draw(DYNAMIC, self.begin, wait=False)
            self._unfinished = True
            self.map.join(DYNAMIC)
            self._receive(self.light.strength, self.light.softness, self.splats.count)
        else:
            self.splats.visibility.fill(1.0)

    def finish(self) -> bool:
        """Wait for the last cast and repeat it if its pairs exceeded the capacity.

        Returns whether they did: pictures drawn since then are wrong.
        """
        again = self._unfinished and self.rasterizer.finish(DYNAMIC)
        self._unfinished = False
        if again:
            self.map.join(DYNAMIC)
            self._receive(self.light.strength, self.light.softness, self.splats.count)
        return again

    def keep_captured_shadows(self, spans: Sequence[tuple[int, int]]) -> None:
        """Take the shadows that now fall on dynamic Gaussians, [begin, end) each, for those in their colours.

        To be called once, before the first cast. All dynamic Gaussians cast them: a body that replaces a captured one
        stands where that stood.
        """
        softness = self.light.softness
        self._draw_static()
        for width in CAPTURED_WIDTHS:
            self._aim_dynamic(*self._eye.tolist(), softness, self.splats.count, width)
            self.rasterizer.draw(DYNAMIC, self.begin)
            self.map.join(DYNAMIC)
            for begin, end in spans:
                self._keep_captured_shadows(begin, end, softness)

    def _draw_static(self) -> None:
        """Draw the map of static casters and expose the static Gaussians, unless that was done for this light."""
        if self._static_is_drawn:
            return
        half, distance = 0.5 * self.resolution, self._distance
        focal = half / min(self._radius / distance, MAX_TANGENT)
        view = look_at(self._eye, self.light.target)
        camera = Camera(self.resolution, self.resolution, focal, focal, half, half, view)
        self.rasterizer.forget()  # dynamic layers move its camera
        self.rasterizer.set_cameras([camera])
        self.rasterizer.projection.near[0] = distance - CASTING_FRACTION * min(distance, self._radius)
        self.rasterizer.draw(STATIC, 0, self.begin)
        self._keep_static_camera()
        self.map.join(STATIC)
        self._expose(self.light.softness)
        self._static_is_drawn = True

    @ti.kernel
    def _keep_static_camera(self):
        """Keep the rasterizer's camera as that of the static layer."""
        for k in ti.static(range(4)):
            self.camera[STATIC, k] = self.rasterizer.projection.camera[0, k]

    @ti.kernel
    def _aim_dynamic(
        self, eye_x: ti.f32, eye_y: ti.f32, eye_z: ti.f32, softness: ti.f32, end: ti.i32, width: ti.f32
    ):  # fmt: skip
        """Fit the cone to the box of the dynamic Gaussians and two sigmas, `width` times as wide as that.

        No texel is finer than the filter needs.
        """
        self._find_box(softness, end)
        for _ in range(1):
            self._aim_at_box(vec3(eye_x, eye_y, eye_z), softness, width)

    @ti.func
    def _find_box(self, softness: ti.f32, end: ti.i32):
        """Box of the dynamic Gaussians, each as large as two sigmas and the filter; outermost level of a kernel."""
        self.low[None] = vec3(1e6)
        self.high[None] = vec3(-1e6)
        for chunk in range(self.box_chunks):  # each reduces its own box first: atomics on one box would serialise
            low, high = vec3(1e6), vec3(-1e6)
            length = (end - self.begin + self.box_chunks - 1) // self.box_chunks
            for i in range(length):
                g = self.begin + (chunk + i * self.box_chunks if ti.static(self.on_gpu) else chunk * length + i)
                if g < end:
                    mean, s = self.splats.mean[g], self.splats.cov[g]
                    margin = 2.0 * ti.sqrt(ti.max(vec3(s[0], s[3], s[5]), 0.0)) + softness
                    if ti.abs(mean).max() < 1e5:  # far or not a number: must not spoil the cone
                        low, high = ti.min(low, mean - margin), ti.max(high, mean + margin)
            for k in ti.static(range(3)):  # then those of a warp become one
                low[k], high[k] = -max_lanes(-low[k], self.lanes), max_lanes(high[k], self.lanes)
                if chunk % self.lanes == 0:
                    if low[k] < self.low[None][k]:
                        ti.atomic_min(self.low[None][k], low[k])
                    if high[k] > self.high[None][k]:
                        ti.atomic_max(self.high[None][k], high[k])

    @ti.func
    def _aim_at_box(self, eye: vec3, softness: ti.f32, width: ti.f32):
        """Set the camera of the dynamic layer: at the middle of the box, as wide as its corners are apart."""
        low, high = self.low[None], self.high[None]
        middle = 0.5 * (low + high) - eye
        forward = middle.normalized(1e-9)
        right = forward.cross(vec3(0.0, 1.0, 0.0))
        if right.norm() < 1e-3:
            right = forward.cross(vec3(0.0, 0.0, 1.0))
        right = right.normalized()
        down = forward.cross(right)
        tangent = softness * self.resolution / (4 * MAX_FILTER_RADIUS * ti.max(middle.norm(), NEAR_PLANE))
        for corner in range(8):
            p = low - eye
            for k in ti.static(range(3)):
                if (corner >> k) & 1 == 1:
                    p[k] = high[k] - eye[k]
            z = forward.dot(p)
            if z > NEAR_PLANE:
                tangent = ti.max(tangent, ti.max(ti.abs(right.dot(p)), ti.abs(down.dot(p))) / z)
            else:  # the eye is among them
                tangent = MAX_TANGENT
        self.rasterizer.projection.near[0] = NEAR_PLANE
        t = -(ti.Matrix.rows([right, down, forward]) @ eye)
        half, focal = 0.5 * self.resolution, 0.5 * self.resolution / clamp(width * tangent, 1e-3, MAX_TANGENT)
        self._set_camera_row(DYNAMIC, 0, vec4(right, t[0]))
        self._set_camera_row(DYNAMIC, 1, vec4(down, t[1]))
        self._set_camera_row(DYNAMIC, 2, vec4(forward, t[2]))
        self._set_camera_row(DYNAMIC, 3, vec4(focal, focal, half, half))

    @ti.func
    def _set_camera_row(self, layer: ti.template(), k: ti.template(), row: vec4):
        """Set a row of the layer's camera, and of the rasterizer's."""
        self.camera[layer, k] = row
        self.rasterizer.projection.camera[0, k] = row

    @ti.func
    def _shade(self, layer: ti.template(), x: vec3, softness: ti.f32, bias: ti.f32, ramp: ti.f32) -> ti.f32:
        """Fraction of the light that the layer's casters block at x, 0..1: percentage-closer filtering.

        A tap is weighted by its coverage and by the depth of x behind it: 0 up to bias [m] + one
        texel, 1 from `ramp` [m] further.
        """
        p = vec3(0.0)
        for k in ti.static(range(3)):
            p[k] = self.camera[layer, k].xyz.dot(x) + self.camera[layer, k].w
        shade = 0.0
        if p.z > NEAR_PLANE:
            focal = self.camera[layer, 3].x
            u, v = focal * p.x / p.z + 0.5 * self.resolution, focal * p.y / p.z + 0.5 * self.resolution
            if u >= 0 and v >= 0 and u < self.resolution and v < self.resolution:
                radius = clamp(0.5 * softness * focal / p.z, 1.0, MAX_FILTER_RADIUS)
                behind = p.z - bias - p.z / focal
                nearest = self.map.nearest[layer, ti.cast(v, ti.i32) // CELL, ti.cast(u, ti.i32) // CELL]
                for i in range(TAPS * TAPS if behind > nearest else 0):
                    du, dv = i % TAPS - 0.5 * (TAPS - 1), i // TAPS - 0.5 * (TAPS - 1)
                    column = ti.cast(ti.floor(u + du * radius * (2.0 / TAPS)), ti.i32)
                    row = ti.cast(ti.floor(v + dv * radius * (2.0 / TAPS)), ti.i32)
                    if 0 <= column < self.resolution and 0 <= row < self.resolution:
                        tap = self.map.texel[layer, row, column]
                        shade += tap[1] * clamp((behind - tap[0]) / ramp, 0.0, 1.0)
        return shade / (TAPS * TAPS)

    @ti.kernel
    def _expose(self, softness: ti.f32):
        """Set the exposure of static Gaussians to the light past the static scene."""
        for g in range(self.begin):
            shade = self._shade(STATIC, self.splats.mean[g], softness, STATIC_BIAS, STATIC_BIAS)
            self.splats.exposed[g] = 1.0 - shade

    @ti.func
    def _light_on_dynamic(self, g: ti.i32, softness: ti.f32) -> ti.f32:
        """Fraction of the light that reaches a dynamic Gaussian past both layers, 0..1."""
        mean = self.splats.mean[g]
        # a filter as wide as `softness` reaches that much deeper on a slope of 45 degrees
        bias, ramp = OWN_BIAS + softness + 2.0 * self._size(g), OWN_BIAS + 0.5 * softness
        light = 1.0 - self._shade(DYNAMIC, mean, softness, bias, ramp)
        return light * (1.0 - self._shade(STATIC, mean, softness, bias, ramp))

    @ti.func
    def _size(self, g: ti.i32) -> ti.f32:
        """Root mean square of a Gaussian's sigmas [m]."""
        s = self.splats.cov[g]
        return ti.sqrt(ti.max((s[0] + s[3] + s[5]) / 3.0, 0.0))

    @ti.kernel
    def _keep_captured_shadows(self, begin: ti.i32, end: ti.i32, softness: ti.f32):
        for g in range(begin, end):
            self.splats.exposed[g] = ti.min(self.splats.exposed[g], self._light_on_dynamic(g, softness))

    @ti.kernel
    def _receive(self, strength: ti.f32, softness: ti.f32, end: ti.i32):
        """Set the visibility of all Gaussians from the maps."""
        for k in range(end):
            g = dealt(k, end)
            exposed, visibility = self.splats.exposed[g], 1.0
            if g < self.begin:
                shade = self._shade(DYNAMIC, self.splats.mean[g], softness, OWN_BIAS, OWN_BIAS)
                visibility = 1.0 - strength * shade * exposed
            else:
                light = self._light_on_dynamic(g, softness)
                if light < exposed:
                    visibility = (1.0 - strength + strength * light) / (1.0 - strength + strength * exposed)
            self.splats.visibility[g] = visibility
