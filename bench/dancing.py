"""A body that moves by itself, over its whole motion: is anything torn, turned inside out, or drawn out to a spike?

    python -m bench.dancing DANCER.h5 [--json ROWS.json] [--strip OUT.png] [--yaw DEG]

The body starts at rest, goes over into its motion, and plays it once. The strip shows it from head to foot, and from
near: head, shoulders, hips.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.animation import RAMP, world_of
from assets.asset import Asset
from core.camera import Camera, look_at, perspective
from core.material import Material
from scenes.scene import Body, Light, Plane, Scene

FPS = 60
DRAWN = 2.5  # times as long as at rest: such a Gaussian stands out of the surface, if it was not tiny
NEEDLE = 3.0  # times as slender as at rest
SEEN = 0.2  # opacity from which on it is counted
LONG = 0.004  # of the body's height: the axis of a Gaussian that can be seen as a spike
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
BACKGROUND = (0.85, 0.87, 0.9)
NEAR = {"head": 0.32, "left_shoulder": 0.36, "right_shoulder": 0.36, "pelvis": 0.42}  # what is shown, of the height
WIDTH, HEIGHT = 320, 420  # [px] of a picture


@dataclass
class Measure:
    """What a frame is held against: the cage and the Gaussians at rest."""

    tets: np.ndarray
    rest: np.ndarray
    seen: np.ndarray
    axes: np.ndarray

    @classmethod
    def of(cls, asset: Asset, opacity: np.ndarray, cov: np.ndarray) -> Measure:
        """cov (N, 6) [m^2] of the Gaussians at rest in the order of the splats, opacity (N,)."""
        axes = axes_of(cov)
        return cls(asset.cage.tets.astype(np.int64), asset.cage.vertices.astype(np.float64), opacity > SEEN, axes)

    def row(self, x: np.ndarray, cov: np.ndarray) -> dict:
        """The figures of a frame: x (V, 3) [m], cov (N, 6) [m^2]."""
        volume = volumes(x, self.tets) / volumes(self.rest, self.tets)
        ends = self.tets[:, EDGES]
        length = [np.linalg.norm(p[ends[..., 0]] - p[ends[..., 1]], axis=-1) for p in (self.rest, x)]
        stretch = length[1] / length[0]
        least = LONG * float(np.ptp(self.rest[:, 1]))
        long = np.flatnonzero(self.seen & (cov[:, [0, 3, 5]].sum(1) > least**2))  # the others are surely shorter
        axes, rest = axes_of(cov[long]), self.axes[long]
        visible = axes[:, 2] > least
        slender = axes[:, 2] / np.maximum(axes[:, 1], 1e-9), rest[:, 2] / np.maximum(rest[:, 1], 1e-9)
        return {
            "inverted": int((volume <= 0).sum()),
            "least_volume": float(volume.min()),
            "stretch": float(stretch.max()),
            "drawn": int((visible & (axes[:, 2] > DRAWN * rest[:, 2])).sum()),
            "needles": int((visible & (slender[0] > NEEDLE * slender[1])).sum()),
        }


def volumes(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Six times the volume of each tet [m^3], (T,)."""
    return np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]])


def axes_of(cov: np.ndarray) -> np.ndarray:
    """Half axes [m] of covariances (N, 6), rising, (N, 3)."""
    full = cov.astype(np.float64)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return np.sqrt(np.linalg.eigvalsh(full).clip(0))


def stage(path: str, height: float, material: str) -> Scene:
    """The body on the ground."""
    return Scene(
        bodies=[Body(path, Material.moving(material, height))],
        light=Light(position=(height, 3 * height, 2 * height)),
        eye=(0.0, 0.6 * height, 2.4 * height),
        target=(0.0, 0.5 * height, 0.0),
        colliders=[Plane((0, 0, 0), (0, 1, 0))],
        background=BACKGROUND,
    )


def cameras(asset: Asset, time: float, yaw: float) -> list[Camera]:
    """From head to foot, and near to each of NEAR, which the rig may lack."""
    a, size = asset.animation, float(np.ptp(asset.cage.vertices[:, 1]))
    rest = world_of(a.parents, a.rest)[:, :3, 3]
    now = a.matrices(time)
    way = np.array([np.sin(yaw), 0.1, np.cos(yaw)])
    views = [(np.array([0, 0.55 * size, 0]), 1.45)]
    for name, share in NEAR.items():
        if name in a.names:
            j = a.names.index(name)
            views.append((now[j, :3, :3] @ rest[j] + now[j, :3, 3], share))
    fov = 0.3
    return [
        perspective(
            WIDTH, HEIGHT, fov, look_at(tuple(c + 0.5 * share * size / np.tan(fov / 2) * way), tuple(c))
        )
        for c, share in views
    ]  # fmt: skip


def play(path: Path, *, moments: int = 0, yaw: float = 0.0, seconds: float | None = None, material: str = "flesh"):
    """Rows of each frame, and pictures (moments, views, H, W, 3) of some."""
    from display.picture import pixels_of
    from display.protocol import Frame
    from display.world import World

    asset = Asset.load(path)
    a, size = asset.animation, float(np.ptp(asset.cage.vertices[:, 1]))
    world = World(stage(str(path), size, material), width=WIDTH, height=HEIGHT)
    draw, world.renderer.render = world.renderer.render, lambda cameras: None
    world.shadow.cast, cast = (lambda: None), world.shadow.cast
    seconds = RAMP + a.duration if seconds is None else seconds
    count = round(FPS * seconds)
    picked = set(np.linspace(FPS * RAMP * 0.6, count - 1, moments).astype(int)) if moments else set()
    opacity = 1 / (1 + np.exp(-asset.gaussians.logit_opacities))
    splats = world.splats
    N = len(opacity)
    from core.morton import morton_order

    measure = Measure.of(asset, opacity[morton_order(asset.gaussians.means)], splats.cov.to_numpy()[:N])
    rows, pictures = [], []
    V = len(asset.cage.vertices)
    for k in range(count):
        time = (k + 1) / FPS
        world.step(Frame(1 / FPS, time, []))
        rows.append(measure.row(world.solver.x.to_numpy()[:V].astype(np.float64), splats.cov.to_numpy()[:N]))
        if k in picked:
            cast()
            pictures.append([])
            for camera in cameras(asset, time, yaw):
                draw([camera])
                pictures[-1].append(pixels_of(world.picture)[..., :3].copy())
    return rows, pictures


def summary(rows: list[dict]) -> dict:
    """The worst of all frames."""
    worst = {"frames": len(rows), "frames_with_inverted": sum(r["inverted"] > 0 for r in rows)}
    for key in rows[0]:
        values = [r[key] for r in rows]
        worst[key] = min(values) if key == "least_volume" else max(values)
    return worst


def main() -> None:
    import cv2

    from core.runtime import start_taichi

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("asset", type=Path)
    p.add_argument("--arch", choices=("cpu", "cuda"))
    p.add_argument("--json", type=Path, help="write the figures of each frame")
    p.add_argument("--strip", type=Path, help="write pictures")
    p.add_argument("--moments", type=int, default=10)
    p.add_argument("--yaw", type=float, default=0.0, help="degrees from +z from which it is seen")
    p.add_argument("--seconds", type=float, help="(default: once through the motion)")
    args = p.parse_args()
    start_taichi(args.arch)
    moments = args.moments if args.strip else 0
    rows, pictures = play(args.asset, moments=moments, yaw=np.radians(args.yaw), seconds=args.seconds)
    print(json.dumps(summary(rows), indent=1))
    if args.json:
        args.json.write_text(json.dumps(rows))
    if pictures:
        page = np.concatenate([np.concatenate(column, 0) for column in pictures], 1)
        cv2.imwrite(str(args.strip), page[..., ::-1])


if __name__ == "__main__":
    main()
