"""`vrgs.py check`: the physics table, every row with its reference, what was measured, the tolerance and a verdict.

Each measurement is a function beside this file that goes through the public Solver. The tests run the quick form,
a measurement a test; the full form runs the same ones longer.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from time import perf_counter

from bench import contact_rows, physics
from bench import device_agreement as devices
from display.headless.video import claim
from display.run_stats import write_stats

HEAD = ("check", "reference", "measured", "tolerance", "verdict")
KEYS = (*HEAD[:4], "pass")  # what the JSON holds
VERDICTS = {True: "pass", False: "FAIL", None: "skipped"}


@dataclass(frozen=True)
class Measurement:
    """One measurement of one or more rows, in the quick form and in the full one."""

    quick: Callable[[], list[dict]]
    full: Callable[[], list[dict]]
    name: str
    tested: str = "test_physics"  # the module of tests that runs the quick form


def both(function: Callable[[], list[dict]], quick: dict | None = None, tested: str = "test_physics") -> Measurement:
    """A measurement whose quick form differs by arguments only; by itself it takes those of the full one."""
    return Measurement(functools.partial(function, **quick or {}), function, function.__name__, tested)


MEASUREMENTS = (
    *map(both, physics.ALL),
    both(physics.long_run, quick={"substeps": 100_000}),
    both(contact_rows.rigid_bodies, tested="test_rigid"),
    both(contact_rows.ring_throws, quick={"count": 8, "around": 16, "seconds": 0.5}, tested="test_thin"),
    both(contact_rows.pile_at_rest, quick={"seconds": 5.0}, tested="test_piles"),
    both(devices.cuda_and_cpu),
)


def run(args) -> int:
    """The command; returns the exit status, 1 if a row fails."""
    if args.json:
        claim(args.json, args.json.with_name(f".{args.json.name}.part"))  # before minutes are spent
    begin = perf_counter()
    rows = list(show(measured(MEASUREMENTS, quick=args.quick)))
    if args.json:
        write_stats(args.json, [{key: r[key] for key in KEYS} for r in rows])
    failed = [r for r in rows if r["pass"] is False]
    skipped = sum(r["pass"] is None for r in rows)
    passed = len(rows) - len(failed) - skipped
    text = f"{passed} of {len(rows)} rows pass" + (f", {skipped} skipped" if skipped else "")
    print(f"{text}; {perf_counter() - begin:.0f} s")
    return 1 if failed else 0


def measured(measurements: Iterable[Measurement], *, quick: bool) -> Iterator[dict]:
    """The rows, as they are measured."""
    for m in measurements:
        yield from (m.quick if quick else m.full)()


def show(rows: Iterable[dict], out=None) -> Iterator[dict]:
    """Pass rows on, and print each as a line of an aligned table."""
    print(line(*HEAD), file=out, flush=True)
    for r in rows:
        numbers = ["-" if r[key] is None else f"{r[key]:.6g}" for key in HEAD[1:4]]
        note = f"  {r['note']}" if "note" in r else ""
        print(line(r["check"], *numbers, VERDICTS[r["pass"]]) + note, file=out, flush=True)
        yield r


def line(check: str, reference: str, measured: str, tolerance: str, verdict: str) -> str:
    return f"{check:50} {reference:>12} {measured:>12} {tolerance:>10}  {verdict}"
