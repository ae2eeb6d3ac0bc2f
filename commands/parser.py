"""The command line's parser: each command is a module of this package with HELP, EXAMPLES, add_arguments and run."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Callable

from commands import (
    bench,
    build,
    convert,
    figures,
    materials,
    physics_check,
    play,
    prepare,
    render,
    scenes,
    study,
    tune,
    view,
)
from core.errors import BadInput

COMMANDS = {
    "scenes": scenes,
    "view": view,
    "render": render,
    "prepare": prepare,
    "convert": convert,
    "bench": bench,
    "figures": figures,
    "build": build,
    "tune": tune,
    "materials": materials,
    "check": physics_check,
    "study": study,
}


def build_parser(summary: str, run_play: Callable[[argparse.Namespace], None]) -> argparse.ArgumentParser:
    """The parser of all commands; `run_play` runs without one."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="vrgs.py", description=summary, epilog=play.EXAMPLES, formatter_class=formatter
    )
    parser.set_defaults(run=run_play)
    play.add_arguments(parser)
    commands = parser.add_subparsers(metavar="COMMAND", title="commands (vrgs.py COMMAND --help)")
    for name, module in COMMANDS.items():
        examples = "".join(f"\n  python vrgs.py {example}" for example in module.EXAMPLES)
        sub = commands.add_parser(
            name,
            help=module.HELP,
            description=module.HELP,
            epilog=f"example:{examples}",
            formatter_class=formatter,
        )
        sub.set_defaults(run=module.run)
        module.add_arguments(sub)
    return parser


def check_options(parser: argparse.ArgumentParser, argv: list[str]) -> None:
    """Raise BadInput for an option of playing that there is not: argparse would take what follows for a command."""
    known = parser._option_string_actions
    for text in argv:
        if text in COMMANDS:
            return
        flag = text.partition("=")[0]
        if flag.startswith("--") and not any(name.startswith(flag) for name in known):
            near = difflib.get_close_matches(flag, known, 1)
            raise BadInput(f"there is no option {flag}" + (f"; {near[0]}?" if near else "; see vrgs.py --help"))
