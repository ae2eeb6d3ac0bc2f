"""`vrgs.py check`: the physics table, each row with its reference, measured value, tolerance and verdict.

A measurement is a function of bench/physics.py or bench/physics_contact.py that uses the public Solver. The quick form
runs fewer substeps, throws and seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from time import perf_counter

from assets.file_access import check_writable, write_json
from bench import physics, physics_contact

HEAD = ("check", "reference", "measured", "tolerance", "verdict")
KEYS = ("check", "relation", *HEAD[1:4], "pass")  # of a row in the JSON file
VERDICTS = {True: "pass", False: "FAIL", None: "-"}


MEASUREMENTS: tuple[Callable[..., list[dict]], ...] = (
    physics.free_fall,
    physics.statics,
    physics.vibration,
    physics.decay,
    physics.swings,
    physics.spinning_bar,
    physics.recovery,
    physics.energy_kept,
    physics.plastic_flow,
    physics_contact.rigid_bodies,
    physics_contact.momentum_kept,
    physics_contact.ring_throws,
    physics_contact.pile_at_rest,
    physics.cuda_and_cpu,
)
QUICK = {  # arguments of their quick form
    physics.swings: {"seconds": 0.25, "step": 1 / 20_000},
    physics.energy_kept: {"substeps": 50_000, "vbd_substeps": 20_000},
    physics_contact.momentum_kept: {"stiffnesses": (("vbd", 1e6), ("vbd", 1e8), ("xpbd", 1e6))},
    physics_contact.ring_throws: {"count": 15, "seconds": 0.5},
    physics_contact.pile_at_rest: {"seconds": 5.0},
}


def run(*, quick: bool, json: Path | None) -> int:
    """Run the command; returns the exit status, 1 if a row fails."""
    if json:
        check_writable(json)  # fail before minutes are spent
    begin = perf_counter()
    rows = list(show(measured(MEASUREMENTS, quick=quick)))
    if json:
        write_json(json, [{key: r[key] for key in KEYS} for r in rows])
    failed = [r for r in rows if r["pass"] is False]
    open_ = sum(r["pass"] is None for r in rows)
    passed = len(rows) - len(failed) - open_
    text = f"{passed} of {len(rows)} rows pass" + (f", {open_} without verdict" if open_ else "")
    print(f"{text}; {perf_counter() - begin:.0f} s")
    return 1 if failed else 0


def measured(measurements: Iterable[Callable[..., list[dict]]], *, quick: bool) -> Iterator[dict]:
    """Yield rows as they are measured."""
    for measure in measurements:
        arguments = QUICK.get(measure, {}) if quick else {}
        yield from measure(**arguments)


def show(rows: Iterable[dict], out=None) -> Iterator[dict]:
    """Pass rows through, printing each as a line of an aligned table."""
    print(line(*HEAD), file=out, flush=True)
    for r in rows:
        numbers = ["-" if r[key] is None else f"{r[key]:.6g}" for key in HEAD[1:4]]
        if r["relation"] != "=":
            numbers[0], numbers[2] = f"{r['relation']} {numbers[0]}", "-"
        note = f"  {r['note']}" if "note" in r else ""
        print(line(r["check"], *numbers, VERDICTS[r["pass"]]) + note, file=out, flush=True)
        yield r


def line(check: str, reference: str, measured: str, tolerance: str, verdict: str) -> str:
    """One aligned line of the table."""
    return f"{check:50} {reference:>12} {measured:>12} {tolerance:>10}  {verdict}"
