"""`vrgs.py materials`: list the materials by name."""

from __future__ import annotations

import argparse

from core.material import MATERIALS

HELP = "list the materials by name"
EXAMPLES = ("materials",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This command takes no arguments."""


def run(args: argparse.Namespace) -> None:
    """Print a line for each material."""
    print(f"{'':8} {'young [Pa]':>10} {'poisson':>8} {'density [kg/m^3]':>17} {'friction':>9} {'sliding':>8}")
    for name, m in MATERIALS.items():
        print(f"{name:8} {m.young:10.0e} {m.poisson:8} {m.density:17} {m.friction:9} {m.sliding_friction:8}")
