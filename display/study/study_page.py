"""The comparison as one HTML page with tables and plots, which needs no other file."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from display.study.comparison import Comparison
from display.study.study_file import Study
from display.study.trial import SETTINGS, Trial

COLOURS = {"physics": "#c2571a", "transform": "#2a6f97"}
WIDTH, HEIGHT = 300, 190  # [px] of a plot
LEFT, RIGHT, TOP, BOTTOM = 44, 14, 12, 26  # [px] of its margins
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:.6rem 0 1rem;font-size:.92rem}
td,th{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #e5e5e5}
td:first-child,th:first-child,td:last-child,th:last-child{text-align:left}
figure{display:inline-block;margin:0 1rem 1rem 0}figcaption{font-size:.85rem;color:#555}
svg text{font:11px system-ui,sans-serif;fill:#555}
"""


def page(study: Study, rows: Sequence[Comparison], overview: str) -> str:
    """The page of a study and its comparisons."""
    parts = [f"<h1>Physics and transform</h1><p>{html.escape(overview)}</p>"]
    for task, group in groupby(rows, lambda c: c.task):
        compared = list(group)
        trials = [t for t in study.trials if t.task == task and t.setting in SETTINGS]
        plots = "".join(figure(c.measure, dots(c)) for c in compared)
        if trials:
            plots += figure("score over time [s], each trial", score_lines(trials))
        parts.append(f"<h2>{html.escape(task)}</h2>{html_table(compared)}{plots}")
    comments = "".join(
        f"<li>{html.escape(a.participant)}, {a.setting}: {html.escape(a.comment)}</li>"
        for a in study.answers
        if a.comment
    )
    notes = f"<h2>Comments</h2><ul>{comments}</ul>" if comments else ""
    how = (
        "Each participant counts once in each setting, with the mean of the trials there; those without a name are one"
        " participant a trial. Bars: mean and standard deviation. Grey lines: the same participant in both."
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>VR-GS: study</title>'
        f"<style>{STYLE}</style></head><body>{''.join(parts)}{notes}<p>{how}</p></body></html>\n"
    )


def figure(title: str, picture: str) -> str:
    """A plot with its title."""
    return f"<figure><figcaption>{html.escape(title)}</figcaption>{picture}</figure>"


def html_table(rows: Sequence[Comparison]) -> str:
    """Means, standard deviations, samples and tests."""
    head = "".join(f"<th>{s}: mean ± sd (n)</th>" for s in SETTINGS)
    lines = [f"<tr><th>measure</th>{head}<th>difference</th><th>test</th></tr>"]
    for c in rows:
        cells = "".join(f"<td>{digits(c.mean(s))} ± {digits(c.spread(s))} ({len(c.samples[s])})</td>" for s in SETTINGS)
        measure, test = html.escape(c.measure), html.escape(c.test_text)
        lines.append(f"<tr><td>{measure}</td>{cells}<td>{digits(c.difference)}</td><td>{test}</td></tr>")
    return f"<table>{''.join(lines)}</table>"


def digits(value: float) -> str:
    """Three digits, or a dash."""
    return "–" if math.isnan(value) else f"{value:.3g}"


class Axes:
    """Axes of a plot: places [px] of values."""

    def __init__(self, right: float, top: float, ticks: Sequence[tuple[float, str]]):
        self._right, self._top = right or 1.0, top or 1.0
        self.parts = [f'<line x1="{LEFT}" y1="{self.y(0)}" x2="{WIDTH - RIGHT}" y2="{self.y(0)}" stroke="#999"/>']
        for value in (0.0, 0.5 * self._top, self._top):
            self.parts.append(f'<text x="{LEFT - 6}" y="{self.y(value) + 4:.1f}" text-anchor="end">{value:.3g}</text>')
        for value, text in ticks:
            place = f'x="{self.x(value):.1f}" y="{HEIGHT - 8}" text-anchor="middle"'
            self.parts.append(f"<text {place}>{html.escape(text)}</text>")

    def x(self, value: float) -> float:
        """Place from the left."""
        return LEFT + (WIDTH - LEFT - RIGHT) * value / self._right

    def y(self, value: float) -> float:
        """Place from the top."""
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * value / self._top

    def svg(self) -> str:
        """The plot."""
        return f'<svg width="{WIDTH}" height="{HEIGHT}" role="img">{"".join(self.parts)}</svg>'


def dots(c: Comparison) -> str:
    """A dot for each participant in both settings, lines between those of the same one, and means with spread."""
    values = np.concatenate([*c.samples.values(), [0.0]])
    axes = Axes(4.0, float(values.max()), [(1.0, SETTINGS[0]), (3.0, SETTINGS[1])])
    for a, b in c.pairs:
        ends = f'x1="{axes.x(1):.1f}" y1="{axes.y(a):.1f}" x2="{axes.x(3):.1f}" y2="{axes.y(b):.1f}"'
        axes.parts.append(f'<line {ends} stroke="#bbb"/>')
    for k, setting in enumerate(SETTINGS):
        at, colour = axes.x(1 + 2 * k), COLOURS[setting]
        for value in c.samples[setting]:
            axes.parts.append(f'<circle cx="{at:.1f}" cy="{axes.y(value):.1f}" r="3.5" fill="{colour}" opacity=".6"/>')
        mean, spread = c.mean(setting), c.spread(setting)
        if not math.isnan(mean):
            bar = at + (18 if k else -18)
            axes.parts.append(f'<circle cx="{bar:.1f}" cy="{axes.y(mean):.1f}" r="5" fill="{colour}"/>')
            if not math.isnan(spread):
                low, high = axes.y(max(mean - spread, 0.0)), axes.y(mean + spread)
                ends = f'x1="{bar:.1f}" y1="{low:.1f}" x2="{bar:.1f}" y2="{max(high, 0.0):.1f}"'
                axes.parts.append(f'<line {ends} stroke="{colour}" stroke-width="2"/>')
    return axes.svg()


def score_lines(trials: Sequence[Trial]) -> str:
    """The score of each trial as a line of steps, in its setting's colour."""
    ends = [max(t.seconds, float(t.scores[-1, 0]) if len(t.scores) else 0.0) for t in trials]
    last = max(ends)
    highest = max((float(t.scores[:, 1].max()) for t in trials if len(t.scores)), default=0.0)
    axes = Axes(last, highest, [(0.0, "0"), (last, f"{last:.3g}")])
    for t, end in zip(trials, ends, strict=True):
        points, level = [], 0.0
        for time, score in [*t.scores, (end, t.score)]:
            points += [(time, level), (time, score)]
            level = score
        line = " ".join(f"{axes.x(time):.1f},{axes.y(max(score, 0.0)):.1f}" for time, score in points)
        axes.parts.append(f'<polyline points="{line}" fill="none" stroke="{COLOURS[t.setting]}" opacity=".7"/>')
    return axes.svg()
