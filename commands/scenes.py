"""`vrgs.py scenes`: list the demos."""

from __future__ import annotations

import argparse

HELP = "list the demos and their options"
EXAMPLES = ("scenes",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This command takes no arguments."""


def run(args: argparse.Namespace) -> None:
    """Print each scene's name, what it is and its options, or why it cannot be played."""
    from scenes import registry

    for demo in registry.demos():
        print(f"{demo.name:16} {demo.summary if demo.build else f'cannot be played: {demo.fault}'}")
        for option in demo.options:
            print(f"{'':16} {option.flag}: {option.choice_text}")
