"""Report of a preparation in pictures and numbers, as one HTML file and one JSON file."""

from __future__ import annotations

import base64
import html
import json
import math
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from assets.asset import Asset
from core.tetmesh import enclosed_volume, face_components, tet_volumes
from prepare.cage.component_cages import OPAQUE
from prepare.cage.embedding_hosts import DeviceLocator
from prepare.cage.level_set import (
    ComponentSolid,
    areas,
    distance_statistics,
    distance_to_surface,
    marching_cubes,
    surface_samples,
)
from prepare.cage.mesh_quality import (
    dihedral_angles,
    euler_characteristic,
    non_manifold_vertices,
)
from prepare.report_pictures import (
    cage_picture,
    camera_for,
    cells_picture,
    enclosure_picture,
    png_of,
    splat_picture,
    surface_picture,
)

BIN_WIDTH = 5.0  # [degrees] of the histogram
MAX_POINTS = 40_000  # Gaussians that are measured


def report_names(out: Path) -> tuple[Path, Path]:
    """Paths of the report of the asset `out`: ASSET.report.html and ASSET.report.json."""
    return out.with_suffix(".report.html"), out.with_suffix(".report.json")


def report_texts(
    asset: Asset,
    solids: list[ComponentSolid],
    name: str,
    *,
    notes: tuple[str, ...] = (),
    splat: np.ndarray | None = None,
    up: np.ndarray | None = None,
) -> tuple[str, str]:
    """Contents of the files of `report_names` for the asset of the file `name`: a page, and the numbers as JSON.

    solids  of each component
    notes   lines printed while it was made
    splat   picture of the Gaussians, if it is drawn already
    up      strip of the alternatives, where it is not sure which way is up
    Taichi must be running.
    """
    numbers, pictures = examine(asset, solids, splat)
    return texts_of(name, numbers, pictures if up is None else {"up": up} | pictures, notes)


def texts_of(name: str, numbers: dict, pictures: dict[str, np.ndarray], notes: tuple[str, ...]) -> tuple[str, str]:
    """The page and the JSON text of the numbers and pictures of `examine`."""
    numbers = dict(numbers)
    numbers["notes"] = list(notes)
    return html_of(name, numbers, pictures), json.dumps(numbers, indent=2) + "\n"


def examine(
    asset: Asset, solids: list[ComponentSolid], splat: np.ndarray | None = None
) -> tuple[dict, dict[str, np.ndarray]]:
    """Numbers, ready for JSON (lengths [m], angles [degrees]), and pictures by name."""
    cage, g = asset.cage, asset.gaussians
    opaque = g.opacities > OPAQUE
    points = g.means[opaque if opaque.any() else slice(None)].astype(np.float64)
    points = points[:: len(points) // MAX_POINTS + 1]
    inside = DeviceLocator(cage.vertices, cage.tets).find(points) >= 0
    to_cage = distance_to_surface(points, cage.vertices, cage.surface)
    to_gaussians = cKDTree(points).query(surface_samples(cage.vertices, cage.surface)[0])[0]
    angles = dihedral_angles(cage.vertices, cage.tets)
    level, faces = surfaces_of(solids)
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
            "area": float(areas(level, faces).sum()),
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
            "gaussians_to_cage": distance_statistics(to_cage),
            "cage_to_gaussians": distance_statistics(to_gaussians),
            "symmetric_mean": float((to_cage.mean() + to_gaussians.mean()) / 2),
            "hausdorff": float(max(to_cage.max(), to_gaussians.max())),
        },
        "largest_extent": longest,
        "seconds": asset.provenance["figures"].get("seconds"),
    }
    camera = camera_for(cage.vertices.astype(np.float64))
    pictures = {
        "splat": splat_picture(asset, camera) if splat is None else splat,
        "cells": cells_picture(solids, camera),
        "surface": surface_picture(level, faces, camera),
        "cage": cage_picture(asset, camera),
        "enclosure": enclosure_picture(asset, points, inside, np.where(inside, to_cage, 0.0), camera),
    }
    return numbers, pictures


def surfaces_of(solids: list[ComponentSolid]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] and triangles (F, 3) where the level sets of all components are zero."""
    vertices, faces, first = [], [], 0
    for solid in solids:
        x, f = marching_cubes(solid.distance)
        vertices.append(x)
        faces.append(f + first)
        first += len(x)
    return np.concatenate(vertices), np.concatenate(faces)


CAPTIONS = {
    "up": ("Which way is up?", "The guess is not sure. Prepare again with the option under the right picture."),
    "splat": ("Splat", "The Gaussians that were kept, drawn by the program's renderer."),
    "cells": ("Filled cells", "Cut open. Clay: dense Gaussians; blue: the interior they enclose."),
    "surface": ("Surface", "Where the level set is zero, by marching cubes."),
    "cage": ("Cage", "The tetrahedra, cut open. Green: the cut."),
    "enclosure": ("Enclosure", "Opaque Gaussians in the cage, the deeper the darker. Red: those outside."),
}
STYLE = """
body{margin:0;background:#f1efeb;color:#282624;font:15px/1.45 system-ui,sans-serif}
main{max-width:1160px;margin:0 auto;padding:32px 24px}
h1{font-size:26px;margin:0 0 4px}h2{font-size:16px;margin:0 0 2px}p{margin:0;color:#78746f}
.facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;margin:22px 0}
.fact,figure{background:#faf9f7;border-radius:8px;box-shadow:0 1px 3px #0002}
.fact{padding:12px 16px}.fact b{display:block;font-size:21px;font-weight:600}.fact span{color:#78746f;font-size:13px}
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(330px,1fr));gap:16px}
figure{margin:0;overflow:hidden}figure img,figure svg{display:block;width:100%;height:auto}
figcaption{padding:10px 16px 14px;border-top:1px solid #e6e3de}
table{border-collapse:collapse;width:100%;margin-top:22px;background:#faf9f7;border-radius:8px;font-size:14px;
box-shadow:0 1px 3px #0002}
td,th{padding:7px 16px;text-align:right;border-top:1px solid #e6e3de}th{color:#78746f;font-weight:500;border:0}
td:first-child,th:first-child{text-align:left}
.note{margin-top:14px;padding:10px 16px;background:#fdf3e2;border-radius:8px;color:#6b4b12}
"""


def html_of(name: str, numbers: dict, pictures: dict[str, np.ndarray]) -> str:
    """HTML page that loads nothing from elsewhere; every text from a file is escaped."""
    cage, dihedral, inside = numbers["cage"], numbers["dihedral"], numbers["enclosure"]["inside"]
    source = numbers["asset"]["source"] or "a splat"
    counts = numbers["asset"]["counts"] or {}
    facts = [
        (f"{counts.get('kept', 0):,}", f"Gaussians of {counts.get('read', 0):,}"),
        (f"{cage['vertices']:,}", "cage vertices"),
        (f"{cage['tets']:,}", f"tetrahedra, {cage['cells']} cells"),
        *([(f"{cage['pieces']}", "pieces")] if cage["pieces"] > 1 else []),
        (f"{dihedral['min']:.1f}°", "smallest dihedral angle"),
        (f"{inside:.2%}", "of the opaque Gaussians inside"),
        (length(numbers["distance"]["symmetric_mean"]), "mean distance, both ways"),
        (f"{1e6 * cage['volume']:,.4g} cm³", "volume"),
        (f"{numbers['seconds'] or 0:.1f} s", "to prepare"),
    ]
    figures = [
        f'<figure><img alt="{title}" src="data:image/png;base64,{base64.b64encode(png_of(pictures[key])).decode()}">'
        f"<figcaption><h2>{title}</h2><p>{text}</p></figcaption></figure>"
        for key, (title, text) in CAPTIONS.items()
        if key in pictures
    ]
    text = f"All six of each tet, median {dihedral['median']:.0f}°. Red line: the smallest."
    figures.append(
        f"<figure>{histogram(dihedral)}<figcaption><h2>Dihedral angles</h2><p>{text}</p></figcaption></figure>"
    )
    notes = "".join(f'<div class="note">{html.escape(line)}</div>' for line in numbers["notes"])
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width"><meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">"
        f"<title>{html.escape(name)}</title><style>{STYLE}</style></head><body><main>"
        f"<h1>{html.escape(name)}</h1><p>made from {html.escape(str(source))}; "
        f"largest extent {length(numbers['largest_extent'])}; mesher {html.escape(cage['mesher'])}</p>{notes}"
        f'<div class="facts">{"".join(f"<div class=fact><b>{v}</b><span>{t}</span></div>" for v, t in facts)}</div>'
        f'<div class="grid">{"".join(figures)}</div>{distance_table(numbers)}</main></body></html>\n'
    )


def distance_table(numbers: dict) -> str:
    """HTML table of the distances both ways, also relative to the largest extent."""
    rows = []
    for key, title in (("gaussians_to_cage", "Gaussians to the cage"), ("cage_to_gaussians", "cage to the Gaussians")):
        values = numbers["distance"][key]
        cells = "".join(
            f"<td>{length(values[k])} ({values[k] / numbers['largest_extent']:.2%})</td>"
            for k in ("mean", "p95", "max")
        )
        rows.append(f"<tr><td>{title}</td>{cells}</tr>")
    head = "<tr><th>Distance (of the largest extent)</th><th>mean</th><th>95 %</th><th>largest</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def length(metres: float) -> str:
    """A length in a unit that suits it: m, cm or mm."""
    return (
        f"{metres:.3g} m" if metres >= 1 else f"{100 * metres:.3g} cm" if metres >= 0.01 else f"{1e3 * metres:.3g} mm"
    )


def histogram(dihedral: dict) -> str:
    """SVG histogram of the dihedral angles, as large as a picture."""
    counts, width, height = dihedral["histogram"], 560, 480
    left, right, top, bottom = 34, 18, 30, 52
    wide, high = (width - left - right) / len(counts), height - top - bottom
    bars = [
        f'<rect x="{left + i * wide + 1:.1f}" y="{top + high * (1 - math.sqrt(c / max(counts))):.1f}" '
        f'width="{wide - 2:.1f}" height="{high * math.sqrt(c / max(counts)):.1f}" fill="#5d93a0"/>'
        for i, c in enumerate(counts)
        if c
    ]
    ticks = [
        f'<text x="{left + d / 180 * (width - left - right):.1f}" y="{height - bottom + 22}" text-anchor="middle">{d}°'
        "</text>"
        for d in range(0, 181, 30)
    ]
    at = left + dihedral["min"] / 180 * (width - left - right)
    return (
        f'<svg viewBox="0 0 {width} {height}" font-family="system-ui,sans-serif" font-size="14" fill="#78746f">'
        f'<rect width="{width}" height="{height}" fill="#faf9f7"/>{"".join(bars)}{"".join(ticks)}'
        f'<line x1="{left}" x2="{width - right}" y1="{height - bottom}" y2="{height - bottom}" stroke="#c8c4be"/>'
        f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{top}" y2="{height - bottom}" stroke="#c82828" stroke-width="2"/>'
        f'<text x="{at + 6:.1f}" y="{top + 10}" fill="#c82828">{dihedral["min"]:.1f}°</text>'
        f'<text x="{width - right}" y="{height - 8}" text-anchor="end">height: square root of the count</text></svg>'
    )
