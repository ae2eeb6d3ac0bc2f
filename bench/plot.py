"""Curves on two logarithmic axes as SVG, without a plotting package.

Text and lines have medium brightness on a transparent background, readable on white and on black.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.sax.saxutils import escape

INK = "#757d87"
COLORS = ("#3b82f6", "#e07b1a", "#1f9d55", "#a855f7", "#d6456b", "#0f9bb0")
WIDTH, HEIGHT = 400, 320  # [px] of a panel
MARGIN_LEFT, MARGIN_RIGHT, MARGIN_TOP, MARGIN_BOTTOM = 58, 22, 34, 46  # [px] around its axes
LEGEND = 26  # [px] under all panels
LETTER = 6.5  # [px] of width, about, at 12 px


@dataclass(frozen=True)
class Panel:
    """One pair of axes. `curves`: name to points (x, y), all above zero; `ticks`: where x is labelled."""

    title: str
    x_label: str
    y_label: str
    curves: dict[str, list[tuple[float, float]]]
    ticks: tuple[float, ...]


def svg(panels: list[Panel]) -> str:
    """SVG text: panels side by side with a common y scale; a curve has the same colour in all of them."""
    names = list(dict.fromkeys(name for p in panels for name in p.curves))
    ys = [y for p in panels for curve in p.curves.values() for _, y in curve]
    low, high = math.floor(math.log10(min(ys))), math.ceil(math.log10(max(ys)))
    high = max(high, low + 1)
    width, height = WIDTH * len(panels), HEIGHT + LEGEND
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, sans-serif" font-size="12">'
    ]
    for k, panel in enumerate(panels):
        lines += [f'<g transform="translate({k * WIDTH} 0)">', *_panel(panel, names, low, high), "</g>"]
    lines += _legend(names, width)
    return "\n".join([*lines, "</svg>", ""])


def _panel(panel: Panel, names: list[str], low: int, high: int) -> list[str]:
    """Axes and curves; y from 10^low to 10^high."""
    first, last = math.log10(panel.ticks[0]), math.log10(panel.ticks[-1])
    right, bottom = WIDTH - MARGIN_RIGHT, HEIGHT - MARGIN_BOTTOM

    def at(x: float, y: float) -> tuple[float, float]:
        across = (math.log10(x) - first) / max(last - first, 1e-9)
        up = (math.log10(y) - low) / (high - low)
        return MARGIN_LEFT + across * (right - MARGIN_LEFT), bottom - up * (bottom - MARGIN_TOP)

    lines = [_text(0.5 * (MARGIN_LEFT + right), 18, panel.title, "middle", weight="600")]
    for decade in range(low, high + 1):
        y = at(panel.ticks[0], 10.0**decade)[1]
        lines += [_line(MARGIN_LEFT, y, right, y), _text(MARGIN_LEFT - 8, y + 4, f"{10.0**decade:,g}", "end")]
        for digit in (2, 5) if decade < high else ():
            y = at(panel.ticks[0], digit * 10.0**decade)[1]
            lines.append(_line(MARGIN_LEFT, y, right, y, faint=True))
    for tick in panel.ticks:
        x = at(tick, 10.0**low)[0]
        lines += [_line(x, MARGIN_TOP, x, bottom, faint=True), _text(x, bottom + 18, f"{tick:g}", "middle")]
    lines.append(_text(0.5 * (MARGIN_LEFT + right), bottom + 36, panel.x_label, "middle"))
    turned = f' transform="rotate(-90 14 {0.5 * (MARGIN_TOP + bottom):g})"'
    lines.append(_text(14, 0.5 * (MARGIN_TOP + bottom) + 4, panel.y_label, "middle", turned))
    for name, curve in panel.curves.items():
        color = COLORS[names.index(name) % len(COLORS)]
        points = [at(x, y) for x, y in sorted(curve)]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        lines.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        lines += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{color}"/>' for x, y in points]
    return lines


def _legend(names: list[str], width: int) -> list[str]:
    """A dot and a name for each curve, centred in the last row."""
    widths = [28 + LETTER * len(name) for name in names]
    x, y, lines = 0.5 * (width - sum(widths)), HEIGHT + 8, []
    for k, name in enumerate(names):
        lines.append(f'<circle cx="{x + 6:.1f}" cy="{y - 4}" r="4" fill="{COLORS[k % len(COLORS)]}"/>')
        lines.append(_text(x + 15, y, name, "start"))
        x += widths[k]
    return lines


def _line(x0: float, y0: float, x1: float, y1: float, *, faint: bool = False) -> str:
    opacity = 0.18 if faint else 0.45
    return f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="{INK}" stroke-opacity="{opacity}"/>'


def _text(x: float, y: float, text: str, anchor: str, more: str = "", *, weight: str = "400") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{INK}" font-weight="{weight}"'
    return f"<text {place}{more}>{escape(text)}</text>"
