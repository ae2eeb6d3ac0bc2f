"""`vrgs.py study`: compare what participants did and said in the two settings, physics and transform."""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime
from pathlib import Path

from assets.file_access import atomic_write
from commands.conditions import Condition
from core.errors import BadInput
from core.program import as_called

HELP = "compare recorded participants in the settings physics and transform; the questionnaire"
EXAMPLES = (
    "--scene ring_toss --study all.h5 --participant Ida --interaction transform",
    "study all.h5 --out all.csv",
    "study all.h5 --form --participant Ida --setting transform",
    "study all.h5 --form form.html",
    "study all.h5 --answers answers_Ida_transform.json",
)
CONDITIONS = (
    Condition(
        ("--out",),
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
    parser.add_argument("--out", type=Path, metavar="OUT.csv", help="write each participant's means")
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
    """Print the comparison; write the participants' means."""
    from display.study.comparison import compare_study, overview, table, write_csv
    from display.study.study_file import Study, read_study

    studies = [read_study(file) for file in args.files]
    study = Study([t for s in studies for t in s.trials], [a for s in studies for a in s.answers])
    rows = compare_study(study)
    print(overview(study))
    for line in table(rows):
        print(line)
    if args.out:
        write_csv(args.out, rows)
        print(f"wrote {args.out}", file=sys.stderr)
