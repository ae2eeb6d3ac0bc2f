"""`vrgs.py tune`: drop a body on a floor with one stiffness after another, measure, and draw it as a strip.

How the paper finds a material: watch how far each Young's modulus lets the body deform (VR-GS, Sec. 5).
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.library import find_asset
from core.errors import BadInput
from core.material import DEFAULT_MATERIAL, Material
from display.headless.picture_strip import PANEL, strip
from display.headless.test_floor import framing, studio
from display.headless.video import claim
from display.picture import pixels_of, save_png
from display.protocol import Frame
from display.run_stats import write_stats

STEP = 1 / 120  # [s] between two looks at the body: a stiff one touches the floor for some milliseconds only
LONGEST = 4.0  # [s] of a drop
RESTS_AT = 0.02  # [m/s], root mean square over the vertices
RESTS_FOR = 0.25  # [s]


@dataclass(frozen=True)
class Drop:
    """What one stiffness did. Heights are shares of the undeformed body's in the attitude that it has then."""

    young: float  # [Pa]
    compression: float  # the greatest, of the height
    rebound: float  # [m] that its lowest point rises afterwards
    settled: float  # height at the end
    at_rest: bool  # whether the end is that
    substeps: int  # of a frame of 1/60 s
    dt: float  # [s]
    path: str
    finite: bool
    pictures: tuple[np.ndarray, np.ndarray]  # at the greatest compression and at the end

    def row(self) -> dict:
        """All but the pictures."""
        return {key: value for key, value in vars(self).items() if key != "pictures"}


def run(args) -> None:
    """vrgs.py tune ASSET [--young E ... | --from E --to E --steps N] [--height M] [--out STRIP.png] [--json OUT]."""
    path = find_asset(args.asset)
    asset = Asset.load(path)
    if asset.cage is None:
        raise BadInput(f"{args.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    youngs = args.young or np.geomspace(args.lowest, args.highest, args.steps).tolist()
    out = args.out or Path(f"{path.stem}_tune.png")
    for file in filter(None, (out, args.json)):
        claim(file, file.with_name(f".{file.name}.part"))
    material = Material.named(args.material) if args.material else asset.material or Material.named(DEFAULT_MATERIAL)
    height = np.ptp(asset.cage.vertices[:, 1])
    drop = args.height or float(max(0.1, 0.5 * height))
    drops = []
    print(f"{path.stem}, {100 * height:.1f} cm high, dropped from {drop:.2f} m")
    print(f"{'young [Pa]':>10} {'compression':>12} {'rebound':>10} {'settled':>9} {'substeps':>9} {'dt [s]':>10}  path")
    for d in drop_each(path, asset.cage.vertices, material, youngs, drop):
        notes = ["" if d.at_rest else "still moving", "" if d.finite else "not finite"]
        print(
            f"{d.young:10.3g} {d.compression:12.1%} {100 * d.rebound:7.1f} cm {d.settled:9.1%} {d.substeps:9d}"
            f" {d.dt:10.3g}  {d.path}  {', '.join(filter(None, notes))}".rstrip(),
            flush=True,
        )
        drops.append(d)
    save_png(out, strip(path.stem, drops, drop))
    if args.json:
        write_stats(args.json, [d.row() for d in drops])
    print(f"wrote {out}", file=sys.stderr)


def drop_each(path: Path, cage: np.ndarray, material: Material, youngs: list[float], height: float):
    """Drop the asset with each Young's modulus [Pa] from `height` [m]; yields a Drop each."""
    from display.world import World

    with tempfile.TemporaryDirectory() as folder:
        scene = studio(path, cage, replace(material, young=youngs[0]), height, Path(folder))
        world = World(scene, width=PANEL, height=PANEL)
    for young in youngs:
        for body in range(len(world.bodies())):  # the pieces of the asset
            world.device.solver.set_material(body, replace(material, young=young))
        world.device.solver.reset()
        yield dropped(world, cage.astype(np.float64), young)


def dropped(world, cage: np.ndarray, young: float) -> Drop:
    """One drop to the end."""
    solver = world.device.solver
    crushed, least, rebound, quiet, time = solver.snapshot(), np.inf, 0.0, 0.0, 0.0
    while time < LONGEST and quiet < RESTS_FOR:
        solver.step(STEP)
        time += STEP
        now = solver.snapshot()
        x = now["x"].astype(np.float64)
        if not np.isfinite(x).all():
            break
        share = np.ptp(x[:, 1]) / upright(cage, x)
        touched = least < np.inf
        if x[:, 1].min() < 1e-3 * np.ptp(cage, axis=0).max() or touched:
            if share < least:
                least, crushed, rebound = share, now, 0.0
            rebound = max(rebound, x[:, 1].min())
            speed = np.sqrt((now["v"] ** 2).sum(1).mean())
            quiet = quiet + STEP if speed < RESTS_AT else 0.0
    stats = solver.stats
    pictures = tuple(drawn(world, cage, q) for q in (crushed, now)) if stats["finite"] else 2 * (blank(),)
    return Drop(
        young=young,
        compression=float(1 - least),
        rebound=float(rebound),
        settled=float(share),
        at_rest=quiet >= RESTS_FOR,
        substeps=round(1 / 60 / stats["dt"]),
        dt=stats["dt"],
        path=stats["integrator"],
        finite=stats["finite"] and stats["recovered"] == 0,
        pictures=pictures,
    )


def upright(rest: np.ndarray, x: np.ndarray) -> float:
    """Height [m] of the undeformed body, turned as the deformed one is (the rotation nearest to it)."""
    U, _, Vt = np.linalg.svd((x - x.mean(0)).T @ (rest - rest.mean(0)))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.ptp((rest @ R.T)[:, 1]))


def drawn(world, cage: np.ndarray, snapshot: dict) -> np.ndarray:
    """Picture (H, W, 3) uint8 of a moment, with the undeformed height beside the body."""
    world.device.solver.restore(snapshot)
    x = snapshot["x"].astype(np.float64)
    camera = framing(x.mean(0), np.ptp(cage, axis=0), PANEL, PANEL)
    world.step(Frame(0.0, 0.0, [camera]))
    picture = pixels_of(world.picture)[..., :3].copy()
    from display.headless.picture_strip import mark_height

    mark_height(picture, camera, x, upright(cage, x))
    return picture


def blank() -> np.ndarray:
    return np.full((PANEL, PANEL, 3), 255, np.uint8)
