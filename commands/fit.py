"""`vrgs.py fit`: the material of a real thing, from how markers on it moved."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets.asset import Asset
from assets.file_access import atomic_write, check_writable
from assets.library import default_material, find_asset
from commands import options as cli
from core.errors import BadInput
from core.runtime import start_taichi


@dataclass(kw_only=True)
class FitOptions(cli.Options):
    EXAMPLES = (
        "fit bear.h5 --from-trajectory points.npz --out fitted.h5 --report fit.html",
        "fit bear.h5 --from-trajectory points.npz --out fitted.h5 --density 85",
    )

    asset: str = cli.argument("ASSET", "a prepared asset, or a shipped one by name")
    from_trajectory: Path = cli.option("POINTS.npz", "tracked markers on it (docs/formats.md)", cli.REQUIRED)
    out: Path = cli.option("FITTED.h5", "the asset with the fitted material", cli.REQUIRED)
    report: Path | None = cli.option("R.html", "page with the numbers, their intervals and curves")
    density: cli.Amount | None = cli.option(
        "RHO", "its density as weighed [kg/m^3]: motion under gravity alone shows only Young's modulus / density"
    )
    arch: cli.Arch | None = cli.arch_option()


def fit(options: FitOptions) -> None:
    """Fit, write the asset and the report, and print the numbers. Raises BadInput."""
    from prepare.fit.fit_report import lines_of, page_of
    from prepare.fit.marker_tracks import read_tracks
    from prepare.fit.material_fit import STEPS, MaterialProblem, fit_material
    from prepare.progress import Checkpoints, StepProgress

    if options.out.suffix.lower() != ".h5":
        raise BadInput(f"{options.out}: an asset's name ends in .h5")
    if options.report and options.report.suffix.lower() != ".html":
        raise BadInput(f"{options.report}: a report's name ends in .html")
    for file in filter(None, (options.out, options.report)):
        check_writable(file)
    path = find_asset(options.asset)
    asset = Asset.load(path)
    if asset.cage is None:
        raise BadInput(f"{options.asset}: has no cage to simulate (make one: python vrgs.py prepare)")
    material = asset.material or default_material(str(path))
    if options.density:
        material = replace(material, density=options.density)
    tracks = read_tracks(options.from_trajectory)
    start_taichi(options.arch)
    simulator = Simulator(tracks)
    where = str(options.from_trajectory)
    problem = MaterialProblem(tracks, asset.cage.vertices, asset.cage.tets, material, simulator.roll, where)
    kept = Checkpoints(options.from_trajectory, {"asset": str(path), "material": repr(material)})
    found = fit_material(problem, StepProgress(STEPS), kept.step, mass_known=options.density is not None)
    replace(asset, material=found.material).save(options.out)
    if options.report:
        with atomic_write(options.report) as beside:
            beside.write_text(page_of(found, tracks, Path(options.asset).stem), encoding="utf-8")
    kept.clear()
    print("\n".join(lines_of(found)))
    print(f"wrote {options.out}" + (f" and {options.report}" if options.report else ""), file=sys.stderr)


class Simulator:
    """Rolls candidates out among the planes and in the gravity of the tracks; one solver a cage."""

    def __init__(self, tracks):
        self.tracks, self.solvers = tracks, {}

    def roll(self, cage, candidates: list) -> np.ndarray:
        """Places of the markers [m] (F, C, M, 3) of candidates, each a material and positions and velocities (V, 3)."""
        from sim.model import MAX_BODIES
        from sim.rollouts import Candidate, Rollouts

        t = self.tracks
        if cage not in self.solvers:
            way = np.nanmax(np.ptp(t.points[np.isfinite(t.points).all(2)], axis=0))
            apart = 2.0 * (np.ptp(cage.vertices, axis=0).max() + way)
            self.solvers[cage] = Rollouts(
                cage.vertices, cage.tets, cage.held, MAX_BODIES, planes=t.planes, gravity=t.gravity, apart=apart
            )
        rollouts = self.solvers[cage]
        made = [Candidate(*c) for c in candidates]
        parts = [made[k : k + MAX_BODIES] for k in range(0, len(made), MAX_BODIES)]
        return np.concatenate([rollouts.run(part, t.times, cage.markers, t.release) for part in parts], axis=1)
