"""`vrgs.py figures`: the paper's figures and tables (VR-GS: Jiang et al. 2024), made and measured here, as one page.

Embedding with one level and with two, shadows on and off, a bar under twist beside theory, the solvers, inpainted
objects, and a picture of each demo. The page holds all pictures; a JSON file beside it holds the numbers.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import cv2
import numpy as np

from assets.file_access import atomic_write_all, check_writable, make_folder
from assets.gaussians import Gaussians
from bench.bar_figures import (
    DEFORMATIONS,
    FRAME,
    HEIGHTS,
    MATERIAL,
    SCHEMES,
    WORST_SHOWN,
    TwistedBar,
    measure_ablation,
    quarter_period,
    striped_bar,
)
from core.camera import look_at, perspective
from core.errors import BadInput
from core.fields import destroy_fields
from core.report import Section, Table, html_page
from core.runtime import keep_compiled_kernels, running_arch
from core.typed import to_plain
from display.picture import pixels_of
from display.protocol import Frame
from display.timing import run_stats
from display.world import World
from prepare.blending_weights import BlendingWeights
from prepare.inpaint import inpaint_pipeline as pipeline
from prepare.inpaint.hole_patch import compare, cut_out, uncovered_psnr
from prepare.room_capture import room_pipeline
from prepare.segment.object_ids import background_around, identified, masks_of, trained_alone
from prepare.train.capture import View
from prepare.train.capture_files import read_capture
from prepare.train.photographs import OPAQUE, load_photograph, load_photographs, read_mask
from prepare.train.seeds import first_gaussians
from prepare.train.train_options import CAPS, TrainOptions
from prepare.train.trainer import Trainer
from scenes import registry
from scenes.paper_demos import PaperDemo, paper_demos

DARKENED = 0.02  # of the full brightness: pixels that lose more count as in shadow
UNKNOWN = "–"
SMALL_TURN = 0.35  # [rad] of the bar, as the theory of small angles holds for
SHADOWED = "just_dance"  # the demo that is shown without its shadows
MARGIN = 14  # [px] of background around what a picture shows


class Effort(NamedTuple):
    """Amount that is played and drawn."""

    deformations: tuple[str, ...]  # of the embedding's ablation
    turn: float  # of the bar [rad]
    seconds: tuple[float, float, float]  # of twisting, holding and swinging
    demo_seconds: float  # that a demo is played before its picture is taken
    demos: tuple[str, ...]  # names; empty: all
    size: tuple[int, int]  # of the demos' pictures [px]


FULL = Effort(
    deformations=tuple(DEFORMATIONS),
    turn=np.pi,
    seconds=(1.5, 1.0, 2.5),
    demo_seconds=2.0,
    demos=(),
    size=(560, 315),
)
QUICK = Effort(
    deformations=("180 degrees",),
    turn=0.5 * np.pi,
    seconds=(0.3, 0.1, 0.6),
    demo_seconds=0.1,
    demos=(SHADOWED,),
    size=(160, 90),
)


def run(*, out: Path, capture: Path | None, quick: bool) -> None:
    """Run the command: make all figures, writing the page and its numbers after each. Raises BadInput."""
    effort = QUICK if quick else FULL
    make_folder(out)
    page, numbers = out / "figures.html", out / "figures.json"
    for file in (page, numbers):
        check_writable(file)
    bar, known = striped_bar(), {}
    results: dict = {"arch": running_arch(), "quick": quick}
    figures: list[tuple[str, Callable[[], Section]]] = [
        ("two-level and one-level embedding", lambda: embedding_section(bar, effort, results)),
        ("shadow", lambda: shadow_section(effort, known, results)),
        ("twist", lambda: twist_section(bar, effort, results)),
        ("solvers", lambda: solver_section(bar, effort, results)),
        ("inpainting", lambda: inpainting_section(capture, results, quick=quick)),
        ("demos", lambda: demo_section(effort, known, results)),
    ]
    device = "a CUDA GPU" if running_arch() == "cuda" else "the CPU"
    how = f"{device}{', quickly, at small sizes' if quick else ''}"
    sections: list[Section] = []
    begin = perf_counter()
    for k, (what, make) in enumerate(figures):
        passed = f" (after {perf_counter() - begin:.0f} s)" if k else ""
        print(f"[{k + 1}/{len(figures)}] {what}{passed}", file=sys.stderr, flush=True)
        with keep_compiled_kernels():
            sections.append(make())
        still = "" if k + 1 == len(figures) else f" Not finished: {k + 1} of {len(figures)} figures."
        text = f"Made by vrgs.py figures on {how}.{still} {PAPER}"
        with atomic_write_all(page, numbers) as (page_part, numbers_part):
            page_part.write_text(html_page("VR-GS: figures and tables", text, sections), encoding="utf-8")
            numbers_part.write_text(json.dumps(to_plain(results), indent=1) + "\n", encoding="utf-8")
    print(f"wrote {page} and {numbers}, after {perf_counter() - begin:.0f} s", file=sys.stderr)


PAPER = (
    "The paper is VR-GS: A Physical Dynamics-Aware Interactive Gaussian Splatting System in Virtual Reality "
    "(SIGGRAPH 2024, arXiv:2401.16663); what is quoted from it was measured by its authors on an RTX 4090."
)


def _told(text: str) -> None:
    """Print a line of a figure in the making."""
    print(f"      {text}", file=sys.stderr, flush=True)


def embedding_section(bar, effort: Effort, results: dict) -> Section:
    """The ablation of the embedding: jumps where a Gaussian follows one coarse tet alone."""
    found, shown = {}, {}
    for row, picture, errors in measure_ablation(bar, effort.deformations):
        key = row["deformation"], row["scheme"]
        found[key] = row
        shown |= {(*key, "picture"): picture, (*key, "errors"): errors}
    results["embedding"] = list(found.values())
    shown, pictures, table = cropped(shown), {}, []
    for title in effort.deformations:
        pairs = [[shown[title, scheme, what] for scheme in SCHEMES] for what in ("picture", "errors")]
        pictures[title] = np.concatenate([np.concatenate(pair, axis=1) for pair in pairs])
        table.append((title, *(f"{found[title, s][what]:.3f}" for what in ("error", "jump") for s in SCHEMES)))
    return Section(
        "Two-level and one-level embedding",
        "A striped bar in a coarse cage is twisted and stretched by formula. Left, one-level: a Gaussian takes the "
        "gradient of the tetrahedron that holds its centre. Right, two-level: that of its own local tetrahedron, whose "
        "corners are embedded in the cage one by one (Sec. 4.3.2). Below: error of each Gaussian's shape, from none, "
        f"pale, to {WORST_SHOWN} or more, red.",
        pictures,
        Table(("deformation", "error, one-level", "two-level", "jump, one-level", "two-level"), table),
        "Error: of the covariance, relative to the formula's; 95% of the Gaussians have less. Jump: of the error, from "
        "one Gaussian to the next, 95% as well.",
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
    """Both solvers on the swing of a bar."""
    rows, twisted = [], TwistedBar(bar)
    for name, method in (("xpbd", "XPBD"), ("vbd", "vertex block descent")):
        found = twisted.twist(SMALL_TURN, effort.seconds, name, draw=False)
        measured, theory = found.frequency
        results[f"solver_{name}"] = {k: v for k, v in asdict(found).items() if k != "pictures"}
        swing = f"{measured:.2f} Hz ({measured / theory - 1:+.1%})" if np.isfinite(measured) else UNKNOWN
        steps = (str(found.substeps), f"{1e3 * found.dt:.2f} ms", str(found.iterations))
        rows.append((method, f"{len(bar.cage.vertices):,}", *steps, f"{found.frame_ms:.1f} ms", swing))
    theory = 1 / (4 * quarter_period(twisted))
    rows.append(("theory of slender bars", UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, f"{theory:.2f} Hz"))
    results["torsion_frequency_theory"] = theory
    return Section(
        "Solvers",
        f"A bar of {MATERIAL.young / 1e3:.0f} kPa is twisted by {np.degrees(SMALL_TURN):.0f}° and let go, with "
        "each of the solvers.",
        {},
        Table(("method", "vertices", "substeps", "of", "iterations", "time a frame", "torsional swing"), rows),
        "Substeps of a frame of 1/60 s, iterations of each. The theory neglects that the clamp holds the section's "
        "warping, which stiffens a short bar, as coarse linear tetrahedra do. The paper uses XPBD; its iterations and "
        "frame rates stand below, with the demos. It compares itself with PhysGaussian (arXiv:2311.12198), which "
        "simulates the Gaussians as particles, and PAC-NeRF (arXiv:2303.05512), which simulates particles of a voxel "
        "radiance field, both by the material point method; their times are not quoted, since they are not known here.",
    )


def cropped(pictures: dict) -> dict:
    """Pictures (H, W, 3) of one size without the rows and columns at their edges that show in all of them the
    background only."""
    stack = np.stack(list(pictures.values()))
    shown, cuts = (np.abs(stack.astype(int) - stack[0, 0, 0]) > 8).any(axis=(0, 3)), []
    for axis in (0, 1):
        found = np.flatnonzero(shown.any(axis=1 - axis))
        first, last = (found[0], found[-1] + 1) if len(found) else (0, shown.shape[axis])
        cuts.append(slice(max(first - MARGIN, 0), last + MARGIN))
    return {name: p[tuple(cuts)] for name, p in pictures.items()}


class Played(NamedTuple):
    """A demo after its scripted player has played: pictures (H, W, 3) uint8, and statistics of the run."""

    picture: np.ndarray
    without_shadows: np.ndarray
    stats: dict


def play(demo: PaperDemo, effort: Effort, known: dict[str, Played]) -> Played:
    """Play a demo for a while, and keep it in `known`, where it may be already."""
    if demo.name in known:
        return known[demo.name]
    scene, size = registry.load(demo.scene, **demo.options), effort.size
    world = World(scene, width=size[0], height=size[1])
    camera = perspective(*size, scene.fov_y, look_at(np.array(scene.eye), np.array(scene.target)))
    frames = max(round(effort.demo_seconds / FRAME), 2)
    for k in range(frames):
        time, last = (k + 1) * FRAME, k == frames - 1
        world.step(Frame(FRAME, time, [camera] if last else [], world.scripted_hands(time)))
    picture = pixels_of(world.picture)[..., :3].copy()
    world.device.splats.visibility.fill(1.0)
    world.device.renderer.render([camera])
    known[demo.name] = Played(picture, pixels_of(world.picture)[..., :3].copy(), run_stats(world, frames))
    with keep_compiled_kernels():
        destroy_fields(list(vars(world.device).values()))  # Taichi holds the fields of a few worlds only
    return known[demo.name]


def shadow_section(effort: Effort, known: dict[str, Played], results: dict) -> Section:
    """One view with shadows and without."""
    (demo,) = paper_demos([SHADOWED])
    played = play(demo, effort, known)
    loss = (played.without_shadows.astype(float) - played.picture).mean(2) / 255
    dark = loss > DARKENED
    darker = float(1 - played.picture[dark].mean() / played.without_shadows[dark].mean()) if dark.any() else 0.0
    took = played.stats["stages"]["shadow"]["median_ms"]
    results["shadow"] = {"pixels": float(dark.mean()), "darker": darker, "median_ms": took}
    return Section(
        "Shadows",
        "The dance with the shadow map and without. Baked shadows stay as they were trained; the map darkens what lies "
        "behind a body, seen from the light (Sec. 4.4).",
        {"with shadows": played.picture, "without": played.without_shadows},
        Table(
            ("", "measured"),
            [("pixels in shadow", f"{dark.mean():.1%}"), ("darker there by", f"{darker:.0%}"),
             ("time of the shadow map, each frame", f"{took:.2f} ms")],
        ),
    )  # fmt: skip


def demo_section(effort: Effort, known: dict[str, Played], results: dict) -> Section:
    """A picture of each demo after its scripted player has played for a while."""
    demos = paper_demos(effort.demos)
    pictures, rows, results["demos"] = {}, [], {}
    for k, demo in enumerate(demos, 1):
        title = demo.name.replace("_", " ")
        _told(f"{title} ({k} of {len(demos)})")
        played = play(demo, effort, known)
        stats, pictures[title] = played.stats, played.picture
        counts = ("gaussians", "vertices", "tets", "iterations", "substeps", "integrator")
        results["demos"][demo.name] = {name: stats[name] for name in counts}
        rows.append((
            title, f"{stats['gaussians'] / 1e6:.3f} M", f"{demo.gaussians / 1e6:.3f} M", f"{stats['vertices']:,}",
            f"{demo.vertices:,}", str(demo.iterations), f"{demo.fps:g}",
        ))  # fmt: skip
    columns = ("demo", "Gaussians", "in the paper", "cage vertices", "in the paper", "its iterations", "its fps")
    return Section(
        "Demos",
        f"Each demo after {effort.demo_seconds:g} s of its scripted play, with the shipped assets.",
        pictures,
        Table(columns, rows),
        "python -m studio --detail paper makes the demos at the paper's sizes; vrgs.py bench demos measures them.",
    )


WIDTH = 1100  # [px] of a picture of an inpainted object, at least
STEPS, QUICK_STEPS = 1500, 400  # of training


def inpainting_section(folder: Path | None, results: dict, *, quick: bool) -> Section:
    """Objects of the modelled capture in a folder, before and after, beside the truth; quick: one. Without a folder a
    note on how to make one (python -m studio --capture)."""
    text = (
        "Toys on a table, photographed by ray casting, so that it is known what stands behind each. A splat is trained "
        "with their masks; an object's Gaussians are taken out; where no photograph shows what was behind them, a "
        "patch of new Gaussians is made up, and all others stay as they are."
    )
    if folder is None:
        results["inpainting"] = None
        note = "Not made: it needs --capture, a capture whose truth is known (python -m studio --capture DIR)."
        return Section("Inpainting", text, note=note)
    steps = QUICK_STEPS if quick else STEPS
    rows = measured_objects(folder, steps, objects=1 if quick else None)
    refused = "".join(f" Not closed: {row['refused']}." for row in rows.values() if "refused" in row)
    closed = {name: row for name, row in rows.items() if "refused" not in row}
    pictures = {f"{name}: photograph, taken out, inpainted, truth": row.pop("picture") for name, row in closed.items()}
    pictures |= {f"{name}, turned; below, the truth": row.pop("turned_picture") for name, row in closed.items()}
    results["inpainting"] = {"steps": steps, "objects": rows}
    table = [
        (name, *(f"{row['psnr'][when]:.1f} dB" for when in ("before", "after")), f"{1e4 * row['area']:.0f} cm²",
         *(f"{row['turned'][what]:.1f} dB" for what in ("photographed", "unseen")),
         *(f"{row['turned'][what]:.1%}" for what in ("holes", "outside")))
        for name, row in closed.items()
    ]  # fmt: skip
    return Section(
        "Inpainting",
        text,
        pictures,
        Table(
            (
                "object",
                "PSNR, taken out",
                "PSNR, inpainted",
                "seen by no camera",
                "PSNR, turned, of photographed sides",
                "of others",
                "holes",
                "drawn outside of it",
            ),
            table,
        ),
        f"{steps:,} steps of training. PSNR: against the scene without the object, over the pixels that it covered, in "
        "all views. The object's shadow is taken away with it. Turned: the object alone, as it is seen when turned by "
        "90° about two axes; shares of the pixels that it covers then." + refused,
    )


def measured_objects(folder: Path, steps: int, objects: int | None) -> dict[str, dict]:
    """Numbers and the picture of each object, or of the first few. Raises BadInput."""
    if not (folder / "behind").is_dir():
        raise BadInput(f"{folder}: shows nothing without its objects (make it: python -m studio --capture {folder})")
    capture, photographs, gaussians = _trained(folder, steps)
    found = {}
    for number, name in enumerate(gaussians.objects[:objects], 1):
        _told(f"without the {name}")
        own = gaussians.object_id == number
        before, removed = gaussians.select(~own), gaussians.select(own)
        try:
            after, (hole,) = pipeline.inpaint(before, {name: removed}, [p.camera for p in photographs])
        except BadInput as e:  # a small capture's splat is rough
            _told(str(e))
            found[name] = {"refused": str(e)}
            continue
        behind = [replace(v, image=folder / "behind" / name / v.image.name, mask=None) for v in capture.views]
        truths = [load_photograph(v) for v in behind]
        views = [v for v in compare(hole.views, hole.textures, before, after, truths) if v.covered.any()]
        found[name] = {
            "gaussians": int(own.sum()),
            "new": len(hole.patch),
            "area": hole.area,
            "psnr": uncovered_psnr(views)["object"],
            **dict(zip(("turned", "turned_picture"), turned(removed, turned_views(folder, name)), strict=True)),
            "picture": _strip(max(views, key=lambda v: int(v.hole.sum() or v.covered.sum())), photographs),
        }
    return found


def turned_views(folder: Path, name: str) -> list[View]:
    """Views of an object of a modelled capture alone, from around and below, in the frame of the upright capture; their
    masks tell what photographs show of it."""
    return replace(read_capture(folder), test=read_capture(folder / "turned" / name).views).upright().test


def turned(gaussians: Gaussians, views: list[View]) -> tuple[dict[str, float], np.ndarray]:
    """Pictures of an object that is turned, beside the truth, and pictures of it over the truth's, (H, W, 3) uint8.

    photographed, unseen  PSNR [dB] over black of its pixels that photographs show, and of the others
    holes, outside        pixels of it with an opacity below a half, and of its surroundings above, as shares of its own
    """
    errors, counts, pictures = {"photographed": [], "unseen": []}, np.zeros(3), []
    drawing = BlendingWeights(gaussians)
    for view in views:
        truth = load_photograph(replace(view, mask=None))
        seen = read_mask(view.mask, truth.alpha.shape)
        color, _, alpha = drawing.picture(truth.camera)
        there, square = truth.alpha > OPAQUE, (color.clip(0.0, 1.0) - truth.pixels / 255) ** 2
        errors["photographed"].append(square[there & seen])
        errors["unseen"].append(square[there & ~seen])
        counts += (there & (alpha < 0.5)).sum(), ((truth.alpha == 0) & (alpha > 0.5)).sum(), there.sum()
        pictures.append(np.concatenate([(255 * color.clip(0.0, 1.0)).round().astype(np.uint8), truth.pixels]))
    drawing.destroy()
    found = {name: float(-10 * np.log10(np.concatenate(squares).mean())) for name, squares in errors.items()}
    return found | dict(zip(("holes", "outside"), counts[:2] / counts[2], strict=True)), np.concatenate(
        pictures, axis=1
    )


def _trained(folder: Path, steps: int) -> tuple:
    """The capture, its photographs, and the Gaussians trained to them, with the ids of its objects."""
    capture, masks = masks_of(read_capture(folder).upright(), folder / "masks", _told)
    photographs = load_photographs(capture.views, 1, masks.ids)
    options = TrainOptions(steps=steps, cap=CAPS["cpu"], degree=1)
    start = first_gaussians(capture, photographs, degree=options.degree, cap=options.cap, seed=options.seed)
    trainer = Trainer(photographs, start, capture.extent, options, masks.names)
    while trainer.done < steps:
        trainer.step()
        if trainer.done % max(steps // 4, 1) == 0:
            _told(f"training, step {trainer.done} of {steps}, PSNR {trainer.recent_loss().psnr:.1f} dB")
    gaussians = room_pipeline.without_supports(identified(trainer, photographs), capture)
    trainer.destroy()
    gaussians = trained_alone(gaussians, capture, photographs)
    return capture, photographs, background_around(gaussians, capture, photographs)


def _strip(view, photographs) -> np.ndarray:
    """A view's photograph, and the pictures before, after and of the truth, side by side, (H, W, 3) uint8."""
    parts = [cut_out(photographs[view.view.index], view.view), view.before, view.after, view.truth]
    strip = np.concatenate(parts, axis=1)
    times = WIDTH / strip.shape[1]
    strip = cv2.resize(strip, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC) if times > 1 else strip
    return (strip.clip(0.0, 1.0) * 255).round().astype(np.uint8)
