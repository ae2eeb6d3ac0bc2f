"""From a command line to a command's function and its options.

Options may stand before or after a command; mistakes are told in one line, with the nearest option or command.
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import itertools
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from pathlib import Path

from commands.options import Options, add_options
from core.errors import BadInput
from core.program import VERSION, as_called

SUMMARY = "VR-GS: captures as Gaussians that can be grabbed, squeezed and thrown."
COMMANDS = {  # module and function, which takes the command's options as their dataclass; only what runs is imported
    "scenes": ("commands.listing:list_scenes", "list the demos and their options"),
    "view": ("commands.viewing:view", "look at splat files in a window"),
    "render": ("commands.viewing:render", "draw a splat file, or film a turn around it"),
    "train": ("commands.train:train", "train Gaussians on photographs or a video"),
    "capture": ("commands.capture_room:capture", "turn photographs into a room to play in, with objects to grab"),
    "prepare": ("commands.prepare:prepare", "make an elastic body of a splat, or a room to play in"),
    "segment": ("commands.segment:segment", "find marked objects in all photographs, or take them out of a splat"),
    "inpaint": ("commands.inpaint:inpaint", "remove an object from a splat and fill the hole that it leaves"),
    "convert": ("commands.export:convert", "convert between splat formats"),
    "export": ("commands.export:export", "write a played scene: splats, cages or surfaces, one frame or a sequence"),
    "bench": ("commands.measuring:bench", "measure speed and quality"),
    "figures": ("commands.measuring:figures", "make the paper's figures and tables, on one page"),
    "fit": ("commands.fit:fit", "find the material of a real thing from a video of it, or from markers"),
    "tune": ("commands.measuring:tune", "drop a body with a range of stiffnesses, and compare the results"),
    "materials": ("commands.listing:list_materials", "list the materials by name"),
    "check": ("commands.measuring:check", "measure the physics against theory and finite elements"),
    "study": ("commands.study:study", "compare participants in the settings physics and transform; questionnaire"),
}


class Parser(argparse.ArgumentParser):
    """A parser that raises BadInput with what is wrong in one line, instead of printing the usage."""

    def format_usage(self) -> str:
        return as_called(super().format_usage())

    def format_help(self) -> str:
        return as_called(super().format_help())

    def error(self, message: str) -> None:
        """Raise BadInput."""
        raise BadInput(f"{message}; see {self.prog} --help")


def parse(argv: Sequence[str]) -> tuple[Callable[[Options], int | None] | None, Options]:
    """The function of the command that a command line names, None to play, and its options. Raises BadInput.

    Options before a command are those of the command, and must be known to it.
    """
    argv = list(argv)
    for i in range(len(argv) - 2, -1, -1):  # argparse would take the -y of `--up -y` for an option
        if argv[i] == "--up" and argv[i + 1] in ("-x", "-y", "-z"):
            argv[i : i + 2] = [f"--up={argv[i + 1]}"]
    at = 0 if argv and argv[0] in COMMANDS else command_position(playing_parser(argv), argv)
    name = None if at is None else argv.pop(at)
    parser = playing_parser(argv) if name is None else command_parser(name, argv)
    given = given_flags(parser, argv, name)
    function, kind = (None, playing_options()) if name is None else command(name)
    several = any(action.nargs in ("+", "*") for action in parser._get_positional_actions())
    read = parser.parse_known_intermixed_args if several else parser.parse_known_args
    values, unknown = read(argv)
    if unknown:
        raise BadInput(f"unexpected argument {' '.join(unknown)}; see {parser.prog} --help")
    options = kind(**vars(values), given=given)
    options.check()
    return function, options


def command(name: str) -> tuple[Callable, type[Options]]:
    """The function of a command, and the dataclass of its options."""
    place, function = COMMANDS[name][0].split(":")
    module = importlib.import_module(place)
    run = getattr(module, function)
    return run, getattr(module, run.__annotations__["options"])


def playing_options() -> type[Options]:
    """The dataclass of the options without a command."""
    from commands.play_options import PlayOptions

    return PlayOptions


def playing_parser(argv: Sequence[str] = ("--help",)) -> Parser:
    """The parser of what is played without a command, whose help lists the commands."""
    kind = playing_options()
    commands = "\n".join(f"  {name:10} {help}" for name, (_, help) in COMMANDS.items())
    top = f"{SUMMARY}\n\ncommands (vrgs.py COMMAND --help):\n{commands}\n\n{examples_text('examples:', kind.EXAMPLES)}"
    parser = new_parser("vrgs.py", top)
    parser.usage = "vrgs.py [COMMAND] [options]"
    parser.add_argument("--version", action="version", version=f"vrgs {VERSION}")
    add_all_options(parser, kind, argv)
    return parser


def command_parser(name: str, argv: Sequence[str] = ("--help",)) -> Parser:
    """The parser of a command."""
    kind = command(name)[1]
    parser = new_parser(f"vrgs.py {name}", COMMANDS[name][1], examples_text("example:", kind.EXAMPLES))
    add_all_options(parser, kind, argv)
    return parser


def examples_text(title: str, examples: Iterable[str]) -> str:
    """Examples under a title, a line each; `examples`: what follows `vrgs.py`."""
    return title + "".join(f"\n  python vrgs.py {example}".rstrip() for example in examples)


def new_parser(program: str, top: str, end: str = "") -> Parser:
    """A parser without options; `top` and `end` are the texts of the help before and after them."""
    formatter = argparse.RawDescriptionHelpFormatter
    return Parser(prog=as_called(program), description=top, epilog=end, formatter_class=formatter)


def add_all_options(parser: Parser, kind: type[Options], argv: Sequence[str]) -> None:
    """Add the options of a dataclass, and where it has a field `options`, those of scenes if a command line needs them.

    All scenes are imported to know them, so they are added only for the help, or if a flag is not known without them.
    """
    add_options(parser, kind)
    if any(field.name == "options" for field in fields(kind)):
        flags = [word for word in argv if word.startswith("-")]
        if {"-h", "--help"} & {*flags} or any(named_option(parser, word) is None for word in flags):
            add_scene_options(parser, scene_file_in(argv))


def add_scene_options(parser: Parser, scene_file: str | None) -> None:
    """Add the options of all scenes and of a scene file, which is run; their values become the dict `options`."""
    from scenes import registry

    takers: dict[str, list[tuple[str, registry.SceneOption]]] = {}
    for demo in registry.demos():
        for option in demo.options:
            takers.setdefault(option.name, []).append((demo.name, option))
    group = parser.add_argument_group("options of scenes")
    for name, uses in takers.items():
        says = "; ".join(f"{scene}: {option.choice_text}" for scene, option in uses)
        try:
            group.add_argument(uses[0][1].flag, dest=name, action=SetSceneOption, metavar="X", help=says)
        except argparse.ArgumentError:
            scenes = ", ".join(scene for scene, _ in uses)
            print(f"vrgs: {scenes}: {uses[0][1].flag} already has another meaning; rename it", file=sys.stderr)
    own = None if scene_file is None else registry.demo(scene_file)
    for option in () if own is None else own.options:
        if option.flag not in parser._option_string_actions:  # else other scenes have it as well
            says = option.choice_text
            parser.add_argument(option.flag, dest=option.name, action=SetSceneOption, metavar="X", help=says)


class SetSceneOption(argparse.Action):
    """Keep the text of a scene's option in the dict `options`."""

    def __init__(self, option_strings, dest, **form):
        super().__init__(option_strings, dest, default=argparse.SUPPRESS, **form)

    def __call__(self, parser, namespace, values, option_string=None):
        namespace.options = {**getattr(namespace, "options", {}), self.dest: values}


def scene_file_in(argv: Sequence[str]) -> str | None:
    """The scene file that a command line names, whose options it may set; None if there is none."""
    pairs = itertools.zip_longest(argv, argv[1:], fillvalue="")
    values = (word.partition("=")[2] or after for word, after in pairs if word.partition("=")[0] == "--scene")
    return next((value for value in values if value.endswith(".py")), None)


def command_position(parser: Parser, argv: list[str]) -> int | None:
    """Index of the command: the first word that is neither an option nor an option's value; None if there is none.

    Raises BadInput if that word is no command.
    """
    for k, (before, word) in enumerate(zip(["", *argv], argv, strict=False)):
        if word.startswith("-") and word != "-":
            continue
        takes_value = before.startswith("-") and "=" not in before
        option = named_option(parser, before) if takes_value else None
        if takes_value and (option is None or option.nargs == "?"):  # of a command perhaps, or without a value
            if word in COMMANDS:
                return k
        elif not takes_value or option.nargs == 0:
            if word not in COMMANDS:
                raise BadInput(no_command(word))
            return k
    return None


def given_flags(parser: Parser, argv: Iterable[str], command: str | None) -> tuple[str, ...]:
    """The flags that are given, in full. Raises BadInput for an unknown option."""
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
    """The message about an unknown option, with the nearest one."""
    flag = word.partition("=")[0]
    near = difflib.get_close_matches(flag, parser._option_string_actions, 1)
    unknown = f"unknown option {flag}" if command is None else f"{command} has no option {flag}"
    return unknown + (f"; did you mean {near[0]}?" if near else f"; see {parser.prog} --help")


def scene_names() -> list[str]:
    """Names of the demos that can be played."""
    from scenes.registry import names

    return names()


def no_command(word: str) -> str:
    """The message about a word that is no command, with the nearest one."""
    if Path(word).suffix:
        return f"{word} is no command; to see it: vrgs.py view {word}; to play: vrgs.py --scene sandbox --body {word}"
    if word == "build":
        return "build: the models of the shipped assets are built by python -m studio, from source"
    if word in scene_names():
        return f"{word} is a scene, no command: vrgs.py --scene {word}"
    near = difflib.get_close_matches(word, COMMANDS, 1)
    return f"unknown command {word}; " + (f"did you mean {near[0]}?" if near else "see vrgs.py --help")
