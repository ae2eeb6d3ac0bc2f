"""Trials of the study and answers to its questionnaire: records of what a participant does and says.

A trial is one participant's play of one task, from its start to its goal or its end. The questionnaire has the themes
of the paper's user study in this program's own words. It is asked in the terminal, or as an HTML page that works
without a network and gives a JSON file:
{"format": "vrgs-answers", "participant": "Ida", "setting": "physics", "answers": {"realism": 6, ...}, "comment": ""}
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from assets.file_access import read_json
from core.errors import BadInput
from core.typed import Form, Range, Size, from_plain
from display.protocol import Frame, WorldView

SETTINGS = ("physics", "transform")
MIXED = "mixed"  # the setting of a trial with grips in both
THROW_SPEED = 0.5  # [m/s] of a body when it is let go; what is put down is slower
GOAL_HOLD = 1.0  # [s] for which a score must hold: a ring in flight may pass around the bottle's axis
HAND_SPEED_MAX = 10.0  # [m/s]; a hand that is faster was lost, or teleported with its player


@dataclass
class Trial:
    """Record of a participant's play of a task. Times are in the world's time without pauses [s].

    setting     "physics", "transform" or "mixed"
    device      "window", "headset", "browser" or "headless"
    about       options of the scene, roles of the user's own bodies
    seconds     until the goal was reached, or else until the end
    first_grip  until something was held; NaN: never
    goal        score that ends the task; NaN: it has none
    completed   whether the goal was reached
    grips       number of times that a body was taken
    throws      number of times that a body was let go at THROW_SPEED or more
    hand_path   distance moved by the hands [m]
    body_path   distance moved by bodies that were held [m]
    scores      times at which the score changed, with the new one, (K, 2)
    """

    participant: str
    task: str
    setting: str = SETTINGS[0]
    device: str = "headless"
    started: str = ""
    about: dict = field(default_factory=dict)
    seconds: float = 0.0
    first_grip: float = math.nan
    goal: float = math.nan
    completed: bool = False
    grips: int = 0
    throws: int = 0
    hand_path: float = 0.0
    body_path: float = 0.0
    frames: int = 0
    scores: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def score(self) -> float:
        """The last score."""
        return float(self.scores[-1, 1]) if len(self.scores) else 0.0

    @property
    def precision(self) -> float:
        """Score a grip; NaN if nothing was gripped."""
        return self.score / self.grips if self.grips else math.nan


class TrialMeter:
    """Measures a trial: `after` each frame, then `trial`. It is `over` once the goal is reached and has held."""

    def __init__(self, trial: Trial, goal: float | None):
        self.over = False
        self._trial, self._goal = trial, math.nan if goal is None else float(goal)
        self._trial.started = datetime.now(UTC).isoformat(timespec="seconds")
        self._time, self._reached = 0.0, math.nan
        self._hands: list[np.ndarray] = []
        self._held: list[bool] = []
        self._centroids: list[np.ndarray] = []
        self._settings: set[str] = set()
        self._scores: list[tuple[float, float]] = []

    def after(self, frame: Frame, world: WorldView) -> None:
        """Take account of a frame, after the world's step."""
        trial, dt = self._trial, 0.0 if world.paused else frame.dt
        self._time += dt
        trial.frames += 1
        trial.setting = world.interaction
        self._follow_hands(frame, dt)
        self._follow_bodies(world)
        score = float(world.score)
        if not self._scores or self._scores[-1][1] != score:
            self._scores.append((self._time, score))
        if not score >= self._goal:  # also if the goal is NaN
            self._reached = math.nan
        elif math.isnan(self._reached):
            self._reached = self._time
        self.over = self._time - self._reached >= GOAL_HOLD

    def _follow_hands(self, frame: Frame, dt: float) -> None:
        hands = [np.asarray(hand.position, np.float64) for hand in frame.hands]
        if len(hands) == len(self._hands):
            moved = [float(np.linalg.norm(b - a)) for a, b in zip(self._hands, hands, strict=True)]
            self._trial.hand_path += sum(d for d in moved if d <= HAND_SPEED_MAX * dt)
        self._hands = hands

    def _follow_bodies(self, world: WorldView) -> None:
        trial, bodies = self._trial, world.bodies()
        if len(bodies) == len(self._held):  # otherwise one was added or removed
            for before, at, body in zip(self._held, self._centroids, bodies, strict=True):
                if body.held and not before:
                    trial.grips += 1
                    trial.first_grip = self._time if trial.grips == 1 else trial.first_grip
                elif before and not body.held and np.linalg.norm(body.velocity) >= THROW_SPEED:
                    trial.throws += 1
                if body.held:
                    self._settings.add(world.interaction)
                if body.held and before:
                    trial.body_path += float(np.linalg.norm(body.centroid - at))
        self._held, self._centroids = [b.held for b in bodies], [b.centroid for b in bodies]

    def trial(self) -> Trial:
        """The trial up to now."""
        t = self._trial
        t.completed = not math.isnan(self._reached)
        t.seconds, t.goal = self._reached if t.completed else self._time, self._goal
        t.scores = np.array(self._scores, np.float64).reshape(-1, 2)
        if self._settings:
            t.setting = MIXED if len(self._settings) > 1 else next(iter(self._settings))
        return t


# The questionnaire

SCALE = 7  # from 1, not at all, to this, completely
QUESTIONS = {
    "immersion": ("Immersion", "I felt as if I were in that place, among these things."),
    "realism": ("Realism", "Things moved and deformed as real ones do."),
    "ease": ("Ease of use", "It was easy to do what I wanted to do."),
    "intuition": ("Intuition", "I knew how to use my hands without thinking about it."),
    "response": ("Response", "What I held followed my hands at once."),
    "control": ("Control", "I could put things exactly where I wanted them."),
    "enjoyment": ("Enjoyment", "I would like to play like this again."),
}
ENDS = ("not at all", "completely")
ANSWERS_FORMAT = "vrgs-answers"
TEXT_MAX = 10_000  # [characters] of a comment
FILE_MAX = 1 << 20  # [bytes] of a file of answers


@dataclass(frozen=True)
class Answers:
    """A participant's answers about a setting: 1 to SCALE for each of QUESTIONS, 0: not answered."""

    participant: str
    setting: str
    values: tuple[int, ...]
    comment: str = ""
    started: str = ""


@dataclass(frozen=True)
class AnswersFile:
    """A file of answers, as the page saves it."""

    format: Literal[ANSWERS_FORMAT]
    participant: Annotated[str, Size(TEXT_MAX), Form(r"(?s).*\S.*", "a name")]
    setting: Literal[*SETTINGS]
    answers: dict[Literal[*QUESTIONS], Annotated[int, Range(0, SCALE)]]
    comment: Annotated[str, Size(TEXT_MAX)] = ""


def ask(participant: str | None, setting: str | None, started: str, read: Callable[[str], str]) -> Answers:
    """Ask in the terminal; what is given is not asked for. Raises BadInput if the input ends."""
    try:
        participant = participant or ask_until("Participant: ", bool, read)
        both = " or ".join(SETTINGS)
        setting = setting or ask_until(f"Setting ({both}): ", lambda text: text in SETTINGS, read)
        print(f"From 1 ({ENDS[0]}) to {SCALE} ({ENDS[1]}); Enter: no answer.")
        valid = {"", *map(str, range(1, SCALE + 1))}
        values = [ask_until(f"{text} ", lambda given: given in valid, read) for _, text in QUESTIONS.values()]
        comment = read("Anything else? ").strip()[:TEXT_MAX]
    except (EOFError, UnicodeDecodeError) as e:
        raise BadInput("the input ended before the last answer; nothing was kept") from e
    return Answers(participant, setting, tuple(int(v or 0) for v in values), comment, started)


def ask_until(prompt: str, is_valid: Callable[[str], bool], read: Callable[[str], str]) -> str:
    """Ask again and again until the answer is valid."""
    while True:
        given = read(prompt).strip()
        if is_valid(given):
            return given


def read_answers_file(path: Path, started: str) -> Answers:
    """Answers as the page gives them. Raises BadInput."""
    said = from_plain(AnswersFile, read_json(path, FILE_MAX), str(path))
    values = tuple(said.answers.get(key, 0) for key in QUESTIONS)
    return Answers(said.participant.strip(), said.setting, values, said.comment, started)


def form_page() -> str:
    """The questionnaire as an HTML page of its own."""
    rows = "".join(
        f"<fieldset><legend>{html.escape(text)}</legend><span>{ENDS[0]}</span>"
        + "".join(f'<label><input type="radio" name="{key}" value="{v}">{v}</label>' for v in range(1, SCALE + 1))
        + f"<span>{ENDS[1]}</span></fieldset>"
        for key, (_, text) in QUESTIONS.items()
    )
    settings = "".join(f'<label><input type="radio" name="setting" value="{s}" required>{s}</label>' for s in SETTINGS)
    return PAGE.replace("ROWS", rows).replace("SETTINGS", settings).replace("FORMAT", ANSWERS_FORMAT)


PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>VR-GS: questionnaire</title><style>
body{font:16px/1.5 system-ui,sans-serif;max-width:44rem;margin:2rem auto;padding:0 1rem;color:#222}
fieldset{border:0;border-top:1px solid #ddd;margin:0;padding:.8rem 0}legend{padding:0}
label{margin:0 .5rem}span{color:#777;font-size:.85rem}textarea{width:100%}
</style></head><body><h1>How was it?</h1><form id="form">
<p>Participant <input name="participant" required maxlength="200"></p><p>Setting SETTINGS</p>ROWS
<p>Anything else?<br><textarea name="comment" rows="3" maxlength="10000"></textarea></p>
<button>Save the answers</button></form><script>
document.getElementById("form").addEventListener("submit", event => {
  event.preventDefault();
  const answers = {}, given = Object.fromEntries(new FormData(event.target));
  const {participant, setting, comment, ...values} = given;
  for (const key in values) answers[key] = Number(values[key]);
  const text = JSON.stringify({format: "FORMAT", participant, setting, answers, comment}, null, 2);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], {type: "application/json"}));
  link.download = `answers_${participant}_${setting}.json`;
  link.click();
});
</script></body></html>
"""
