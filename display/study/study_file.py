"""The file of a study, HDF5 (docs/formats.md, Studies), the log that adds the trials of a play, and the comparison of
the settings.

The file is replaced as a whole by one with more in it, so that it is complete at any moment.
"""

from __future__ import annotations

import csv
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np

from assets.file_access import atomic_write, check_writable, locked
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, runs, write_dataset, write_text
from core.errors import BadInput
from core.typed import Size, from_json, to_json
from display.protocol import Closing, Frame, WorldView
from display.study.trial import MIXED, QUESTIONS, SCALE, SETTINGS, TEXT_MAX, Answers, Trial, TrialMeter
from display.user_commands import PlayDemo, Reset, last_of

FORMAT, VERSION = "vrgs-study", 1
MEASURED, OPTIONAL = ("seconds", "hand_path", "body_path"), ("first_grip", "goal")
INTEGERS = ("completed", "grips", "throws", "frames")
SCORES = ("time", "value")  # columns
NUMBER_MAX = 1e12  # of seconds, metres and scores: what is computed of them stays finite
MIN_SECONDS = 1.0  # a shorter trial without any grip was none
Text = Annotated[str, Size(TEXT_MAX)]
T = TypeVar("T")


@dataclass(frozen=True)
class TrialText:
    """A line of trials/text."""

    participant: Text
    task: Text
    setting: Literal[*SETTINGS, MIXED]
    device: Text
    started: Text
    about: dict[Text, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class AnswersText:
    """A line of answers/text."""

    participant: Text
    setting: Literal[*SETTINGS]
    started: Text
    comment: Text


@dataclass
class Study:
    """Content of the file."""

    trials: list[Trial] = field(default_factory=list)
    answers: list[Answers] = field(default_factory=list)


def read_study(path: str | Path) -> Study:
    """Read and check a file. Raises BadInput."""
    with open_hdf5(Path(path)) as file:
        file.check_format(FORMAT, "a study", VERSION)
        return Study(read_trials(file), read_answers(file))


def read_trials(file: Hdf5Reader) -> list[Trial]:
    """The trials of an open file."""
    texts = json_lines(file, "trials/text", TrialText)
    count = (len(texts),)
    read = {name: file.floats(f"trials/{name}", count, np.float64, within=(0.0, NUMBER_MAX)) for name in MEASURED}
    read |= {name: file.floats(f"trials/{name}", count, np.float64) for name in OPTIONAL}
    read |= {name: file.indices(f"trials/{name}", count, np.int64) for name in INTEGERS}
    read["completed"] = read["completed"] != 0
    sizes = file.indices("trials/scores", count, np.int64)
    columns = (file.floats(f"scores/{c}", (None,), np.float64, within=(-NUMBER_MAX, NUMBER_MAX)) for c in SCORES)
    scores = np.stack(list(columns), axis=1)
    if any((np.abs(read[name]) > NUMBER_MAX).any() for name in OPTIONAL):  # NaN compares false
        raise file.error(f"a number of a trial is beyond {NUMBER_MAX:g}")
    if sizes.sum() != len(scores):
        raise file.error("the scores do not belong to the trials")
    return [
        Trial(**vars(text), **{name: values[k].item() for name, values in read.items()}, scores=scores[run])
        for k, (text, run) in enumerate(zip(texts, runs(sizes), strict=True))
    ]


def read_answers(file: Hdf5Reader) -> list[Answers]:
    """The answers of an open file."""
    texts = json_lines(file, "answers/text", AnswersText)
    values = file.indices("answers/values", (len(texts), len(QUESTIONS)), np.int64, high=SCALE)
    return [Answers(values=tuple(row), **vars(text)) for text, row in zip(texts, values.tolist(), strict=True)]


def json_lines(file: Hdf5Reader, name: str, kind: type[T]) -> list[T]:
    """Values of this type, one a line."""
    lines = file.indices(name, (None,), np.uint8).tobytes().splitlines()
    return [from_json(kind, line, f"{file.path}: {name}, line {k}") for k, line in enumerate(lines, 1)]


def write_study(path: str | Path, study: Study) -> None:
    """Write the file, whole or not at all, and onto the disk. Raises BadInput."""
    trials, answers = study.trials, study.answers
    about = [TrialText(t.participant, t.task, t.setting, t.device, t.started, t.about) for t in trials]
    said = [AnswersText(a.participant, a.setting, a.started, a.comment) for a in answers]
    scores = np.concatenate([np.zeros((0, 2)), *(t.scores for t in trials)])
    with atomic_write(path) as beside:
        with new_hdf5(beside) as file:
            write_text(file, "format", FORMAT)
            file.attrs["version"] = VERSION
            for names, kind in ((MEASURED + OPTIONAL, np.float64), (INTEGERS, np.int64)):
                for name in names:
                    write_dataset(file, f"trials/{name}", [getattr(t, name) for t in trials], kind)
            write_dataset(file, "trials/scores", [len(t.scores) for t in trials], np.int64)
            for name, lines in (("trials/text", about), ("answers/text", said)):
                text = "".join(f"{to_json(line)}\n" for line in lines)
                write_dataset(file, name, np.frombuffer(text.encode(), np.uint8), np.uint8)
            for name, column in zip(SCORES, scores.T, strict=True):
                write_dataset(file, f"scores/{name}", column, np.float64)
            rows = np.array([a.values for a in answers], np.int64).reshape(-1, len(QUESTIONS))
            write_dataset(file, "answers/values", rows, np.int64)
        with open(beside, "rb") as file:
            os.fsync(file.fileno())


def add_to_study(path: str | Path, change: Callable[[Study], None]) -> Study:
    """Read the file if there is one, change what it holds, and write it; other programs wait. Raises BadInput."""
    path = Path(path)
    with locked(path):
        study = read_study(path) if path.exists() else Study()
        change(study)
        write_study(path, study)
    return study


class StudyLog(Closing):
    """`after` each frame, `close` at the end: each trial is written once it ends.

    A trial begins with the play and with each reset. It ends when the score has reached the game's goal, and otherwise
    with the next reset, a demonstration, or the play. Raises BadInput at once if `path` cannot be written; if that
    happens later, a line says so and the play goes on.
    """

    def __init__(self, path: str | Path, *, participant: str, task: str, device: str, about: dict):
        self.path = Path(path)
        check_writable(self.path)
        if self.path.exists():
            read_study(self.path)
        self._new = {"participant": participant, "task": task, "device": device, "about": about}
        self._meter: TrialMeter | None = None
        self._writer, self._begun = ThreadPoolExecutor(1), False

    def after(self, frame: Frame, world: WorldView) -> None:
        """Take account of a frame, after the world's step."""
        demo = last_of(PlayDemo, frame.commands)
        restarts = last_of(Reset, frame.commands) is not None
        if restarts or demo is not None:
            self._end()
        if restarts or not self._begun:
            goal = getattr(world.scene.game, "goal", None)
            self._meter, self._begun = TrialMeter(Trial(**self._new), goal), True
        if world.demo:  # the scripted hand is no participant
            self._meter = None
        if self._meter is not None:
            self._meter.after(frame, world)
            if self._meter.over:
                self._end()

    def _end(self) -> None:
        """Write the trial, if there is one: in a thread, since it takes longer than a frame."""
        meter, self._meter = self._meter, None
        trial = None if meter is None else meter.trial()
        if trial is not None and (trial.grips or trial.seconds >= MIN_SECONDS):
            self._writer.submit(self._write, trial)

    def _write(self, trial: Trial) -> None:
        try:
            study = add_to_study(self.path, lambda study: study.trials.append(trial))
        except BadInput as e:
            print(f"vrgs: a trial is lost: {e}", file=sys.stderr)
            return
        who = f"{trial.participant}, " if trial.participant else ""
        goal = " (goal reached)" if trial.completed else ""
        result = f"score {trial.score:g}{goal} in {trial.seconds:.1f} s, {trial.grips} grips; trial {len(study.trials)}"
        print(f"{self.path}: {who}{trial.task}, {trial.setting}: {result}", file=sys.stderr)

    def close(self) -> None:
        """End the trial, and wait until all is written. Further calls do nothing."""
        self._end()
        self._writer.shutdown()


# The comparison: means and standard deviations over participants

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
