"""`vrgs.py export`: write a played scene for other programs: splats, cages with fields, surfaces; one or a sequence."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from assets.file_access import check_writable
from commands.conditions import Condition
from commands.options import add_scene_options, positive
from commands.play import PREPARATION, STATE_CONDITION, add_scene_arguments, open_session
from core.errors import BadInput

HELP = "write a scene as it is in play: splats, cages, surfaces, or a sequence of them"
EXAMPLES = (
    "export --scene ring_toss --frames 90 --out toss.ply",
    "export --scene ring_toss --every 2 --out toss/ --format spz",
    "export --scene sandbox --body cat.ply --frames 60 --only 0 --out cat.vtu",
    "export --replay play.h5 --every 4 --out play/",
)
KINDS = ("ply", "compressed.ply", "spz", "splat", "vtu", "obj")
CONDITIONS = (
    STATE_CONDITION,
    Condition(("--format",), lambda args: is_folder(args.out), "is for a folder: a file's name says its kind"),
    Condition(("--every",), lambda args: is_folder(args.out), "is for a sequence: --out must be a folder"),
    Condition(("--no-shadows",), lambda args: kind_of(args) not in ("vtu", "obj"), "is for splats, not for cages"),
    PREPARATION,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument("--replay", type=Path, metavar="FILE.h5", help="recorded input instead of the scripted play")
    text = f"file of the last frame (.{', .'.join(KINDS)}), or folder of a sequence"
    parser.add_argument("--out", type=Path, required=True, metavar="FILE|DIR", help=text)
    text = "sequence: every N-th frame, of 60 a second (default 2)"
    parser.add_argument("--every", type=positive(int), metavar="N", help=text)
    parser.add_argument("--format", choices=KINDS, default="ply", help="sequence: kind of its files (default ply)")
    parser.add_argument("--only", metavar="BODY", help="one body, by its number or the name of its asset")
    parser.add_argument("--no-shadows", action="store_true", help="splats: colours as in full light")
    unused = {
        "xr": False,
        "headless": True,
        "stereo": False,
        "sort": "z",
        "size": (16, 16),
        "render_scale": 1.0,
        "sound": "off",
    }
    unused |= dict.fromkeys(
        ("record", "snapshot", "stats", "record_input", "study", "participant", "save_state", "web", "host")
    )
    parser.set_defaults(**unused)
    add_scene_options(parser)


def kind_of(args: argparse.Namespace) -> str:
    """The kind of file that is asked for."""
    return args.format if is_folder(args.out) else args.out.suffix.lower().lstrip(".")


def is_folder(path: Path) -> bool:
    """True if `--out` names a folder: one that is there, or a name without an ending."""
    return path.is_dir() or not path.suffix


def run(args: argparse.Namespace) -> None:
    """Play `args.scene` and write `args.out`. Raises BadInput."""
    from display.keep.scene_export import export_suffix, exporter

    sequence, start, files = is_folder(args.out), time.perf_counter(), []
    check_out(args, sequence)
    if not sequence:
        export_suffix(args.out)
    every = args.every or 2
    with open_session(args) as session:
        world, body = session.world, None
        for index, frame in enumerate(session.frames()):
            world.step(frame)
            body = find_body(world, args.only) if index == 0 else body
            if sequence and index % every == 0:
                files.append(args.out / f"frame_{index:05d}.{args.format}")
                exporter(world, files[-1], body=body, shadows=not args.no_shadows)()
        if not sequence:
            files.append(args.out)
            exporter(world, args.out, body=body, shadows=not args.no_shadows)()
    size, count = sum(f.stat().st_size for f in files) / 1e6, len(files)
    what = f"{count} files" if sequence else f"frame {index + 1}"
    print(f"{args.out}: {what}, {size:.1f} MB, {time.perf_counter() - start:.1f} s")


def check_out(args: argparse.Namespace, sequence: bool) -> None:
    """Make the folder of a sequence, or check that the file can be written. Raises BadInput."""
    if not sequence:
        check_writable(args.out)
        return
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise BadInput(f"{args.out}: cannot make this folder ({e.strerror})") from e
    check_writable(args.out / f"frame_00000.{args.format}")


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
