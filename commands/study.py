"""`vrgs.py study`: compare what participants did and said in the two settings, physics and transform."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from assets.file_access import atomic_write
from commands import options as cli
from core.errors import BadInput
from core.program import as_called


@dataclass(kw_only=True)
class StudyOptions(cli.Options):
    EXAMPLES = (
        "--scene ring_toss --study all.h5 --participant Ida --interaction transform",
        "study all.h5 --out all.csv",
        "study all.h5 --form --participant Ida --setting transform",
        "study all.h5 --form form.html",
        "study all.h5 --answers answers_Ida_transform.json",
    )
    CONDITIONS = (
        cli.Condition(("--out",), lambda o: o.form is None and not o.answers, "is for the comparison alone"),
        cli.Condition(("--answers",), lambda o: o.form is None, "and --form do not go together"),
        cli.Condition(
            ("--participant", "--setting"), lambda o: o.form == "", "belongs to --form, which asks in the terminal"
        ),
    )

    files: list[Path] = cli.argument("STUDY.h5", "files of --study")
    out: Path | None = cli.option("OUT.csv", "write each participant's means")
    form: str | None = cli.option("FORM.html", "ask in the terminal, or write a page that saves the answers", bare="")
    answers: list[Path] | None = cli.option("ANSWERS.json", "add answers that such a page has saved")
    participant: str | None = cli.option("NAME", "--form: who answers (default: asked)")
    setting: cli.Setting | None = cli.option(None, "--form: the setting that it is about (default: asked)")


def study(options: StudyOptions) -> None:
    """Ask, add answers, or print the comparison. Raises BadInput."""
    if options.form:
        from display.study.trial import form_page

        with atomic_write(options.form) as beside:
            beside.write_text(form_page(), encoding="utf-8")
        add = as_called(f"vrgs.py study {options.files[0]} --answers FILE.json")
        print(f"wrote {options.form}; to add the answers that it saves: {add}")
    elif options.form is not None or options.answers:
        add_answers(options)
    else:
        show(options)


def add_answers(options: StudyOptions) -> None:
    """Add answers from the terminal or from files to the study."""
    from display.study.study_file import add_to_study, read_study
    from display.study.trial import ask, read_answers_file

    if len(options.files) > 1:
        raise BadInput("answers are added to a single file")
    (path,) = options.files
    if path.exists():
        read_study(path)  # before anyone is asked
    now = datetime.now(UTC).isoformat(timespec="seconds")
    if options.answers:
        new = [read_answers_file(file, now) for file in options.answers]
    else:
        new = [ask(options.participant, options.setting, now, input)]
    study = add_to_study(path, lambda study: study.answers.extend(new))
    print(f"{path}: {len(study.answers)} answered questionnaires")


def show(options: StudyOptions) -> None:
    """Print the comparison; write the participants' means."""
    from display.study.study_file import Study, compare_study, overview, read_study, table, write_csv

    studies = [read_study(file) for file in options.files]
    study = Study([t for s in studies for t in s.trials], [a for s in studies for a in s.answers])
    rows = compare_study(study)
    print(overview(study))
    for line in table(rows):
        print(line)
    if options.out:
        write_csv(options.out, rows)
        print(f"wrote {options.out}", file=sys.stderr)
