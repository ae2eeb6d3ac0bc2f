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
figure img, figure svg, figure video { display: block; max-width: min(1160px, 92vw); height: auto; border-radius: 4px; }
figcaption { font-size: .85em; color: #555; }
svg text { font: 12px system-ui, sans-serif; fill: #666; }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25em .9em .25em 0; text-align: right; white-space: nowrap; border-bottom: 1px solid #e4e0d6; }
th:first-child, td:first-child { text-align: left; }
.note { color: #555; font-size: .9em; max-width: 60em; }
"""
POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"


@dataclass(frozen=True)
class Table:
    """Column titles, and rows of numbers and texts, formatted."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading, in this order: text, facts, pictures by caption, items of a list, a
    table, and a note.

    facts     (value, label) each, shown large
    pictures  (H, W, 3) uint8, or the text of an SVG drawing or of a film's element, which is not escaped
    """

    title: str
    text: str = ""
    pictures: dict[str, np.ndarray | str] = field(default_factory=dict)
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


def _figure(caption: str, picture: np.ndarray | str) -> str:
    image = picture
    if not isinstance(picture, str):
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
