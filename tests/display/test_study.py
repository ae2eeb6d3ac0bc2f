"""The study: trials measured and kept, the questionnaire, and the comparison of the settings."""

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from core.errors import BadInput
from core.vocabulary import BodyState, Hand
from display.protocol import Frame
from display.study.study_file import Study, StudyLog, add_to_study, compare, read_study, write_study
from display.study.trial import MIXED, QUESTIONS, Answers, Trial, ask, form_page, read_answers_file
from display.user_commands import PlayDemo, Reset
from vrgs import main

DT = 0.1  # [s]
AWAY = np.array([0.3, 0.0, 0.4])  # [m], 0.5 long
SAID = {"format": "vrgs-answers", "participant": "Ida", "setting": "physics", "answers": {}, "comment": ""}


class Table:
    """A world with one body that is where and as a test says."""

    def __init__(self, goal: float | None = None):
        self.scene = SimpleNamespace(game=SimpleNamespace() if goal is None else SimpleNamespace(goal=goal))
        self.paused = self.demo = False
        self.interaction, self.score, self.held, self.at, self.speed = "physics", 0, False, np.zeros(3), 0.0

    def bodies(self):
        velocity = np.array([0.0, self.speed, 0.0])
        return [BodyState("ring", self.at.copy(), velocity, self.at, self.at, velocity, self.held)]


def log(path: Path, **changes) -> StudyLog:
    new = {"participant": "Ida", "task": "ring_toss", "device": "window", "about": {}}
    return StudyLog(path, **(new | changes))


def frames(study: StudyLog, world: Table, count: int = 1, *, hand=(0.0, 1.0, 0.0), commands=()) -> None:
    for k in range(count):
        study.after(Frame(DT, 0.0, [], [Hand(hand)], list(commands) if k == 0 else []), world)


def test_a_trial_is_measured(tmp_path):
    """A body is taken, carried 0.5 m, thrown, and put down once; the hand is also lost for a frame."""
    world = Table()
    with log(tmp_path / "s.h5", about={"roles": {"ring 1": "cat.h5"}}) as study:
        frames(study, world, 3)
        world.held = True
        frames(study, world)
        world.at = world.at + AWAY
        frames(study, world, hand=(0.3, 1.0, 0.4))
        world.held, world.speed = False, 2.0
        frames(study, world, hand=(0.3, 1.0, 0.4))
        world.score, world.at, world.speed = 1, world.at + AWAY, 0.0
        frames(study, world, 2, hand=(9.0, 9.0, 9.0))  # lost: too far for one frame
        world.held = True
        frames(study, world, hand=(9.0, 9.0, 9.0))
        world.held = False
        world.paused = True
        frames(study, world, hand=(9.0, 9.0, 9.0))
    (trial,) = read_study(tmp_path / "s.h5").trials
    assert (trial.participant, trial.task, trial.setting, trial.device) == ("Ida", "ring_toss", "physics", "window")
    assert (trial.grips, trial.throws, trial.frames, trial.completed) == (2, 1, 10, False)
    assert_allclose([trial.hand_path, trial.body_path], [0.5, 0.5])
    assert_allclose([trial.first_grip, trial.seconds], [4 * DT, 9 * DT])
    assert_allclose(trial.scores, [[DT, 0.0], [7 * DT, 1.0]])
    assert trial.score == 1 and trial.precision == 0.5 and math.isnan(trial.goal)
    assert trial.about == {"roles": {"ring 1": "cat.h5"}}


def test_a_task_is_done_once_its_goal_holds(tmp_path):
    """A score that is lost again at once does not end it; the time is that at which it was reached."""
    world = Table(goal=3)
    with log(tmp_path / "s.h5") as study:
        world.held = True
        frames(study, world, 2)
        world.score = 3
        frames(study, world, 5)
        world.score = 2
        frames(study, world, 3)
        world.score = 3
        frames(study, world, 11)
        study._writer.submit(lambda: None).result()
        assert len(read_study(tmp_path / "s.h5").trials) == 1  # kept before the play ends
        frames(study, world, 50)
    (trial,) = read_study(tmp_path / "s.h5").trials
    assert trial.completed and trial.goal == 3 and trial.seconds == pytest.approx(11 * DT)


def test_resets_begin_trials_and_demonstrations_are_none(tmp_path):
    world = Table()
    with log(tmp_path / "s.h5") as study:
        world.held = True
        frames(study, world, 12)
        frames(study, world, 20, commands=[Reset()])
        world.demo = True
        frames(study, world, 30, commands=[PlayDemo(True)])
        world.demo, world.interaction = False, "transform"
        frames(study, world, 13, commands=[PlayDemo(False)])  # goes on where the demonstration left off
        frames(study, world, 14, commands=[Reset()])
        world.interaction = "physics"
        frames(study, world, 15, commands=[Reset()])
        world.interaction = "transform"
        frames(study, world, 5)
        world.held = False
        frames(study, world, 5, commands=[Reset()])  # half a second without a grip is no trial
    trials = read_study(tmp_path / "s.h5").trials
    assert [t.frames for t in trials] == [12, 20, 14, 20]
    assert [t.setting for t in trials] == ["physics", "physics", "transform", MIXED]


def test_what_cannot_be_written_is_told_at_once(tmp_path):
    with pytest.raises(BadInput, match="cannot write"):
        log(tmp_path / "nowhere" / "s.h5")
    (tmp_path / "other.h5").write_bytes(b"no HDF5")
    with pytest.raises(BadInput, match="not a readable HDF5"):
        log(tmp_path / "other.h5")
    assert main(["--participant", "Ida", "--headless"]) == 2


def test_a_file_that_becomes_unwritable_ends_no_play(tmp_path, capsys):
    world = Table()
    world.held = True
    (tmp_path / "folder").mkdir()
    with log(tmp_path / "folder" / "s.h5") as study:
        frames(study, world, 12)
        (tmp_path / "folder").rmdir()
    assert "a trial is lost" in capsys.readouterr().err


def some_study() -> Study:
    """Four participants did one task in both settings, slower in transform, and two answered about both."""
    trials, answers = [], []
    for k, name in enumerate(("Ida", "Bo", "<Cy>", "Di")):
        for setting, slower in (("physics", 0.0), ("transform", 2.0 + k)):
            scores = np.array([[0.1, 0.0], [3.0, 1.0 + k]])
            trials.append(
                Trial(name, "ring_toss", setting, seconds=10.0 + k + slower, grips=4, frames=9, scores=scores)
            )
            if k < 2:
                first = (7 - k,) if setting == "physics" else (2, 0)
                values = (*first, *[4] * (len(QUESTIONS) - len(first)))
                answers.append(Answers(name, setting, values, "it <fell>" if k else "", "2026-01-01T00:00:00+00:00"))
    return Study(trials, answers)


def test_a_study_is_written_and_read_again(tmp_path):
    study = some_study()
    write_study(tmp_path / "s.h5", study)
    again = read_study(tmp_path / "s.h5")
    assert again.answers == study.answers and len(again.trials) == len(study.trials)
    for a, b in zip(again.trials, study.trials, strict=True):
        assert_allclose(a.scores, b.scores)
        empty = {"scores": 0, "goal": 0.0, "first_grip": 0.0}
        assert replace(a, **empty) == replace(b, **empty) and math.isnan(a.goal) and math.isnan(a.first_grip)


def put(name, value):
    return lambda file: file[name].__setitem__(0, value)


def text(name, line):
    def change(file):
        del file[name]
        file[name] = np.frombuffer(line.encode(), np.uint8)

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda file: file.attrs.__setitem__("format", "vrgs-asset"), "is not a study"),
        (lambda file: file.attrs.__setitem__("version", 9), "version 9"),
        (put("trials/seconds", np.inf), "trials/seconds holds values out of range"),
        (put("trials/hand_path", -1.0), "trials/hand_path holds"),
        (put("trials/grips", -1), "out of range"),
        (put("trials/scores", 3), "do not belong"),
        (put("answers/values", 8), "answers/values holds"),
        (text("trials/text", "{}\n" * 8), "line 1: participant is missing"),
        (text("trials/text", "{\n" * 8), "line 1: not JSON"),
        (text("trials/text", "[]\n" * 2), "line 1: it is [], not an object"),
        (lambda file: file.__delitem__("scores/time"), "missing dataset 'scores/time'"),
    ],
)
def test_a_damaged_study_is_refused_in_one_line(tmp_path, capsys, change, says):
    path = tmp_path / "s.h5"
    write_study(path, some_study())
    with h5py.File(path, "r+") as file:
        change(file)
    assert main(["study", str(path)]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1 and str(path) in error


def test_settings_are_compared_within_participants_where_they_did_both():
    """Trials are averaged first; who did one setting only counts in its mean, not in the difference."""
    given = [(f"P{k}", "physics", 10.0 + k) for k in range(5)]
    given += [(f"P{k}", "transform", 12.0 + 2 * k) for k in range(5)]
    given += [("P0", "physics", 12.0), ("alone", "transform", 100.0), ("", "physics", math.nan), ("P1", "mixed", 0.0)]
    c = compare("task", "measure", given)
    assert_allclose(c.pairs[0], [11.0, 12.0])
    assert [len(values) for values in c.means.values()] == [5, 6]
    assert c.mean("physics") == pytest.approx(np.mean([11.0, 11.0, 12.0, 13.0, 14.0]))
    assert c.spread("physics") == pytest.approx(np.std([11.0, 11.0, 12.0, 13.0, 14.0], ddof=1))
    assert c.difference == pytest.approx(np.mean([1.0, 3.0, 4.0, 5.0, 6.0]))


def test_settings_are_compared_between_participants_otherwise():
    given = [("", "physics", v) for v in (1.0, 2.0, 3.0)] + [("", "transform", v) for v in (4.0, 5.0, 9.0)]
    assert compare("task", "measure", given).difference == pytest.approx(4.0)
    few = compare("task", "measure", given[2:4])
    assert math.isnan(few.spread("physics")) and few.difference == pytest.approx(1.0)


def test_the_command_prints_a_table_and_writes_the_means(tmp_path, capsys):
    for k, part in enumerate((some_study().trials[:4], some_study().trials[4:])):
        write_study(tmp_path / f"{k}.h5", Study(part, some_study().answers if k else []))
    files = [str(tmp_path / f"{k}.h5") for k in (0, 1)]
    assert main(["study", *files, "--out", str(tmp_path / "n.csv")]) == 0
    said = capsys.readouterr().out
    assert said.startswith("trials: 8; answered questionnaires: 4; named participants: 4\n")
    (line,) = (line for line in said.splitlines() if line.startswith("time on task"))
    assert re.search(r"11\.5 ± 1\.29 \(4\) +15 ± 2\.58 \(4\) +3\.5$", line)
    (line,) = (line for line in said.splitlines() if line.startswith("Immersion"))
    assert "6.5" in line and "2 ± 0 (2)" in line
    with open(tmp_path / "n.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    precise = [float(r["mean"]) for r in rows if r["measure"].startswith("precision") and r["setting"] == "physics"]
    assert_allclose(precise, [0.25, 0.5, 0.75, 1.0])
    assert not [r for r in rows if (r["measure"], r["setting"]) == ("Realism", "transform")]  # not answered
    assert [r["participant"] for r in rows[:4]] == ["Ida", "Bo", "<Cy>", "Di"] and len(rows) == 7 * 8 + 7 * 4 - 2


def test_the_questionnaire_is_asked_in_the_terminal(tmp_path, monkeypatch, capsys):
    given = iter(["", "Ida", "phys", "physics", "8", "x", "7", "", *["4"] * (len(QUESTIONS) - 2), " good "])
    answers = ask(None, None, "now", read=lambda prompt: next(given))
    assert answers == Answers("Ida", "physics", (7, 0, *[4] * (len(QUESTIONS) - 2)), "good", "now")
    monkeypatch.setattr("builtins.input", lambda prompt: "3")
    command = ["study", str(tmp_path / "s.h5"), "--form", "--participant", "Bo", "--setting", "transform"]
    assert main(command) == 0 and main(command) == 0
    assert [a.values for a in read_study(tmp_path / "s.h5").answers] == [(3,) * len(QUESTIONS)] * 2

    def ended(prompt):
        raise EOFError

    monkeypatch.setattr("builtins.input", ended)
    capsys.readouterr()
    assert main(command) == 2 and "nothing was kept" in capsys.readouterr().err
    assert len(read_study(tmp_path / "s.h5").answers) == 2


def test_the_questionnaire_is_a_page_whose_answers_are_read(tmp_path, capsys):
    assert main(["study", str(tmp_path / "s.h5"), "--form", str(tmp_path / "form.html")]) == 0
    page = (tmp_path / "form.html").read_text()
    assert page == form_page() and all(
        f'name="{key}"' in page and words in page for key, (_, words) in QUESTIONS.items()
    )
    said = SAID | {"answers": {"ease": 6}, "comment": "c"}
    (tmp_path / "a.json").write_text(json.dumps(said))
    assert main(["study", str(tmp_path / "s.h5"), "--answers", str(tmp_path / "a.json")]) == 0
    (answers,) = read_study(tmp_path / "s.h5").answers
    assert dict(zip(QUESTIONS, answers.values, strict=True)) == {key: 6 * (key == "ease") for key in QUESTIONS}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"format": "x"}, "format is 'x', not one of vrgs-answers"),
        ({"setting": "magic"}, "setting is 'magic', not one of physics, transform"),
        ({"answers": {"speed": 3}}, "answers is 'speed', not one of immersion"),
        ({"answers": {"ease": 8}}, "answers.ease is 8, not a whole number from 0 to 7"),
        ({"participant": " "}, "participant is ' ', not a name"),
    ],
)
def test_bad_answers_are_refused(tmp_path, changes, says):
    (tmp_path / "a.json").write_text(json.dumps(SAID | changes))
    with pytest.raises(BadInput, match=says):
        read_answers_file(tmp_path / "a.json", "now")


def test_a_lock_that_was_left_is_taken_over(tmp_path, monkeypatch):
    monkeypatch.setattr("assets.file_access.LOCK_PATIENCE", 0.2)
    (tmp_path / ".s.h5.lock").touch()
    add_to_study(tmp_path / "s.h5", lambda study: study.trials.append(Trial("Ida", "task")))
    assert [p.name for p in tmp_path.iterdir()] == ["s.h5"]
