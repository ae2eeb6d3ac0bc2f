"""Report of a preparation in pictures and numbers, as one HTML file and one JSON file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from assets.asset import Asset
from core.distance_grid import marching_cubes
from core.point_location import TetLocator
from core.report import Section, Table, html_page
from core.tetmesh import enclosed_volume, face_components, tet_volumes, triangle_areas
from prepare import report_pictures
from prepare.cage import level_set
from prepare.cage.component_cages import OPAQUE
from prepare.cage.mesh_quality import dihedral_angles, euler_characteristic, non_manifold_vertices

BIN_WIDTH = 5.0  # [degrees] of the histogram
MAX_POINTS = 40_000  # Gaussians that are measured


def report_names(out: Path) -> tuple[Path, Path]:
    """Paths of the report of the asset `out`: ASSET.report.html and ASSET.report.json."""
    return out.with_suffix(".report.html"), out.with_suffix(".report.json")


def report_texts(name: str, numbers: dict, pictures: dict[str, np.ndarray], notes: Sequence[str]) -> tuple[str, str]:
    """Contents of the files of `report_names`, a page and JSON: the numbers and pictures of `examine`.

    name   of the asset's file
    notes  lines printed while it was made
    """
    numbers = numbers | {"notes": list(notes)}
    return page_of(name, numbers, pictures), json.dumps(numbers, indent=2) + "\n"


def examine(asset: Asset, solids: list[level_set.ComponentSolid]) -> tuple[dict, dict[str, np.ndarray]]:
    """Numbers, ready for JSON (lengths [m], angles [degrees]), and pictures by name, of an asset and the solid of each
    of its components. Taichi must be running."""
    cage, g = asset.cage, asset.gaussians
    opaque = g.opacities > OPAQUE
    points = g.means[opaque if opaque.any() else slice(None)].astype(np.float64)
    points = points[:: len(points) // MAX_POINTS + 1]
    inside = TetLocator(cage.vertices, cage.tets).find(points) >= 0
    to_cage = level_set.distance_to_surface(points, cage.vertices, cage.surface)
    to_gaussians = cKDTree(points).query(level_set.surface_samples(cage.vertices, cage.surface)[0])[0]
    angles = dihedral_angles(cage.vertices, cage.tets)
    levels = [marching_cubes(solid.distance) for solid in solids]
    first = np.cumsum([0, *(len(x) for x, _ in levels)])  # vertex of each component
    level = np.concatenate([x for x, _ in levels])
    faces = np.concatenate([f + k for (_, f), k in zip(levels, first, strict=False)])
    volume = tet_volumes(cage.vertices, cage.tets)
    longest = float(np.ptp(cage.vertices, axis=0).max())
    numbers = {
        "asset": {key: asset.provenance.get(key) for key in ("source", "made_by", "up", "size", "options", "counts")},
        "cage": {
            "mesher": asset.provenance["figures"].get("mesher", "stuffing"),
            "cells": asset.provenance["figures"].get("cells", "adaptive"),
            "vertices": len(cage.vertices),
            "tets": len(cage.tets),
            "triangles": len(cage.surface),
            "volume": float(volume.sum()),
            "smallest_tet": float(volume.min()),
            "pieces": int(face_components(cage.tets).max()) + 1,
            "non_manifold_vertices": len(non_manifold_vertices(cage.surface)),
            "euler_characteristic": euler_characteristic(cage.surface),
        },
        "surface": {
            "vertices": len(level),
            "triangles": len(faces),
            "area": float(triangle_areas(level, faces).sum()),
            "volume": enclosed_volume(level, faces),
            "cell": float(solids[0].distance.spacing),
        },
        "dihedral": {
            "min": float(angles.min()),
            "p1": float(np.percentile(angles, 1)),
            "median": float(np.median(angles)),
            "max": float(angles.max()),
            "bin": BIN_WIDTH,
            "histogram": np.histogram(angles, np.arange(0, 180 + BIN_WIDTH, BIN_WIDTH))[0].tolist(),
        },
        "enclosure": {"points": len(points), "inside": float(inside.mean()), "outside": int((~inside).sum())},
        "distance": {
            "gaussians_to_cage": level_set.distance_statistics(to_cage),
            "cage_to_gaussians": level_set.distance_statistics(to_gaussians),
            "symmetric_mean": float((to_cage.mean() + to_gaussians.mean()) / 2),
            "hausdorff": float(max(to_cage.max(), to_gaussians.max())),
        },
        "largest_extent": longest,
        "seconds": asset.provenance["figures"].get("seconds"),
    }
    camera = report_pictures.camera_for(cage.vertices.astype(np.float64))
    pictures = {
        "splat": report_pictures.splat_picture(asset, camera),
        "cells": report_pictures.cells_picture(solids, camera),
        "surface": report_pictures.surface_picture(level, faces, camera),
        "cage": report_pictures.cage_picture(asset, camera),
        "enclosure": report_pictures.enclosure_picture(asset, points, inside, np.where(inside, to_cage, 0.0), camera),
    }
    return numbers, pictures


CAPTIONS = {
    "up": "Which way is up? The guess is not sure: prepare again with the option under the right picture.",
    "splat": "Splat: the Gaussians that were kept, drawn by the program's renderer.",
    "cells": "Filled cells, cut open. Clay: dense Gaussians; blue: the interior they enclose.",
    "surface": "Surface: where the level set is zero, by marching cubes.",
    "cage": "Cage: the tetrahedra, cut open. Green: the cut.",
    "enclosure": "Enclosure: opaque Gaussians in the cage, the deeper the darker. Red: those outside.",
}
DISTANCES = {"gaussians_to_cage": "Gaussians to the cage", "cage_to_gaussians": "cage to the Gaussians"}


def page_of(name: str, numbers: dict, pictures: dict[str, np.ndarray]) -> str:
    cage, dihedral, distance = numbers["cage"], numbers["dihedral"], numbers["distance"]
    counts, extent = numbers["asset"]["counts"] or {}, numbers["largest_extent"]
    facts = (
        (f"{counts.get('kept', 0):,}", f"Gaussians of {counts.get('read', 0):,}"),
        (f"{cage['vertices']:,}", "cage vertices"),
        (f"{cage['tets']:,}", f"tetrahedra, {cage['cells']} cells"),
        *([(f"{cage['pieces']}", "pieces")] if cage["pieces"] > 1 else []),
        (f"{dihedral['min']:.1f}°", "smallest dihedral angle"),
        (f"{numbers['enclosure']['inside']:.2%}", "of the opaque Gaussians inside"),
        (length(distance["symmetric_mean"]), "mean distance, both ways"),
        (f"{1e6 * cage['volume']:,.4g} cm³", "volume"),
        (f"{numbers['seconds'] or 0:.1f} s", "to prepare"),
    )
    figures = {caption: pictures[key] for key, caption in CAPTIONS.items() if key in pictures}
    median = f"All six dihedral angles of each tet, median {dihedral['median']:.0f}°. Red: the smallest."
    figures[f"{median} Heights are square roots of counts."] = histogram(dihedral)
    rows = [
        (title, *(f"{length(distance[key][k])} ({distance[key][k] / extent:.2%})" for k in ("mean", "p95", "max")))
        for key, title in DISTANCES.items()
    ]
    table = Table(("Distance (of the largest extent)", "mean", "95 %", "largest"), rows)
    source = numbers["asset"]["source"] or "a splat"
    text = f"Made from {source}; largest extent {length(extent)}; mesher {cage['mesher']}."
    return html_page(
        name, text, [Section("Preparation", pictures=figures, table=table, items=tuple(numbers["notes"]), facts=facts)]
    )


def histogram(dihedral: dict) -> str:
    """Histogram of the dihedral angles, an SVG drawing as large as a picture; the smallest angle in red."""
    bars, least, floor, left = np.sqrt(dihedral["histogram"]), dihedral["min"], 452.0, 44.0  # [px] floor, left
    across, up = 502.0 / 180.0, 438.0 / (bars.max() or 1.0)  # [px] a degree, and a unit of the bars
    parts = [f'<polyline points="{left},{floor} {left + 180 * across:.1f},{floor}" stroke="#999"/>']
    for d in range(0, 181, 30):
        parts.append(f'<text x="{left + across * d:.1f}" y="472" text-anchor="middle">{d}°</text>')
    for k in np.flatnonzero(bars):
        x, width, height = left + across * k * dihedral["bin"] + 1, across * dihedral["bin"] - 2, up * bars[k]
        place = f'x="{x:.1f}" y="{floor - height:.1f}" width="{width:.1f}" height="{height:.1f}"'
        parts.append(f'<rect {place} fill="#5d93a0"/>')
    x = left + across * least
    parts.append(f'<polyline points="{x:.1f},{floor} {x:.1f},14" stroke="#c82828" stroke-width="2"/>')
    parts.append(f'<text x="{x + 2 * across:.1f}" y="{floor - 0.96 * 438:.1f}">{least:.1f}°</text>')
    return f'<svg viewBox="0 0 560 480" width="560" height="480">{"".join(parts)}</svg>'


def length(metres: float) -> str:
    """A length in a unit that suits it."""
    for unit, size in (("m", 1.0), ("cm", 0.01)):
        if metres >= size:
            return f"{metres / size:.3g} {unit}"
    return f"{1e3 * metres:.3g} mm"
