"""The command line's parser: each command is a module of this package with HELP, EXAMPLES, add_arguments and run.

A module's CONDITIONS, if it has some, say which of its options act only beside others (commands/conditions.py).
"""

from __future__ import annotations

import argparse
import difflib
import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from commands import (
    bench,
    capture_room,
    convert,
    export,
    figures,
    inpaint,
    materials,
    physics_check,
    play,
    prepare,
    render,
    scenes,
    segment,
    study,
    train,
    tune,
    view,
)
from commands.conditions import check_conditions
from commands.options import add_scene_file_options
from core.errors import BadInput
from core.program import VERSION, as_called
from scenes.registry import is_scene_file

COMMANDS = {
    "scenes": scenes,
    "view": view,
    "render": render,
    "train": train,
    "capture": capture_room,
    "prepare": prepare,
    "segment": segment,
    "inpaint": inpaint,
    "convert": convert,
    "export": export,
    "bench": bench,
    "figures": figures,
    "tune": tune,
    "materials": materials,
    "check": physics_check,
    "study": study,
}


class Parser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line: raises BadInput instead of printing the usage. `commands` are the
    parsers of the commands by name."""

    commands: dict[str, Parser] = {}

    def format_usage(self) -> str:
        return as_called(super().format_usage())

    def format_help(self) -> str:
        return as_called(super().format_help())

    def error(self, message: str) -> None:
        """Raise BadInput."""
        raise BadInput(f"{message}; see {self.prog} --help")


def parse(argv: list[str], summary: str, run_play: Callable[[argparse.Namespace], None]) -> argparse.Namespace:
    """The arguments of a command line; `given` are the flags that it names. Raises BadInput.

    Options before a command are those of the command, and must be known to it.
    """
    parser = build_parser(summary, run_play)
    if (scene_file := scene_file_in(argv)) is not None:
        for taker in (parser, parser.commands["export"]):
            add_scene_file_options(taker, scene_file)
    at = command_position(parser, argv)
    name = None if at is None else argv[at]
    if name is not None:
        argv = [name, *argv[:at], *argv[at + 1 :]]
    where, module = (parser, play) if name is None else (parser.commands[name], COMMANDS[name])
    given = given_flags(where, argv, name)
    args, unknown = parser.parse_known_args(argv)
    if "names" in args and not any(word.startswith("-") for word in unknown):
        args.names, unknown = [*args.names, *unknown], []  # argparse takes those before the first option only
    if unknown:
        raise BadInput(f"{' '.join(unknown)}: is one too many; see {where.prog} --help")
    args.given = given
    check_conditions(args, given, getattr(module, "CONDITIONS", ()))
    return args


def scene_file_in(argv: Sequence[str]) -> str | None:
    """The scene file that a command line names, whose options it may set; None if there is none."""
    pairs = itertools.zip_longest(argv, argv[1:], fillvalue="")
    values = (word.partition("=")[2] or after for word, after in pairs if word.partition("=")[0] == "--scene")
    return next(filter(is_scene_file, values), None)


def build_parser(summary: str, run_play: Callable[[argparse.Namespace], None]) -> Parser:
    """The parser of all commands; `run_play` runs without one."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog=as_called("vrgs.py"), description=summary, epilog=play.EXAMPLES, formatter_class=formatter)
    parser.add_argument("--version", action="version", version=f"vrgs {VERSION}")
    parser.set_defaults(run=run_play)
    play.add_arguments(parser)
    commands = parser.add_subparsers(metavar="COMMAND", title="commands (vrgs.py COMMAND --help)")
    for name, module in COMMANDS.items():
        examples = "".join(f"\n  python vrgs.py {example}" for example in module.EXAMPLES)
        sub = commands.add_parser(
            name,
            prog=as_called(f"vrgs.py {name}"),
            help=module.HELP,
            description=module.HELP,
            epilog=f"example:{examples}",
            formatter_class=formatter,
        )
        sub.set_defaults(run=module.run)
        module.add_arguments(sub)
    parser.commands = commands.choices
    return parser


def command_position(parser: Parser, argv: list[str]) -> int | None:
    """Index of the command: the first word that is neither an option nor an option's value; None if there is none.

    Raises BadInput if that is no command, or follows an option that there is not.
    """
    k = 0
    while k < len(argv):
        word = argv[k]
        if word in COMMANDS:
            return k
        if not word.startswith("-") or word == "-":
            raise BadInput(no_command(word))
        option = named_option(parser, word)
        k += 1
        if option is None:
            if (before := next((i for i in range(k, len(argv)) if argv[i] in COMMANDS), None)) is not None:
                return before  # it may be an option of that command
            raise BadInput(no_option(word, parser, None))
        if "=" not in word and option.nargs != 0:
            least, most = {None: (1, 1), "?": (0, 1)}.get(option.nargs, (1, len(argv)))
            while most and k < len(argv) and (least or not (argv[k].startswith("-") or argv[k] in COMMANDS)):
                k, least, most = k + 1, max(0, least - 1), most - 1
    return None


def given_flags(parser: Parser, argv: Iterable[str], command: str | None) -> tuple[str, ...]:
    """The flags that are given, in full. Raises BadInput for an option that there is not."""
    found = []
    for word in argv:
        if word == "--":
            break
        if word.startswith("--"):
            option = named_option(parser, word)
            if option is None:
                raise BadInput(no_option(word, parser, command))
            found.append(max(option.option_strings, key=len))
    return tuple(found)


def named_option(parser: Parser, word: str) -> argparse.Action | None:
    """The option that a word names, or the first that it abbreviates; None if there is none."""
    flag, known = word.partition("=")[0], parser._option_string_actions
    if flag in known:
        return known[flag]
    return next((known[name] for name in known if flag.startswith("--") and name.startswith(flag)), None)


def no_option(word: str, parser: Parser, command: str | None) -> str:
    """The message about an option that there is not, with the nearest one."""
    flag = word.partition("=")[0]
    near = difflib.get_close_matches(flag, parser._option_string_actions, 1)
    whose = "there is no option" if command is None else f"{command} has no option"
    return f"{whose} {flag}" + (f"; {near[0]}?" if near else f"; see {parser.prog} --help")


def no_command(word: str) -> str:
    """The message about a word that is no command, with the nearest one."""
    if Path(word).suffix:
        return f"{word}: to look at it: vrgs.py view {word}; to play with it: vrgs.py --scene sandbox --body {word}"
    if word == "build":
        return "build: the models of the shipped assets are built by python -m studio, in the source"
    near = difflib.get_close_matches(word, COMMANDS, 1)
    return f"there is no command {word}; {near[0]}?" if near else f"there is no command {word}; see vrgs.py --help"
