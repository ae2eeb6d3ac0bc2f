"""A page of figures as one self-contained HTML file: text, tables and pictures, which are embedded."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from html import escape

import cv2
import numpy as np

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #faf9f6; max-width: 1160px; margin: 2em auto;
       padding: 0 1.5em; }
h1 { font-size: 1.7em; } h2 { margin-top: 2.2em; border-bottom: 1px solid #ccc8bd; }
figure { display: inline-block; margin: 0 10px 12px 0; vertical-align: top; }
figure img { display: block; max-width: 100%; border-radius: 4px; }
figcaption { font-size: .85em; color: #555; }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25em .9em .25em 0; text-align: right; white-space: nowrap; border-bottom: 1px solid #e4e0d6; }
th:first-child, td:first-child { text-align: left; }
.note { color: #555; font-size: .9em; max-width: 60em; }
"""


@dataclass(frozen=True)
class Table:
    """Column titles, and rows of numbers and texts, formatted."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Section:
    """A figure: its title, what it shows, pictures (H, W, 3) uint8 by caption, a list, a table, and a note on its
    numbers."""

    title: str
    text: str
    pictures: dict[str, np.ndarray] = field(default_factory=dict)
    table: Table | None = None
    note: str = ""
    items: tuple[str, ...] = ()


def html_page(title: str, text: str, sections: list[Section]) -> str:
    """The page as HTML text."""
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style>",
        f"<h1>{escape(title)}</h1><p>{escape(text)}</p>",
    ]
    for section in sections:
        parts.append(f"<section><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>")
        parts += [_figure(caption, picture) for caption, picture in section.pictures.items()]
        parts += [f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in section.items)}</ul>"] if section.items else []
        parts += [_table(section.table)] if section.table else []
        parts += [f'<p class="note">{escape(section.note)}</p>'] if section.note else []
        parts.append("</section>")
    return "\n".join([*parts, "</html>", ""])


def _figure(caption: str, picture: np.ndarray) -> str:
    png = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
    data, (height, width) = base64.b64encode(png).decode("ascii"), picture.shape[:2]
    image = f'<img src="data:image/png;base64,{data}" width="{width}" height="{height}" alt="{escape(caption)}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(c)}</th>" for c in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{escape(v)}</td>" for v in row) + "</tr>" for row in table.rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
