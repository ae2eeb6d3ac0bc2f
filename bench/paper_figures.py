"""`vrgs.py figures`: the paper's figures and tables (VR-GS: Jiang et al. 2024), made and measured here, as one page.

Embedding with one level and with two, shadows on and off, a bar under twist beside theory, the solvers, and a picture
of each demo. The page holds all pictures; a JSON file beside it holds the numbers.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from assets.file_access import atomic_write_all, check_writable, make_folder
from bench.embedding_ablation import DEFORMATIONS, SCHEMES, arch, measure_ablation, prepared
from bench.html_page import Section, Table, html_page
from bench.twist import HEIGHTS, MATERIAL, TwistedBar, quarter_period
from core.camera import look_at, perspective
from display.picture import pixels_of
from display.protocol import Frame
from display.run_stats import plain, run_stats
from display.world import World
from scenes import registry
from scenes.paper_demos import PAPER_DEMOS

FRAME = 1 / 60  # [s]
DARKENED = 0.02  # of the full brightness: pixels that lose more count as in shadow
UNKNOWN = "–"
DEVICES = {"cuda": "a CUDA GPU"}
MARGIN = 14  # [px] of background around what a picture shows


@dataclass(frozen=True)
class Effort:
    """Amount that is played and drawn.

    deformations  of the embedding's ablation
    turn          of the bar [rad], and small_turn: the one that is compared with the theory of small angles
    seconds       of twisting, holding and swinging
    demo_seconds  that a demo is played before its picture is taken; `demos` how many demos (None: all)
    size          of the demos' pictures [px]
    """

    deformations: tuple[str, ...]
    turn: float
    small_turn: float
    seconds: tuple[float, float, float]
    demo_seconds: float
    demos: int | None
    size: tuple[int, int]


FULL = Effort(tuple(DEFORMATIONS), np.pi, 0.35, (1.5, 1.0, 2.5), 2.0, None, (560, 315))
QUICK = Effort(("180 degrees",), 0.5 * np.pi, 0.35, (0.3, 0.1, 0.6), 0.1, 1, (160, 90))


def run(args, inpainting: Callable[[dict, Callable[[str], None]], Section]) -> None:
    """Run the command: make all figures, writing the page and its numbers after each. Raises BadInput.

    inpainting  makes the figure of that, from the dictionary that takes its numbers and a function that takes lines
    """
    effort = QUICK if args.quick else FULL
    make_folder(args.out)
    page, numbers = args.out / "figures.html", args.out / "figures.json"
    for file in (page, numbers):
        check_writable(file)
    bar = prepared("bar")[1]
    results: dict = {"arch": arch(), "quick": args.quick}
    figures: list[tuple[str, Callable[[], Section]]] = [
        ("two-level and one-level embedding", lambda: embedding_section(bar, effort, results)),
        ("shadow", lambda: shadow_section(effort, results)),
        ("twist", lambda: twist_section(bar, effort, results)),
        ("solvers", lambda: solver_section(bar, effort, results)),
        ("inpainting", lambda: inpainting(results, _told)),
        ("demos", lambda: demo_pictures(effort, results, _told)),
    ]
    how = f"{DEVICES.get(arch(), 'the CPU')}{', quickly, at small sizes' if args.quick else ''}"
    sections: list[Section] = []
    for k, (what, make) in enumerate(figures, 1):
        print(f"[{k}/{len(figures)}] {what}", file=sys.stderr, flush=True)
        sections.append(make())
        still = "" if k == len(figures) else f" Not finished: {k} of {len(figures)} figures."
        text = f"Made by vrgs.py figures on {how}.{still} {PAPER}"
        with atomic_write_all(page, numbers) as (page_part, numbers_part):
            page_part.write_text(html_page("VR-GS: figures and tables", text, sections), encoding="utf-8")
            numbers_part.write_text(json.dumps(plain(results), indent=1) + "\n", encoding="utf-8")
    print(f"wrote {page} and {numbers}", file=sys.stderr)


PAPER = (
    "The paper is VR-GS: A Physical Dynamics-Aware Interactive Gaussian Splatting System in Virtual Reality "
    "(SIGGRAPH 2024, arXiv:2401.16663); what is quoted from it was measured by its authors on an RTX 4090."
)


def _told(text: str) -> None:
    """Print a line of a figure in the making."""
    print(f"      {text}", file=sys.stderr, flush=True)


def embedding_section(bar, effort: Effort, results: dict) -> Section:
    """The ablation of the embedding: spikes where a Gaussian follows one coarse tet alone."""
    rows, pictures, table = [], {}, []
    for title in effort.deformations:
        for scheme in SCHEMES:
            row, picture = measure_ablation("bar", bar, title, scheme, draw=True)
            rows.append(row)
            pictures[f"{title}, {scheme}"] = picture
            figures = (f"{row['spikes']:.2%}", f"{row['error']:.3f}", f"{row['jump']:.3f}")
            table.append((title, scheme, *figures))
    results["embedding"] = rows
    return Section(
        "Two-level and one-level embedding",
        "A striped bar in a coarse cage is twisted and stretched by formula. One-level: a Gaussian takes the gradient "
        "of the tetrahedron that holds its centre. Two-level: that of its own local tetrahedron, whose corners are "
        "embedded in the cage one by one (Sec. 4.3.2).",
        cropped(pictures),
        Table(("deformation", "embedding", "spikes", "error, 95%", "jump between neighbours, 95%"), table),
        "Spikes: Gaussians more than twice as elongated as they should be. Error: of the covariance, relative to that "
        "of the formula. Jump: of the error, from one Gaussian to the next.",
    )


def twist_section(bar, effort: Effort, results: dict) -> Section:
    """A bar twisted, held and let go."""
    found = TwistedBar(bar).twist(effort.turn, effort.seconds, "auto", draw=True)
    results["twist"] = {k: v for k, v in asdict(found).items() if k != "pictures"} | {"turn": effort.turn}
    rows = [
        (f"angle at {h:.0%} of the height, while held", f"{h:.3f}", f"{a:.3f}")
        for h, a in zip(HEIGHTS, found.angles, strict=True)
    ]
    rows.append(("volume while held, over that at rest", UNKNOWN, f"{found.volume:.3f}"))
    rows.append(("angle left at the end, over the whole", "0 when at rest", f"{found.left:.3f}"))
    return Section(
        "Deformation under twist",
        f"The upper end of a bar of soft silicone is turned by {np.degrees(effort.turn):.0f}° in "
        f"{effort.seconds[0]:g} s, held for {effort.seconds[1]:g} s and let go; the lower end is clamped. Simulated.",
        cropped(found.pictures),
        Table(("", "theory", "measured"), rows),
        "Angles are relative to that of the upper clamp: by theory they grow linearly between the clamps.",
    )


def solver_section(bar, effort: Effort, results: dict) -> Section:
    """Both solvers on the swing of a bar, and what is known of others."""
    rows, twisted = [], TwistedBar(bar)
    for name, method in (("xpbd", "XPBD"), ("vbd", "vertex block descent")):
        found = twisted.twist(effort.small_turn, effort.seconds, name, draw=False)
        measured, theory = found.frequency
        results[f"solver_{name}"] = {k: v for k, v in asdict(found).items() if k != "pictures"}
        error = f"{measured:.2f} Hz ({measured / theory - 1:+.1%})" if np.isfinite(measured) else UNKNOWN
        sizes = f"{len(bar.cage.vertices):,}"
        steps = f"{found.substeps} of {1e3 * found.dt:.2f} ms, {iterations(found.iterations)}"
        rows.append((f"here: {method}", "tetrahedral cage", sizes, steps, f"{found.frame_ms:.2f} ms", error))
    for demo in PAPER_DEMOS:
        name, sizes = f"VR-GS, {demo.name.replace('_', ' ')}: XPBD", f"{demo.vertices:,}"
        steps, took = iterations(demo.iterations), f"{1e3 / demo.fps:.1f} ms*"
        rows.append((name, "tetrahedral cage", sizes, steps, took, UNKNOWN))
    for name in ("PhysGaussian: material point method", "PAC-NeRF: material point method"):
        carrier = "Gaussians as particles" if name.startswith("Phys") else "particles of a voxel radiance field"
        rows.append((name, carrier, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN))
    theory = 1 / (4 * quarter_period(twisted))
    results["torsion_frequency_theory"] = theory
    return Section(
        "Solvers",
        f"A bar of {MATERIAL.young / 1e3:.0f} kPa is twisted by {np.degrees(effort.small_turn):.0f}° and let go. "
        f"Theory of slender bars has it swing at {theory:.2f} Hz.",
        {},
        Table(("method", "what is simulated", "vertices", "substeps a frame of 1/60 s", "time a frame", "swing"), rows),
        "*: with the picture. The theory neglects that the clamp holds the section's warping, which stiffens a short "
        "bar, as coarse linear tetrahedra do. VR-GS: the paper's table of demos. PhysGaussian (arXiv:2311.12198) and "
        "PAC-NeRF (arXiv:2303.05512): what they simulate, by their authors. The paper's times for these two are not "
        "known here, so none are given.",
    )


def iterations(count: int) -> str:
    """A number of iterations in words."""
    return f"{count} iteration{'' if count == 1 else 's'}"


def cropped(pictures: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Pictures (H, W, 3) of one size without the columns at both sides that show in all of them the background only."""
    shown = np.any([np.ptp(p.reshape(len(p), -1, 3).astype(int), axis=0).max(axis=1) > 8 for p in pictures.values()], 0)
    first, last = (np.flatnonzero(shown)[[0, -1]] if shown.any() else (0, len(shown))) + np.array([-MARGIN, MARGIN + 1])
    return {name: p[:, max(first, 0) : last] for name, p in pictures.items()}


def shadow_section(effort: Effort, results: dict) -> Section:
    """One view with shadows and without."""
    world = played("just_dance", {}, effort.demo_seconds, effort.size)
    with_shadow = pixels_of(world.picture)[..., :3].copy()
    world.device.splats.visibility.fill(1.0)
    world.device.renderer.render([camera_of(world.scene, effort.size)])
    without = pixels_of(world.picture)[..., :3].copy()
    loss = (without.astype(float) - with_shadow).mean(2) / 255
    dark = loss > DARKENED
    darker = float(1 - with_shadow[dark].mean() / without[dark].mean()) if dark.any() else 0.0
    took = run_stats(world, 1)["stages"]["shadow"]["median_ms"]
    results["shadow"] = {"pixels": float(dark.mean()), "darker": darker, "median_ms": took}
    return Section(
        "Shadows",
        "The dance with the shadow map and without. Baked shadows stay as they were trained; the map darkens what lies "
        "behind a body, seen from the light (Sec. 4.4).",
        {"with shadows": with_shadow, "without": without},
        Table(
            ("", "measured"),
            [("pixels in shadow", f"{dark.mean():.1%}"), ("darker there by", f"{darker:.0%}"),
             ("time of the shadow map, each frame", f"{took:.2f} ms")],
        ),
    )  # fmt: skip


def demo_pictures(effort: Effort, results: dict, report: Callable[[str], None]) -> Section:
    """A picture of each demo, after its scripted player has played for a while."""
    there = registry.names()
    demos = [(d.name, d.scene, d.options, d) for d in PAPER_DEMOS if d.scene in there]
    demos += [(name, name, {}, None) for name in there if name not in {scene for _, scene, _, _ in demos}]
    pictures, rows, results["demos"] = {}, [], {}
    for name, scene, options, paper in demos[: effort.demos]:
        report(name.replace("_", " "))
        world = played(scene, options, effort.demo_seconds, effort.size)
        stats, title = world.stats(), name.replace("_", " ")
        pictures[title] = pixels_of(world.picture)[..., :3].copy()
        results["demos"][name] = {k: stats[k] for k in ("gaussians", "vertices", "tets", "substeps", "integrator")}
        theirs = (f"{paper.gaussians / 1e6:.3f} M", f"{paper.vertices:,}") if paper else (UNKNOWN, UNKNOWN)
        rows.append((title, f"{stats['gaussians'] / 1e6:.3f} M", f"{stats['vertices']:,}", *theirs))
    return Section(
        "Demos",
        f"Each demo after {effort.demo_seconds:g} s of its scripted play, with the shipped assets.",
        pictures,
        Table(("demo", "Gaussians", "cage vertices", "Gaussians of the paper", "cage vertices of the paper"), rows),
        "vrgs.py build --detail paper makes the demos at the paper's sizes, vrgs.py bench demos measures them.",
    )


def played(scene: str, options: dict, seconds: float, size: tuple[int, int]) -> World:
    """The world of a demo after so many seconds of its scripted play, with its picture."""
    world = World(registry.load(scene, **options), width=size[0], height=size[1])
    camera, frames = camera_of(world.scene, size), max(round(seconds / FRAME), 2)
    render, world.device.render = world.device.render, lambda cameras: None
    for k in range(frames):
        if k == frames - 1:
            world.device.render = render
        time = (k + 1) * FRAME
        world.step(Frame(FRAME, time, [camera], world.scripted_hands(time)))
    return world


def camera_of(scene, size: tuple[int, int]):
    """The camera of a scene's player."""
    return perspective(*size, scene.fov_y, look_at(np.array(scene.eye), np.array(scene.target)))
