"""Comparison of the settings, task by task and over the answers: means and standard deviations over participants."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write
from display.study.questionnaire import QUESTIONS
from display.study.study_file import Study
from display.study.trial import MIXED, SETTINGS, Trial

MEASURES: dict[str, Callable[[Trial], float]] = {
    "time on task [s]": lambda t: t.seconds,
    "score": lambda t: t.score,
    "precision (score a grip)": lambda t: t.precision,
    "grips": lambda t: t.grips,
    "throws": lambda t: t.throws,
    "hands moved [m]": lambda t: t.hand_path,
    "bodies moved [m]": lambda t: t.body_path,
}


@dataclass(frozen=True)
class Comparison:
    """A measure in both settings. A participant counts once in each, with the mean of all trials there.

    means  of each setting: the participants' means, by their names; one without a name is a number
    """

    task: str
    measure: str
    means: dict[str, dict[str | int, float]]

    def mean(self, setting: str) -> float:
        """Mean over participants; NaN without one."""
        values = list(self.means[setting].values())
        return float(np.mean(values)) if values else math.nan

    def spread(self, setting: str) -> float:
        """Standard deviation over participants, n - 1 in the denominator; NaN with fewer than two."""
        values = list(self.means[setting].values())
        return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan

    @property
    def pairs(self) -> np.ndarray:
        """Means of the participants who did both, in the order of SETTINGS, (m, 2)."""
        first, second = (self.means[s] for s in SETTINGS)
        return np.array([(first[who], second[who]) for who in first if who in second]).reshape(-1, 2)

    @property
    def difference(self) -> float:
        """Mean of the second setting less the first: within participants if two or more did both, else of all."""
        pairs = self.pairs
        if len(pairs) > 1:
            return float((pairs[:, 1] - pairs[:, 0]).mean())
        return self.mean(SETTINGS[1]) - self.mean(SETTINGS[0])


def compare(task: str, measure: str, given: Iterable[tuple[str, str, float]]) -> Comparison:
    """Compare values given as (participant, setting, value). Those without a participant are each one of their own.

    Values that are NaN are left out.
    """
    values: dict[str, dict[str | int, list[float]]] = {s: {} for s in SETTINGS}
    for k, (participant, setting, value) in enumerate(given):
        if setting in values and not math.isnan(value):
            values[setting].setdefault(participant or k, []).append(value)
    means = {s: {who: float(np.mean(each)) for who, each in values[s].items()} for s in SETTINGS}
    return Comparison(task, measure, means)


def compare_study(study: Study) -> list[Comparison]:
    """All measures of each task that was done in a setting, then each question; mixed trials are left out."""
    tasks = dict.fromkeys(t.task for t in study.trials if t.setting in SETTINGS)
    of_trials = [
        compare(task, title, ((t.participant, t.setting, float(value(t))) for t in study.trials if t.task == task))
        for task in tasks
        for title, value in MEASURES.items()
    ]
    return of_trials + [
        compare("questionnaire", title, ((a.participant, a.setting, a.values[k] or math.nan) for a in study.answers))
        for k, (title, _) in enumerate(QUESTIONS.values())
        if study.answers
    ]


def overview(study: Study) -> str:
    """Line that counts trials and answered questionnaires."""
    people = {t.participant for t in study.trials} | {a.participant for a in study.answers}
    mixed = sum(t.setting == MIXED for t in study.trials)
    left_out = f" ({mixed} with grips in both settings, left out)" if mixed else ""
    return (
        f"trials: {len(study.trials)}{left_out}; answered questionnaires: {len(study.answers)};"
        f" named participants: {len(people - {''})}"
    )


def table(rows: Iterable[Comparison]) -> Iterator[str]:
    """Lines of text: a block for each task."""
    task = None
    for c in rows:
        if c.task != task:
            task = c.task
            yield ""
            yield f"{task:26}" + "".join(f"{s + ' (n)':>26}" for s in SETTINGS) + f"{'difference':>12}"
        cells = (f"{digits(c.mean(s))} ± {digits(c.spread(s))} ({len(c.means[s])})" for s in SETTINGS)
        yield f"{c.measure:26}" + "".join(f"{cell:>26}" for cell in cells) + f"{digits(c.difference):>12}"


def digits(value: float) -> str:
    """Three digits, or a dash."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def write_csv(path: Path, rows: Sequence[Comparison]) -> None:
    """Write the participants' means, one a line, for a program of statistics. Raises BadInput."""
    with atomic_write(path) as beside, open(beside, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(("task", "measure", "setting", "participant", "mean"))
        for c in rows:
            out.writerows((c.task, c.measure, s, who, mean) for s in SETTINGS for who, mean in c.means[s].items())
