"""The questionnaire of the study: about each setting, the themes of the paper's user study in this program's own words.

It is asked in the terminal, or as an HTML page that works without a network and gives a JSON file:
{"format": "vrgs-answers", "participant": "Ida", "setting": "physics", "answers": {"realism": 6, ...}, "comment": ""}
"""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from assets.file_access import read_json
from core.errors import BadInput
from core.typed import Form, Range, Size, from_plain
from display.study.trial import SETTINGS

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
FORMAT = "vrgs-answers"
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

    format: Literal[FORMAT]
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
    return PAGE.replace("ROWS", rows).replace("SETTINGS", settings).replace("FORMAT", FORMAT)


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
