"""`vrgs.py bench scaling`: time of a picture against the number of Gaussians and of pixels.

Rooms of 0.1 to 10 million Gaussians, SH of degree 3, seen by two eyes of 1800 x 1920; and one room of 1.313 million in
a single picture of 0.5 to 16 megapixels. Medians of synchronous calls of `Renderer.render`. Output: a Markdown
table, a plot (--plot), rows (--json); --from draws table and plot of several devices from the rows that each wrote.
"""

from __future__ import annotations

import math
import os
from statistics import median

from assets.file_access import atomic_write, check_writable
from bench.plot import Panel, svg
from core.errors import BadInput
from display.run_stats import read_rows, write_stats

MILLIONS = (0.1, 0.3, 1.0, 3.0, 10.0)  # Gaussians
EYE_SIZE = (1800, 1920)  # [px]
MEGAPIXELS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
ROOM_GAUSSIANS = 1_313_000  # in the sweep over pixels
SECONDS = 12.0  # for a row: a slow device draws fewer pictures than --rounds, but at least three
SCALING_WARM_PICTURES = 2  # uncounted pictures: the first compiles and determines the capacity
# Panel title, axis label and axis ticks of each sweep
SWEEPS = {
    "gaussians": (f"Two eyes of {EYE_SIZE[0]}×{EYE_SIZE[1]}", "million Gaussians", MILLIONS),
    "pixels": (f"{ROOM_GAUSSIANS / 1e6:g} million Gaussians, one picture", "megapixels", MEGAPIXELS),
}


def run(args) -> None:
    """Run the command: measure, or read measurements; print the tables, write --json and --plot. Raises BadInput."""
    if args.plot and args.plot.suffix.lower() != ".svg":
        raise BadInput(f"{args.plot}: the plot's name must end in .svg")
    for out in (args.json, args.plot):
        if out:
            check_writable(out)
    rows = (
        [row for path in args.earlier for row in read_rows(path, "scaling", is_row)]
        if args.earlier
        else measure_all(args.rounds)
    )
    print(tables(rows))
    if args.json:
        write_stats(args.json, rows)
    if args.plot:
        with atomic_write(args.plot) as beside:
            beside.write_text(svg(panels(rows)), encoding="utf-8")


def measure_all(rounds: int) -> list[dict]:
    """All rows of this device, in the order of `SWEEPS`."""
    from bench.synthetic_room import room
    from render.splats import Splats

    rows, device = [], device_name()

    def add(**row) -> None:
        rows.append({"bench": "scaling", "device": device, **row})
        print(
            f"{row['gaussians'] / 1e6:8.3f}M {row['width']:5}x{row['height']:<5} {row['median_ms']:10.2f} ms",
            flush=True,
        )

    for million in MILLIONS:
        count = round(1e6 * million)
        splats = Splats(room(count))
        add(by="gaussians", x=million, gaussians=count, **measure(splats, [EYE_SIZE], 2, rounds)[0])
        splats.destroy()
    splats = Splats(room(ROOM_GAUSSIANS))
    for megapixels, row in zip(MEGAPIXELS, measure(splats, map(sides, MEGAPIXELS), 1, rounds), strict=True):
        add(by="pixels", x=megapixels, gaussians=ROOM_GAUSSIANS, **row)
    splats.destroy()
    return rows


def sides(megapixels: float) -> tuple[int, int]:
    """Width and height [px] of a 4:3 picture, not necessarily multiples of a tile."""
    width = round((1e6 * megapixels * 4 / 3) ** 0.5)
    return width, round(1e6 * megapixels / width)


def measure(splats, sizes, views: int, rounds: int) -> list[dict]:
    """One row for each size (width, height), with one renderer: a new size compiles nothing."""
    import taichi as ti

    from bench.render_speed import times
    from render.renderer import Renderer

    renderer, rows = None, []
    for width, height in sizes:
        if renderer is None:
            renderer = Renderer(splats, width, height, views=views)
        else:
            renderer.resize(width, height)
        draw = renderer.render
        took = times(
            lambda eyes, draw=draw: draw(eyes[:views]),
            ti.sync,
            width,
            height,
            rounds,
            warm=SCALING_WARM_PICTURES,
            most=SECONDS,
        )
        pairs = renderer.rasterizer.pairs
        if pairs > renderer.rasterizer.pair_capacity:
            raise BadInput(f"{pairs} pairs of tile and Gaussian did not fit: a picture of {width}x{height} lacks some")
        row = {"width": width, "height": height, "views": views, "pairs": pairs, "rounds": len(took)}
        rows.append({**row, "median_ms": 1e3 * median(took), "best_ms": 1e3 * min(took)})
    renderer.destroy()
    return rows


def device_name() -> str:
    """Name of the GPU, or the number of CPU cores that this process may use."""
    import taichi as ti

    if ti.cfg.arch != ti.cuda:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        return f"{cores} CPU cores"
    import ctypes

    try:
        cuda = ctypes.CDLL("nvcuda.dll" if os.name == "nt" else "libcuda.so.1")
    except OSError:
        return "CUDA"
    name, device = ctypes.create_string_buffer(256), ctypes.c_int()
    if cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(device), 0) or cuda.cuDeviceGetName(name, 256, device):
        return "CUDA"
    return name.value.decode(errors="replace")


def is_row(row) -> bool:
    """Check that a row has all plotted entries and that its numbers are positive, as logarithmic axes require."""
    if row.get("by") not in SWEEPS:
        return False
    numbers = [row.get(name) for name in ("x", "median_ms", "pairs")]
    return isinstance(row.get("device"), str) and all(type(n) in (int, float) and 1e-9 < n < 1e15 for n in numbers)


def tables(rows: list[dict]) -> str:
    """Two Markdown tables, a column for each device: median ms (million pairs of tile and Gaussian)."""
    lines = []
    for by, (title, label, _) in SWEEPS.items():
        mine = [row for row in rows if row["by"] == by]
        if not mine:
            continue
        devices = list(dict.fromkeys(row["device"] for row in mine))
        found = {(row["x"], row["device"]): f"{short(row['median_ms'])} ({row['pairs'] / 1e6:.1f})" for row in mine}
        lines += [f"{title}: median ms (million pairs)", ""]
        lines += [f"| {label} | {' | '.join(devices)} |", f"| --- |{' --- |' * len(devices)}"]
        for x in sorted({row["x"] for row in mine}):
            lines.append(f"| {x:g} | {' | '.join(found.get((x, device), '–') for device in devices)} |")
        lines.append("")
    return "\n".join(lines)


def short(x: float) -> str:
    """Text with three significant digits: 0.0123, 4.56, 1,230."""
    digits = 2 - math.floor(math.log10(x))
    return f"{round(x, digits):,.{max(digits, 0)}f}"


def panels(rows: list[dict]) -> list[Panel]:
    """Panels of the plot."""
    result = []
    for by, (title, label, ticks) in SWEEPS.items():
        curves: dict[str, list] = {}
        for row in rows:
            if row["by"] == by:
                curves.setdefault(row["device"], []).append((row["x"], row["median_ms"]))
        if curves:
            xs = {x for curve in curves.values() for x, _ in curve}
            result.append(Panel(title, label, "milliseconds", curves, tuple(sorted({*ticks, *xs}))))
    return result
