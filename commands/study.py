"""`vrgs.py study`: compare what participants did and said in the two settings, physics and transform."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from assets.file_access import atomic_write
from commands.conditions import Condition
from core.errors import BadInput
from core.program import as_called

if TYPE_CHECKING:
    from display.study.comparison import Comparison
    from display.study.study_file import Study

HELP = "compare recorded participants in the settings physics and transform; the questionnaire"
EXAMPLES = (
    "--scene ring_toss --study all.h5 --participant Ida --interaction transform",
    "study all.h5 --out all.html",
    "study all.h5 --form --participant Ida --setting transform",
    "study all.h5 --form form.html",
    "study all.h5 --answers answers_Ida_transform.json",
)
CONDITIONS = (
    Condition(
        ("--out", "--json"),
        lambda args: args.form is None and not args.answers,
        "is for the comparison: leave out --form and --answers",
    ),
    Condition(("--answers",), lambda args: args.form is None, "and --form do not go together"),
    Condition(
        ("--participant", "--setting"),
        lambda args: args.form == "",
        "belongs to --form, which asks in the terminal",
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("files", type=Path, nargs="+", metavar="STUDY.h5", help="files of --study")
    parser.add_argument("--out", type=Path, metavar="PAGE.html", help="write tables and plots as a page")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the numbers")
    text = "ask the questionnaire in the terminal, or write it as a page that saves the answers"
    parser.add_argument("--form", nargs="?", const="", metavar="FORM.html", help=text)
    text = "add answers that such a page has saved"
    parser.add_argument("--answers", type=Path, nargs="+", metavar="ANSWERS.json", help=text)
    text = "--form: who answers (default: asked)"
    parser.add_argument("--participant", metavar="NAME", help=text)
    text = "--form: the setting that it is about (default: asked)"
    parser.add_argument("--setting", choices=("physics", "transform"), help=text)


def run(args: argparse.Namespace) -> None:
    """Ask, add answers, or print the comparison. Raises BadInput."""
    if args.form:
        from display.study.questionnaire import form_page

        with atomic_write(args.form) as beside:
            beside.write_text(form_page(), encoding="utf-8")
        add = as_called(f"vrgs.py study {args.files[0]} --answers FILE.json")
        print(f"wrote {args.form}; what it saves is added by: {add}")
    elif args.form is not None or args.answers:
        add_answers(args)
    else:
        show(args)


def add_answers(args: argparse.Namespace) -> None:
    """Add answers from the terminal or from files to the study."""
    from display.study.questionnaire import ask, read_answers_file
    from display.study.study_file import add_to_study, read_study

    if len(args.files) > 1:
        raise BadInput("answers are added to one file: name one")
    (path,) = args.files
    if path.exists():
        read_study(path)  # before anyone is asked
    now = datetime.now(UTC).isoformat(timespec="seconds")
    if args.answers:
        new = [read_answers_file(file, now) for file in args.answers]
    else:
        new = [ask(args.participant, args.setting, now, input)]
    study = add_to_study(path, lambda study: study.answers.extend(new))
    print(f"{path}: {len(study.answers)} answered questionnaires")


def show(args: argparse.Namespace) -> None:
    """Print the comparison; write the page and the numbers."""
    from display.study.comparison import compare_answers, compare_trials
    from display.study.study_file import Study, read_study
    from display.study.study_page import page
    from display.timing import write_stats

    studies = [read_study(file) for file in args.files]
    study = Study([t for s in studies for t in s.trials], [a for s in studies for a in s.answers])
    rows = [*compare_trials(study), *compare_answers(study)]
    print(overview(study))
    for line in table(rows):
        print(line)
    if args.json:
        write_stats(args.json, [c.row() for c in rows])
    if args.out:
        with atomic_write(args.out) as beside:
            beside.write_text(page(study, rows, overview(study)), encoding="utf-8")
        print(f"wrote {args.out}", file=sys.stderr)


def overview(study: Study) -> str:
    """Line that counts trials and answered questionnaires."""
    from display.study.trial import MIXED

    people = {t.participant for t in study.trials} | {a.participant for a in study.answers}
    mixed = sum(t.setting == MIXED for t in study.trials)
    left_out = f" ({mixed} with grips in both settings, left out)" if mixed else ""
    return (
        f"trials: {len(study.trials)}{left_out}; answered questionnaires: {len(study.answers)};"
        f" named participants: {len(people - {''})}"
    )


def table(rows: Iterable[Comparison]) -> Iterable[str]:
    """Lines of text: a block for each task."""
    from display.study.trial import SETTINGS

    task = None
    for c in rows:
        if c.task != task:
            task = c.task
            yield ""
            yield f"{task:26}" + "".join(f"{s + ' (n)':>26}" for s in SETTINGS) + f"{'difference':>12}  test"
        cells = "".join(f"{cell(c, s):>26}" for s in SETTINGS)
        yield f"{c.measure:26}{cells}{number(c.difference):>12}  {c.test_text}"


def cell(c: Comparison, setting: str) -> str:
    """Mean and standard deviation of a setting, and its sample."""
    return f"{number(c.mean(setting))} ± {number(c.spread(setting))} ({len(c.samples[setting])})"


def number(value: float) -> str:
    """Three digits, or a dash."""
    return "-" if value != value else f"{value:.3g}"
