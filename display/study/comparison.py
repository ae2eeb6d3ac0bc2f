"""Comparison of the settings, task by task and over the answers: numbers, and a test with its sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from display.study.questionnaire import QUESTIONS
from display.study.study_file import Study
from display.study.trial import SETTINGS, Trial

MEASURES: dict[str, Callable[[Trial], float]] = {
    "time on task [s]": lambda t: t.seconds,
    "score": lambda t: t.score,
    "precision (score a grip)": lambda t: t.precision,
    "grips": lambda t: t.grips,
    "throws": lambda t: t.throws,
    "hands moved [m]": lambda t: t.hand_path,
    "bodies moved [m]": lambda t: t.body_path,
}
PAIRED, UNPAIRED = "Wilcoxon signed-rank", "Mann-Whitney U"
MIN_SAMPLE = 2  # of each group for a test


@dataclass(frozen=True)
class Comparison:
    """A measure in both settings. A participant counts once in each, with the mean of all trials there.

    samples  of each setting: the participants' means, (n,)
    pairs    rows of participants who did both, in the order of SETTINGS, (m, 2)
    test     "Wilcoxon signed-rank" over the pairs, or "Mann-Whitney U" over the samples if there are fewer than two
             pairs; "" if there are too few for either
    n        sizes of the test's samples: (pairs,) or (first, second)
    p        two-sided; NaN without a test
    """

    task: str
    measure: str
    samples: dict[str, np.ndarray]
    pairs: np.ndarray
    test: str
    n: tuple[int, ...]
    p: float

    def mean(self, setting: str) -> float:
        """Mean over participants; NaN without one."""
        values = self.samples[setting]
        return float(values.mean()) if len(values) else math.nan

    def spread(self, setting: str) -> float:
        """Standard deviation over participants, n - 1 in the denominator; NaN with fewer than two."""
        values = self.samples[setting]
        return float(values.std(ddof=1)) if len(values) > 1 else math.nan

    @property
    def difference(self) -> float:
        """Mean of the second setting less the first: within the pairs if they are tested, else of all."""
        if self.test == PAIRED:
            return float((self.pairs[:, 1] - self.pairs[:, 0]).mean())
        return self.mean(SETTINGS[1]) - self.mean(SETTINGS[0])

    @property
    def test_text(self) -> str:
        """The test, its sample and its result."""
        if not self.test:
            return "too few to test"
        sample = f"{self.n[0]} pairs" if self.test == PAIRED else f"n = {self.n[0]} and {self.n[1]}"
        return f"p = {self.p:.3f} ({self.test}, {sample})"

    def row(self) -> dict:
        """Plain numbers for JSON."""
        each = {
            s: {
                "n": len(self.samples[s]),
                "mean": self.mean(s),
                "sd": self.spread(s),
                "values": self.samples[s].tolist(),
            }
            for s in SETTINGS
        }
        test = {"test": self.test, "n": list(self.n), "p": self.p, "difference": self.difference}
        return {"task": self.task, "measure": self.measure, **each, "pairs": self.pairs.tolist(), **test}


def compare(task: str, measure: str, given: Iterable[tuple[str, str, float]]) -> Comparison:
    """Compare values given as (participant, setting, value). Those without a participant are each one of their own.

    Values that are NaN are left out.
    """
    sums: dict[str, dict[object, list[float]]] = {s: {} for s in SETTINGS}
    for k, (participant, setting, value) in enumerate(given):
        if setting in sums and not math.isnan(value):
            sums[setting].setdefault(participant or k, []).append(value)
    means = {s: {who: float(np.mean(values)) for who, values in sums[s].items()} for s in SETTINGS}
    first, second = (means[s] for s in SETTINGS)
    pairs = np.array([(first[who], second[who]) for who in first if who in second]).reshape(-1, 2)
    samples = {s: np.array(list(means[s].values())) for s in SETTINGS}
    test, n, p = test_of(samples, pairs)
    return Comparison(task, measure, samples, pairs, test, n, p)


def test_of(samples: dict[str, np.ndarray], pairs: np.ndarray) -> tuple[str, tuple[int, ...], float]:
    """The test, its sample and its two-sided p. Both are of ranks: times are skewed, and answers are ordinal."""
    if len(pairs) >= MIN_SAMPLE:
        apart = (pairs[:, 1] - pairs[:, 0]).any()  # all equal: nothing speaks for a difference
        return PAIRED, (len(pairs),), float(stats.wilcoxon(pairs[:, 1], pairs[:, 0]).pvalue) if apart else 1.0
    first, second = (samples[s] for s in SETTINGS)
    if min(len(first), len(second)) < MIN_SAMPLE:
        return "", (), math.nan
    p = float(stats.mannwhitneyu(first, second).pvalue)
    return UNPAIRED, (len(first), len(second)), p


def compare_trials(study: Study) -> list[Comparison]:
    """All measures of each task that was done in a setting; mixed trials are left out."""
    tasks = dict.fromkeys(t.task for t in study.trials if t.setting in SETTINGS)
    return [
        compare(task, title, ((t.participant, t.setting, float(value(t))) for t in study.trials if t.task == task))
        for task in tasks
        for title, value in MEASURES.items()
    ]


def compare_answers(study: Study) -> list[Comparison]:
    """Each question."""
    if not study.answers:
        return []
    return [
        compare("questionnaire", title, ((a.participant, a.setting, a.values[k] or math.nan) for a in study.answers))
        for k, (title, _) in enumerate(QUESTIONS.values())
    ]
