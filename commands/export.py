"""`vrgs.py export` and `convert`: a played scene, or a splat file, written for other programs."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from assets.file_access import check_writable, make_folder
from assets.formats.gaussian_glb import object_order
from assets.formats.ply import chunk_order
from assets.gaussians import SH_COUNTS, Gaussians
from assets.splat_files import COMPRESSED, kind_to_write, read_gaussians, write_gaussians
from commands import options as cli
from commands.play import open_session
from commands.play_options import PREPARATION, STATE, PlayOptions, SceneOptions
from core.errors import BadInput
from core.program import USD, check_usd
from core.spherical_harmonics import C0
from scenes.registry import label

Kind = Literal["ply", "compressed.ply", "spz", "splat", "sog", "glb", "vtu", "obj"]
PAGE = "html"
PROGRESS_SIZE_MIN = 20 << 20  # [bytes] of input; less takes about a second


@dataclass(kw_only=True)
class ExportOptions(SceneOptions):
    EXAMPLES = (
        "export --scene ring_toss --frames 90 --out toss.ply",
        "export --scene ring_toss --every 2 --out toss/ --format spz",
        "export --scene sandbox --body cat.ply --frames 60 --only 0 --out cat.vtu",
        "export --replay play.h5 --every 4 --out play/",
        "export --scene ring_toss --out toss.html",
        "export --scene ring_toss --out toss.usdz",
    )
    CONDITIONS = (
        STATE,
        cli.Condition(("--format",), lambda o: is_folder(o.out), "is for a folder; a file's name gives its format"),
        cli.Condition(
            ("--every",),
            lambda o: is_folder(o.out) or kind_of(o) == PAGE or is_usd(o.out),
            "is for a sequence: a folder, a .html or an OpenUSD file",
        ),
        cli.Condition(("--embedding",), lambda o: kind_of(o) != PAGE, "is not for a .html, which has two levels"),
        cli.Condition(("--no-shadows",), lambda o: kind_of(o) not in ("vtu", "obj"), "is for splats, not for cages"),
        PREPARATION,
    )

    out: Path = cli.option(
        "FILE|DIR",
        f"file of the last frame (.{', .'.join(get_args(Kind))}, {', '.join(USD)}), folder of a sequence, or page of "
        "the play (.html)",
        cli.REQUIRED,
    )
    every: cli.Count | None = cli.option(
        "N", "sequence, .html, .usd* with --frames: every N-th, of 60 a second (default 2)"
    )
    format: Kind = cli.option(None, "sequence: kind of its files (default ply)", "ply")
    only: str | None = cli.option("BODY", "only one body, by its number or the name of its asset")
    no_shadows: bool = cli.switch("splats: write colours as in full light")


def kind_of(options: ExportOptions) -> str:
    """The kind of file that is asked for."""
    return options.format if is_folder(options.out) else options.out.suffix.lower().lstrip(".")


def is_folder(path: Path) -> bool:
    """True if `--out` names a folder: one that is there, or a name without an ending."""
    return path.is_dir() or not path.suffix


def is_usd(path: Path) -> bool:
    """True for the name of an OpenUSD file, which holds a scene as it begins, and with --frames its play."""
    return path.suffix.lower() in USD and not path.is_dir()


def export(options: ExportOptions) -> None:
    """Play the scene and write what --out names. Raises BadInput."""
    from display.keep.scene_export import export_suffix, exporter

    sequence, page, usd = is_folder(options.out), kind_of(options) == PAGE, is_usd(options.out)
    start, every, files, film = time.perf_counter(), options.every or 2, [], None
    if sequence:
        make_folder(options.out)
    else:
        check_writable(options.out)
    if usd:
        check_usd(f"{options.out}: OpenUSD")
    elif not sequence and not page:
        export_suffix(options.out)
    played = PlayOptions(**options.values_of(SceneOptions), headless=True, size=(16, 16), sort="z", sound="off")
    if usd:
        played.frames = options.frames or 1
    with open_session(played) as session:
        world = session.world
        for index, frame in enumerate(session.frames()):
            world.step(frame)
            if index == 0:
                wanted = {"body": find_body(world, options.only), "shadows": not options.no_shadows}
                film = film_of(options, world, played.scene, **wanted)
            if index % every == 0 and film is not None and (page or options.frames):
                film.take(frame.time)
            elif index % every == 0 and sequence:
                files.append(options.out / f"frame_{index:05d}.{options.format}")
                exporter(world, files[-1], **wanted)()
        if film is not None:
            film.write(options.out)
        elif not sequence:
            exporter(world, options.out, **wanted)()
    files = files or [options.out]
    size, count = sum(f.stat().st_size for f in files) / 1e6, len(files)
    what = f"{count} files" if sequence else f"{index + 1} frames" if page else f"frame {index + 1}"
    print(f"{options.out}: {what}, {size:.1f} MB, {time.perf_counter() - start:.1f} s")


def film_of(options: ExportOptions, world, scene: str, **wanted):
    """The page or OpenUSD stage that takes the play into one file; None for files of single frames."""
    if kind_of(options) == PAGE:
        from display.keep.played_page import PlayedPage

        return PlayedPage(world, label(scene).replace("_", " "), **wanted)
    if is_usd(options.out):
        from display.keep.usd_export import SceneStage

        return SceneStage(world, rate=60 / (options.every or 2), **wanted)
    return None


def find_body(world, wanted: str | None) -> int | None:
    """Index of the body of a number or name; None: of all. Raises BadInput that lists them."""
    if wanted is None:
        return None
    names = [Path(body.name).stem for body in world.bodies()]
    if wanted.isdecimal() and int(wanted) < len(names):
        return int(wanted)
    if Path(wanted).stem in names:
        return names.index(Path(wanted).stem)
    there = ", ".join(f"{k} {name}" for k, name in enumerate(names)) or "none"
    raise BadInput(f"--only {wanted}: there is no such body; there are {there}")


@dataclass(kw_only=True)
class ConvertOptions(cli.Options):
    EXAMPLES = (
        "convert cat.sog cat.spz",
        "convert cat.ply cat.glb",
        "convert room.ply small.ply --decimate 25%",
    )
    CONDITIONS = (
        cli.Condition(("--up",), lambda o: o.output.suffix.lower() == ".glb", "belongs to a .glb, of which +y is up"),
        cli.Condition(("--spz-version",), lambda o: o.output.suffix.lower() == ".spz", "belongs to a .spz"),
    )

    input: Path = cli.argument("IN", f"{cli.SPLATS} or .h5")
    output: Path = cli.argument("OUT", ".ply, .compressed.ply, .spz, .splat, .sog or .glb")
    spz_version: Literal[3, 4] = cli.option(None, ".spz: 3, which all programs read (default), or 4, some smaller", 3)
    up: cli.Axis | None = cli.option(None, ".glb: the input's up axis, turned to +y (default: guessed)")
    decimate: cli.Share | None = cli.option("N|P%", "merge Gaussians with the least error until N, or P%%, are left")


def convert(options: ConvertOptions) -> None:
    """Convert the input to the output, and print what was written and what was lost. Raises BadInput."""
    source, target = options.input, options.output
    kind = kind_to_write(target)
    exist = [os.path.isfile(path) for path in (source, target)]  # False where Path.exists may raise
    if all(exist) and source.samefile(target):
        raise BadInput(f"{target}: is the input itself; choose another name")
    long = exist[0] and source.stat().st_size >= PROGRESS_SIZE_MIN
    progress = partial(print, file=sys.stderr, flush=True) if long else no_line
    progress(f"  1/3 reading {source.name}")
    note = ""
    if kind == ".glb":
        from display.viewed_file import ViewedFile

        shown = ViewedFile.read(source, options.up)
        note, before = f", {shown.note}", shown.gaussians.select(object_order(shown.gaussians))
    else:
        before = read_gaussians(source)
    if options.decimate is not None:
        before, merged = fewer(before, options.decimate, f"{source}")
        note += f", merged from {merged}"
    progress(f"  2/3 writing {len(before)} Gaussians to {target.name}")
    version = {"version": options.spz_version} if kind == ".spz" else {}
    write_gaussians(target, before, report=no_line, **version)  # the losses below say it
    progress("  3/3 comparing")
    after = read_gaussians(target)
    if kind in (COMPRESSED, ".sog"):
        before = before.select(chunk_order(before.means))
    lost = losses(before, after)
    if source.suffix.lower() == ".h5":
        lost.append("all of the asset but its Gaussians")
    size = f"{target.stat().st_size / 1e6:.2f} MB"
    if source.suffix.lower() != ".json":  # most of an unzipped SOG stands in its images
        size += f", was {source.stat().st_size / 1e6:.2f} MB"
    what = f"{len(after)} Gaussians of SH degree {after.sh_degree} ({size})"
    print(f"{target}: {what}{note}; lost: {', '.join(lost) or 'nothing'}")


def fewer(gaussians: Gaussians, wanted: float, where: str) -> tuple[Gaussians, int]:
    """As many Gaussians as wanted, a number or a share below 1, and how many there were. Raises BadInput."""
    from core.runtime import start_taichi
    from render.merging import decimated

    there = len(gaussians)
    count = int(wanted) if wanted >= 1 else max(1, round(wanted * there))
    if count >= there:
        raise BadInput(f"--decimate: {where} holds {there} Gaussians, no more than are wanted")
    start_taichi()
    return decimated(gaussians, count), there


def no_line(line: str) -> None:
    """Print nothing."""


def losses(before: Gaussians, after: Gaussians) -> list[str]:
    """Measured losses of a conversion: the largest errors in words, [] if none."""
    if len(before) != len(after):
        return [f"{len(before) - len(after)} Gaussians"]
    lost = []
    if after.sh_degree < before.sh_degree:
        lost.append(f"SH of degree {', '.join(map(str, range(after.sh_degree + 1, before.sh_degree + 1)))}")
    shared = SH_COUNTS[min(before.sh_degree, after.sh_degree)]
    for name, values, unit in (
        ("positions", (before.means, after.means), "m"),
        ("log-scales", (before.log_scales, after.log_scales), ""),
        ("opacities", (before.opacities, after.opacities), ""),
        ("colours", (before.sh[:, 0] * C0, after.sh[:, 0] * C0), ""),
        ("SH coefficients", (before.sh[:, 1:shared], after.sh[:, 1:shared]), ""),
    ):
        error = float(np.abs(values[0] - values[1]).max(initial=0.0))
        if error > 0:
            lost.append(f"{name} up to {error:.2g} {unit}".rstrip())
    angle = 2 * np.arccos(np.clip(np.abs((before.quats * after.quats).sum(1, dtype=np.float64)), 0, 1)).max()
    if angle > 1e-3:  # [rad]; float32 alone turns by up to about 5e-4 in this formula
        lost.append(f"rotations up to {np.degrees(angle):.2g} degrees")
    if (before.object_id != after.object_id).any() or before.objects != after.objects:
        lost.append("object ids")
    if before.antialias and not after.antialias:
        lost.append("the mark for anti-aliased drawing")
    return lost
