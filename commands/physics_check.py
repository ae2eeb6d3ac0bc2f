"""`vrgs.py check`: measure the physics against theory and finite elements."""

from __future__ import annotations

import argparse
from pathlib import Path

from commands.options import add_arch
from core.runtime import start_taichi

HELP = "measure the physics against theory and finite elements"
EXAMPLES = ("check --quick --json table.json",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--quick", action="store_true", help="minutes, not hours: fewer substeps, throws and seconds")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the table")
    add_arch(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table; returns 1 if a row fails."""
    start_taichi(args.arch)
    from bench import check

    return check.run(args)
