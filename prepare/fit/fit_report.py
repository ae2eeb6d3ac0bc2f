"""Report of a fit: lines for the terminal, and a page with numbers, intervals and curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from core.report import Section, Table, html_page
from prepare.fit.clip_tracks import Shot, moments
from prepare.fit.marker_tracks import MarkerTracks
from prepare.fit.material_fit import MaterialFit, Number

UNSEEN = "not visible in this clip"
WIDTH, HEIGHT, LEFT, FLOOR = 560.0, 240.0, 64.0, 206.0  # [px] of a drawing, and where its axes meet
COLOURS = ("#222", "#c4562f", "#5d93a0", "#a9b86a")
MARKERS_DRAWN = 3
SHOWN = 6  # pictures of a clip
OUTLINE, DOT = (230, 60, 40), (40, 200, 60)


def said(number: Number) -> str:
    """The number with its interval, or that it is not visible."""
    if not number.seen:
        return UNSEEN
    return f"{number.value:.3g} ({number.low:.3g} to {number.high:.3g}) {number.unit}".rstrip()


def lines_of(found: MaterialFit) -> list[str]:
    """Lines for the terminal."""
    lines = [f"{n.name:16} {said(n)}" for n in found.numbers]
    lines.append(
        f"{'left over':16} {1e3 * found.error:.2g} mm of {1e3 * found.moved:.2g} mm; noise {1e3 * found.noise:.2g} mm"
    )
    if not found.mass_known:
        lines.append(
            f"motion shows only young / density: young is that at {found.material.density:.3g} kg/m^3 (--density)"
        )
    return lines


def page_of(found: MaterialFit | None, tracks: MarkerTracks, name: str, more: Sequence[Section] = ()) -> str:
    """The report, HTML, with more sections at its end; where nothing was fitted, of these alone."""
    if found is None:
        return html_page(f"{name} in a clip", "Not fitted yet: look whether it is where the masks are.", more)
    rows = [
        (n.name, *((f"{q:.3g}" for q in (n.value, n.low, n.high)) if n.seen else (UNSEEN, "", "")), n.unit)
        for n in found.numbers
    ]
    travel = np.nan_to_num(np.nanstd(tracks.points, axis=0)).sum(1)
    curves = {}
    for m in np.argsort(-travel)[:MARKERS_DRAWN]:
        axis = int(np.nanstd(tracks.points[:, m], axis=0).argmax())
        when = next(times for times, group in tracks.by_camera() if group[m])
        lines = {"seen": tracks.points[when, m, axis], "fitted": found.modelled[when, m, axis]}
        lines |= {f"young x {factor:g}": made[when, m, axis] for factor, made in found.by_factor.items()}
        curves[f"marker {m}, {'xyz'[axis]} [m] over time [s]"] = plot(tracks.times[when], lines)
    x, y = np.log10(found.scan[:, 0]), np.log10(found.scan[:, 1])
    curves["distance [m] over Young's modulus [Pa], logarithms: the first scan"] = plot(x, {"": y})
    note = (
        ""
        if found.mass_known
        else "Gravity and what stands still do not show mass: young is that at the asset's density."
    )
    sections = [
        Section("Material", table=Table(("", "value", "from", "to (90%)", "unit"), rows), note=note),
        Section(
            "Motion",
            pictures=curves,
            note=f"Left over {1e3 * found.error:.2g} mm; noise of the markers {1e3 * found.noise:.2g} mm."
            + (" In the picture, at the thing's distance." if tracks.camera else ""),
        ),
        *more,
    ]
    return html_page(f"Material of {name}", lines_of(found)[0], sections)


def plot(x: np.ndarray, lines: dict[str, np.ndarray]) -> str:
    """Curves y(x), (n,) each, as an SVG drawing; gaps where they are not finite."""
    every = np.concatenate([y[np.isfinite(y)] for y in lines.values()])
    low, high = float(every.min()), float(every.max())
    across = (WIDTH - LEFT - 10) / max(float(np.ptp(x)), 1e-12)
    up = (FLOOR - 24) / max(high - low, 1e-12)
    parts = [f'<polyline points="{LEFT},18 {LEFT},{FLOOR} {WIDTH - 10},{FLOOR}" fill="none" stroke="#999"/>']
    parts += [
        f'<text x="{LEFT - 6}" y="{FLOOR - up * (y - low):.0f}" text-anchor="end">{y:.3g}</text>' for y in (low, high)
    ]
    parts += [
        f'<text x="{LEFT + across * (q - x[0]):.0f}" y="{FLOOR + 18}" text-anchor="middle">{q:.3g}</text>'
        for q in (x[0], x[-1])
    ]
    for k, (name, y) in enumerate(lines.items()):
        colour, known = COLOURS[k % len(COLOURS)], np.flatnonzero(np.isfinite(y))
        for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
            points = " ".join(f"{LEFT + across * (x[i] - x[0]):.1f},{FLOOR - up * (y[i] - low):.1f}" for i in run)
            parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        parts.append(f'<text x="{LEFT + 10 + 120 * k}" y="12" style="fill:{colour}">{name}</text>')
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">{"".join(parts)}</svg>'


def mask_pictures(shot: Shot, tracks: MarkerTracks, number: int = 0) -> dict[str, np.ndarray]:
    """Some pictures of a clip with the outline of the thing and the markers that are followed, by their names.

    number  of the shot's camera in the tracks
    """
    shown, clip, rows = {}, shot.clip, np.searchsorted(tracks.times, moments(shot.clip))
    for k in np.linspace(0, len(rows) - 1, SHOWN).round().astype(int):
        picture = clip.pictures[k].copy()
        lines, _ = cv2.findContours(shot.masks[k].astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, lines, -1, OUTLINE, 1)
        for place in tracks.points[rows[k]][tracks.seen[rows[k]] & (tracks.camera.of == number)] / tracks.metres:
            cv2.circle(picture, tuple(np.floor(place).astype(int).tolist()), 1, DOT, -1)
        shown[f"{Path(clip.where).name}: frame_{clip.first + k:04d}, {clip.times[k]:.2f} s"] = picture
    return shown
