"""Reports: one self-contained HTML page of sections with text, tables, pictures and charts, which loads nothing."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import cv2
import numpy as np

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #faf9f6; max-width: 1160px; margin: 2em auto;
       padding: 0 1.5em; }
h1 { font-size: 1.7em; } h2 { margin-top: 2.2em; border-bottom: 1px solid #ccc8bd; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px; margin: 1.4em 0; }
.facts div { background: #fff; border-radius: 8px; padding: 12px 16px; } .facts b { display: block; font-size: 1.3em; }
.facts span { color: #78746f; font-size: .85em; }
figure { display: inline-block; width: min-content; margin: 0 10px 12px 0; vertical-align: top; }
figure img, figure svg { display: block; max-width: min(1160px, 92vw); height: auto; border-radius: 4px; }
figcaption { font-size: .85em; color: #555; }
svg text { font: 12px system-ui, sans-serif; fill: #666; }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25em .9em .25em 0; text-align: right; white-space: nowrap; border-bottom: 1px solid #e4e0d6; }
th:first-child, td:first-child { text-align: left; }
.note { color: #555; font-size: .9em; max-width: 60em; }
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


@dataclass(frozen=True)
class Table:
    """Column titles, and rows of numbers and texts, formatted."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


class Chart:
    """A drawing on two linear axes from zero, in the units of the data.

    right, top  values at the right end of the x axis and at the top of the y axis
    x_ticks     (value, label) along the x axis
    size        (width, height) [px]
    """

    LEFT, RIGHT, TOP, BOTTOM = 44, 14, 14, 28  # margins [px]

    def __init__(
        self,
        right: float,
        top: float,
        *,
        x_ticks: Sequence[tuple[float, str]] = (),
        size: tuple[int, int] = (300, 190),
    ):
        self._right, self._top, self._size, self._parts = right or 1.0, top or 1.0, size, []
        self.line([(0, 0), (right, 0)], "#999")
        for value, label in x_ticks:
            self._text(self._x(value), size[1] - 8, label, "middle")

    def _x(self, value: float) -> float:
        return self.LEFT + (self._size[0] - self.LEFT - self.RIGHT) * value / self._right

    def _y(self, value: float) -> float:
        return self._size[1] - self.BOTTOM - (self._size[1] - self.TOP - self.BOTTOM) * value / self._top

    def _text(self, x: float, y: float, text: str, anchor: str) -> None:
        self._parts.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>')

    def line(self, points: Sequence[tuple[float, float]], colour: str, *, width: float = 1.0) -> None:
        """Draw a line through the points (x, y)."""
        path = " ".join(f"{self._x(x):.1f},{self._y(y):.1f}" for x, y in points)
        self._parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"/>')

    def bar(self, start: float, end: float, height: float, colour: str) -> None:
        """Draw a bar from `start` to `end` along x, as high as `height` along y."""
        x, y, width, below = self._x(start) + 1, self._y(height), self._x(end) - self._x(start) - 2, self._y(0)
        size = f'width="{width:.1f}" height="{below - y:.1f}"'
        self._parts.append(f'<rect x="{x:.1f}" y="{y:.1f}" {size} fill="{colour}"/>')

    def label(self, x: float, y: float, text: str) -> None:
        """Write a text that begins at a point."""
        self._text(self._x(x), self._y(y), text, "start")

    def svg(self) -> str:
        """The drawing as an SVG element."""
        width, height = self._size
        return f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}">{"".join(self._parts)}</svg>'


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading, in this order: text, facts, pictures and charts by caption, items of a
    list, a table, and a note.

    facts     (value, label) each, shown large
    pictures  (H, W, 3) uint8, or a Chart
    """

    title: str
    text: str = ""
    pictures: dict[str, np.ndarray | Chart] = field(default_factory=dict)
    table: Table | None = None
    note: str = ""
    items: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()


def html_page(title: str, text: str, sections: Sequence[Section]) -> str:
    """The page as HTML text; every text is escaped here."""
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>",
        f"<body><h1>{escape(title)}</h1><p>{escape(text)}</p>",
    ]
    for section in sections:
        parts.append(f"<section><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>")
        facts = "".join(f"<div><b>{escape(v)}</b><span>{escape(label)}</span></div>" for v, label in section.facts)
        parts += [f'<div class="facts">{facts}</div>'] if facts else []
        parts += [_figure(caption, picture) for caption, picture in section.pictures.items()]
        parts += [f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in section.items)}</ul>"] if section.items else []
        parts += [_table(section.table)] if section.table else []
        parts += [f'<p class="note">{escape(section.note)}</p>'] if section.note else []
        parts.append("</section>")
    return "\n".join([*parts, "</body></html>", ""])


def _figure(caption: str, picture: np.ndarray | Chart) -> str:
    if isinstance(picture, Chart):
        image = picture.svg()
    else:
        data = base64.b64encode(png_of(picture)).decode("ascii")
        height, width = picture.shape[:2]
        image = f'<img src="data:image/png;base64,{data}" width="{width}" height="{height}" alt="{escape(caption)}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def png_of(picture: np.ndarray) -> bytes:
    """PNG file of a picture (H, W, 3) uint8, RGB."""
    return cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(c)}</th>" for c in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{escape(v)}</td>" for v in row) + "</tr>" for row in table.rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
