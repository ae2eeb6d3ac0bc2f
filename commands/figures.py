"""`vrgs.py figures`: the paper's figures and tables as one page."""

from __future__ import annotations

import argparse
from pathlib import Path

from commands.options import add_arch
from core.errors import BadInput
from core.runtime import start_taichi

HELP = "make the paper's figures and tables: one page with pictures and numbers"
EXAMPLES = ("figures --out figures", "figures --out /tmp/figures --quick")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    text = "folder for figures.html, which holds all pictures, and figures.json, the numbers"
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help=text)
    text = "the figure of inpainting: a capture with the truth behind its objects (python -m studio --capture DIR)"
    parser.add_argument("--capture", type=Path, metavar="DIR", help=text)
    parser.add_argument("--quick", action="store_true", help="small pictures, one demo, one toy: two minutes")
    add_arch(parser)


def run(args: argparse.Namespace) -> None:
    """Make the page. Raises BadInput."""
    if args.out.exists() and not args.out.is_dir():
        raise BadInput(f"{args.out}: is a file, not a folder")
    if args.capture is not None and not args.capture.is_dir():
        raise BadInput(f"{args.capture}: no such folder")
    start_taichi(args.arch)
    from bench.paper_figures import run as make

    make(args)
