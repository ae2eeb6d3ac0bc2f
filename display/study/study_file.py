"""The file of a study: trials and answers of all its participants, in HDF5.

Root attributes: `format` "vrgs-study", `version`.

| dataset | shape, type | |
| --- | --- | --- |
| trials/seconds, first_grip, goal, hand_path, body_path | (T,) float64 | see Trial; NaN: there is none |
| trials/completed, grips, throws, frames, scores | (T,) int64 | scores: number of rows in scores/ |
| trials/text | (B,) uint8 | JSON lines: participant, task, setting, device, started, about |
| scores/time, scores/value | (S,) float64 | of all trials, concatenated |
| answers/values | (A, Q) int64 | 0: not answered |
| answers/text | (C,) uint8 | JSON lines: participant, setting, started, comment |

The file is replaced as a whole by one with more in it, so that it is complete at any moment.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, locked
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, write_dataset, write_text
from display.study.questionnaire import QUESTIONS, SCALE, Answers
from display.study.trial import MIXED, SETTINGS, Trial

FORMAT, VERSION = "vrgs-study", 1
FLOATS = ("seconds", "first_grip", "goal", "hand_path", "body_path")
INTEGERS = ("completed", "grips", "throws", "frames")
NUMBER_MAX = 1e12  # of seconds, metres and scores: what is computed of them stays finite
TEXTS = ("participant", "task", "setting", "device", "started")


@dataclass
class Study:
    """All that a file holds."""

    trials: list[Trial] = field(default_factory=list)
    answers: list[Answers] = field(default_factory=list)


def read_study(path: str | Path) -> Study:
    """Read and check a file. Raises BadInput."""
    with open_hdf5(Path(path)) as file:
        if file.text("", "format") != FORMAT:
            raise file.error("is not a study of VR-GS")
        if file.number("", "version") != VERSION:
            raise file.error(f"is a study of version {file.number('', 'version'):g}; this program knows {VERSION}")
        return Study(read_trials(file), read_answers(file))


def read_trials(file: Hdf5Reader) -> list[Trial]:
    """The trials of an open file."""
    texts = json_lines(file, "trials/text", TEXTS)
    count = (len(texts),)
    floats = {name: file.floats(f"trials/{name}", count, np.float64) for name in FLOATS}
    integers = {name: file.indices(f"trials/{name}", count, np.int64) for name in (*INTEGERS, "scores")}
    scores = np.stack([file.floats(f"scores/{name}", (None,), np.float64) for name in ("time", "value")], axis=1)
    ends = np.cumsum(integers["scores"])
    required = np.stack([floats[name] for name in ("seconds", "hand_path", "body_path")])
    others = np.concatenate([scores.ravel(), *(floats[name] for name in ("first_grip", "goal"))])
    sound = (
        (required >= 0).all() and np.isfinite(scores).all() and (np.abs(others[~np.isnan(others)]) < NUMBER_MAX).all()
    )
    if not (sound and (required < NUMBER_MAX).all()):  # NaN compares false
        raise file.error(f"a number of a trial is not finite, negative, or beyond {NUMBER_MAX:g}")
    if (ends[-1] if len(ends) else 0) != len(scores):
        raise file.error("the scores do not belong to the trials")
    trials = []
    for k, text in enumerate(texts):
        if text["setting"] not in (*SETTINGS, MIXED) or not isinstance(text.get("about", {}), dict):
            raise file.error(f"trial {k + 1} is of no setting that there is")
        numbers = {name: values[k].item() for name, values in (floats | integers).items() if name != "scores"}
        numbers["completed"] = bool(numbers["completed"])
        own = scores[ends[k] - integers["scores"][k] : ends[k]]
        trials.append(Trial(**{t: text[t] for t in TEXTS}, about=text.get("about", {}), **numbers, scores=own))
    return trials


def read_answers(file: Hdf5Reader) -> list[Answers]:
    """The answers of an open file."""
    texts = json_lines(file, "answers/text", ("participant", "setting", "started", "comment"))
    values = file.indices("answers/values", (len(texts), len(QUESTIONS)), np.int64)
    if values.size and values.max() > SCALE:
        raise file.error(f"an answer is greater than {SCALE}")
    if any(text["setting"] not in SETTINGS for text in texts):
        raise file.error("an answer is about no setting that there is")
    return [
        Answers(text["participant"], text["setting"], tuple(row.tolist()), text["comment"], text["started"])
        for text, row in zip(texts, values, strict=True)
    ]


def json_lines(file: Hdf5Reader, name: str, texts: tuple[str, ...]) -> list[dict]:
    """JSON objects, one a line, in which these entries are texts."""
    try:
        rows = [json.loads(line) for line in bytes(file.indices(name, (None,), np.uint8)).decode().splitlines()]
    except (ValueError, RecursionError) as e:
        raise file.error(f"{name} is not JSON, line by line") from e
    for row in rows:
        if not isinstance(row, dict) or not all(isinstance(row.get(key), str) for key in texts):
            raise file.error(f"{name} has a line without {', '.join(texts)}")
    return rows


def write_study(path: str | Path, study: Study) -> None:
    """Write the file, whole or not at all, and onto the disk. Raises BadInput."""
    trials, answers = study.trials, study.answers
    about = [{**{name: getattr(t, name) for name in TEXTS}, "about": t.about} for t in trials]
    said = [
        {"participant": a.participant, "setting": a.setting, "started": a.started, "comment": a.comment}
        for a in answers
    ]
    scores = np.concatenate([np.zeros((0, 2)), *(t.scores for t in trials)])
    with atomic_write(path) as beside:
        with new_hdf5(beside) as file:
            write_text(file, "format", FORMAT)
            file.attrs["version"] = VERSION
            for name in FLOATS:
                write_dataset(file, f"trials/{name}", [getattr(t, name) for t in trials], np.float64)
            for name in INTEGERS:
                write_dataset(file, f"trials/{name}", [getattr(t, name) for t in trials], np.int64)
            write_dataset(file, "trials/scores", [len(t.scores) for t in trials], np.int64)
            for name, lines in (("trials/text", about), ("answers/text", said)):
                text = "".join(f"{json.dumps(line)}\n" for line in lines)
                write_dataset(file, name, np.frombuffer(text.encode(), np.uint8), np.uint8)
            for name, column in (("scores/time", 0), ("scores/value", 1)):
                write_dataset(file, name, scores[:, column], np.float64)
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
